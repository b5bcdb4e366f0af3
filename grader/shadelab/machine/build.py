"""From a shading.cpp to a plugin."""

import hashlib
import os
import shutil
import subprocess
import threading
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from shadelab.errors import InfrastructureError
from shadelab.machine.command import Command
from shadelab.machine.glue import by_age, given_code
from shadelab.machine.processor import processor_level
from shadelab.machine.sandbox import Limits, Sandbox, work_folder
from shadelab.paths import FRAMEWORK, STATE

COMPILE_LIMITS = Limits(seconds=60, memory=4 << 30)
PLUGINS_KEPT = 1024
HEADERS_KEPT = 3  # precompiled, of one glue: what a grading uses; 30 MB each
HEADERS = FRAMEWORK / "include"

# No fused multiply-add and no reassociation: a grade must not depend on the machine. Literals such as 2.0 are Real.
_common = ["-std=c++20", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-shared", "-fPIC",
           "-fvisibility=hidden", "-Wl,-z,defs", "-fmax-errors=3", "-Werror=return-type", "-fno-diagnostics-show-option",
           "-fno-diagnostics-show-labels"]  # fmt: skip
# What a compiler knows of a program that compiles and is not meant so; nothing that is only untidy, such as an unused variable.
# Not eliding copies changes no number: else a variable in which a function builds its result is its caller's memory, of which
# the compiler does not know whether it was set.
_warned = ["-Wall", "-Wlogical-op", "-Wduplicated-cond", "-Wno-unused-variable", "-Wno-unused-but-set-variable",
           "-Wno-unused-function", "-Wno-unused-local-typedefs", "-Wno-unused-label", "-Wno-sign-compare", "-fno-elide-constructors"]  # fmt: skip
# Variables that nothing was stored in hold this byte over and over: as float -1.7e38, as double -5.3e303, no plausible result.
UNSET_BYTE = 0xFE
_unset_pattern = "-ftrivial-auto-var-init=pattern"
_float = ["-fsingle-precision-constant"]
_double = ["-O2", "-DSHADELAB_REAL=double"]
_half = [*_float, "-O1", "-DSHADELAB_REAL=shadelab::half", "-include", "shadelab/half.hpp"]


@dataclass(frozen=True)
class Recipe:
    """What of a student's file is compiled, and how."""

    double: bool = False
    functions: bool = True  # whether each function can be evaluated alone
    # The shading loops (MODEL_KIND, as `shadelab-render describe` prints them). None: all. They are what takes long to compile.
    loops: tuple[str, ...] | None = None
    terms: bool = True  # whether the loops give the single terms beside the total
    follow: bool = (
        False  # calls among the functions can be answered from a record (follow-through); for our own code only
    )
    contract: bool = False  # fused multiply-add: only to measure how far correct code strays
    half: bool = False  # 16-bit numbers (half.hpp): only for studies; the plugin takes and gives floats
    # Functions run over columns (all x, then all y, ...) in loops compiled as those that shade: to measure their time.
    columns: bool = False
    level: str | None = None  # of x86-64; None: this processor's (processor.py)
    quick: bool = False  # compiled in half the time, for few images: slower code, the same bits
    trace: bool = False  # tells what the functions compare, to the same bits
    many: bool = False  # a program of thousands of bodies, each run a few times: not optimised

    def flags(self) -> list[str]:
        out = [f"-DSHADELAB_TERMS={int(self.terms)}"]
        if self.loops is not None:
            out += ["-DSHADELAB_ONLY", *(f"-DSHADELAB_LOOP_{loop}" for loop in sorted(self.loops))]
        out += [] if self.functions else ["-DSHADELAB_NO_FUNCTIONS"]
        out += ["-DSHADELAB_FOLLOW"] if self.follow else []
        out += ["-DSHADELAB_COLUMNS"] if self.columns else []
        out += ["-DSHADELAB_TRACE"] if self.trace else []
        return [*self.headers(), *out]

    def headers(self) -> list[str]:
        """What precompiled headers must be compiled with, too."""
        unset = [_unset_pattern] if _compiler_version() >= 12 else []
        traced = ["-fsanitize-coverage=trace-cmp", "-g1"] if self.trace else []  # -g1: the lines
        return [*_common, *(_warned if self.alone else []), *unset, *traced, *self.arithmetic()]

    @property
    def alone(self) -> bool:
        """Whether functions are evaluated alone, and nothing is drawn or measured: where what the compiler says is asked for."""
        return self.loops == () and not self.columns and not self.half

    def arithmetic(self) -> list[str]:
        """What the numbers and the speed depend on. Functions alone are evaluated a few thousand times: -O1 compiles them
        in half the time, to the same bits."""
        if self.half:
            return _half
        if self.many:
            return [*(_double if self.double else _float), "-O0", "-w", "-DSHADELAB_CALLS"]
        if self.double:
            return [*_double, "-O3", *self._architecture()] if self.columns else _double
        if self.contract:
            return [*_float, "-O3", *self._architecture(), "-ffp-contract=fast"]
        if self.quick or self.alone:
            return [*_float, "-O1"]
        return [*_float, "-O3", *self._architecture()]

    def _architecture(self) -> list[str]:
        """Plugins are built where they run, so they may use what this processor has."""
        level = processor_level(self.level)
        return [] if level == "plain" else [f"-march=x86-64-{level}"]


@cache
def _compiler_version() -> int:
    said = subprocess.run(["g++", "-dumpversion"], capture_output=True, text=True).stdout
    return int(said.partition(".")[0]) if said[:1].isdigit() else 0


FUNCTIONS = Recipe(loops=(), trace=True)
DOUBLE = Recipe(double=True, loops=())


@dataclass
class Plugin:
    file: Path
    double: bool
    said: str  # by the compiler: warnings


@dataclass
class CompileError(Exception):
    """The code does not compile."""

    stderr: str  # what the compiler says
    ending: str  # how it ended


def build_plugin(glue: Path, source: Path, sandbox: Sandbox, recipe: Recipe = Recipe()) -> Plugin:  # noqa: B008
    """Compiles `source` (a shading.cpp) with the generated code of its assignment. Raises CompileError. Equal sources are
    compiled once."""
    flags = recipe.flags()
    digest = hashlib.sha256("\0".join(flags).encode() + str(glue).encode() + source.read_bytes()).hexdigest()[:32]
    cached, said = (STATE / "plugins" / f"{digest}{suffix}" for suffix in (".so", ".txt"))
    with suppress(FileNotFoundError):  # one without the other is half thrown away
        warnings = said.read_text()
        for file in (said, cached):
            os.utime(file)  # its age counts from the last use
        return Plugin(cached, recipe.double, warnings)
    _precompile(glue, recipe, sandbox)
    work = sandbox.folder / f"build-{digest}"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    shutil.copy(source, work / "shading.cpp")
    shutil.copy(glue / "glue.cpp", work / "glue.cpp")
    words = ["g++", *flags, f"-I{HEADERS}", f"-I{glue}", "glue.cpp", "-o", "plugin.so"]
    # The glue includes the code of given assignments where it stands: beside the assignment.
    command = Command(tuple(words), reads=(HEADERS, glue, *given_code(glue)), writes=(work,))
    outcome = sandbox.run(command, COMPILE_LIMITS, cwd=work)
    if not outcome.ok:
        raise CompileError(outcome.stderr, outcome.explain(COMPILE_LIMITS))
    cached.parent.mkdir(parents=True, exist_ok=True)
    temporary = cached.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
    temporary.write_text(outcome.stderr)
    os.replace(temporary, said)
    shutil.copy(work / "plugin.so", temporary)
    os.replace(temporary, cached)
    for old in by_age(cached.parent)[: -2 * PLUGINS_KEPT]:
        old.unlink(missing_ok=True)
    shutil.rmtree(work)
    return Plugin(cached, recipe.double, outcome.stderr)


def broken_lines(glue: Path, source: Path, sandbox: Sandbox, recipe: Recipe) -> str:
    """What the compiler says of all errors of our own `source`, without compiling it."""
    work = sandbox.folder / "syntax"
    work.mkdir(exist_ok=True)
    shutil.copy(source, work / "shading.cpp")
    shutil.copy(glue / "glue.cpp", work / "glue.cpp")
    words = ["g++", *recipe.flags(), "-fsyntax-only", "-fmax-errors=0", f"-I{HEADERS}", f"-I{glue}", "glue.cpp"]
    command = Command(tuple(words), reads=(HEADERS, glue, *given_code(glue)), writes=(work,))
    return sandbox.run(command, COMPILE_LIMITS, cwd=work).stderr


def _precompile(glue: Path, recipe: Recipe, sandbox: Sandbox) -> None:
    """The headers, compiled once per glue and kind of arithmetic: they are half of what compiling a plugin takes. The
    compiler looks into prelude.hpp.gch/ for one that fits, and does without where there is none."""
    flags = [f for f in recipe.headers() if f != "-shared" and not f.startswith("-Wl,")]
    folder = glue / "prelude.hpp.gch"
    file = folder / hashlib.sha256("\0".join(flags).encode()).hexdigest()[:16]
    # Of `half` the compiler would not use one; of `contract` and `many` there are few programs, and 30 MB each.
    if recipe.contract or recipe.half or recipe.many:
        return
    with suppress(FileNotFoundError):
        os.utime(file)  # its age counts from the last use
        return
    with work_folder("precompile") as work:
        words = ["g++", *flags, f"-I{HEADERS}", f"-I{glue}", "-x", "c++-header", str(glue / "prelude.hpp")]
        command = Command((*words, "-o", str(work / "gch")), reads=(HEADERS, glue), writes=(work,))
        try:
            compiled = Sandbox(work, stop=sandbox.stop).run(command, COMPILE_LIMITS).ok
        except InfrastructureError:
            return  # what is compiled without them says what is the matter
        if compiled:
            try:
                folder.mkdir(exist_ok=True)
                shutil.move(work / "gch", temporary := glue / f"gch-{os.getpid()}-{threading.get_ident()}")
                os.replace(temporary, file)
                for old in by_age(folder)[:-HEADERS_KEPT]:
                    old.unlink(missing_ok=True)
            except OSError:
                pass  # another run has thrown it away meanwhile, for younger ones
