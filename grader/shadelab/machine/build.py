"""From a student's shading.cpp to a plugin, and from a compiler's words to lines that a student can act on."""

import hashlib
import os
import re
import shutil
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from shadelab.course.assignment import Assignment, load_assignment
from shadelab.errors import InfrastructureError, UserError
from shadelab.machine.sandbox import Limits, Sandbox, work_folder
from shadelab.paths import FRAMEWORK, RENDER, STATE

COMPILE_LIMITS = Limits(seconds=60, memory=4 << 30)
MAX_LINES = 5  # of one error
PRELUDE_LINE = 1_000_001  # where the lines of the generated GLSL begin (glue.hpp); below it are the student's
PLUGINS_KEPT, GLUE_KEPT, PRECOMPILED_KEPT = 1024, 96, 8  # the last are 30 MB each

# No fused multiply-add and no reassociation: a grade must not depend on the machine. Literals such as 2.0 are Real.
_common = ["-std=c++20", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-shared", "-fPIC",
           "-fvisibility=hidden", "-Wl,-z,defs", "-fmax-errors=3", "-fno-diagnostics-show-option", "-fno-diagnostics-show-labels"]  # fmt: skip
_float = ["-fsingle-precision-constant"]
_double = ["-O2", "-DSHADELAB_REAL=double"]
_half = [*_float, "-O1", "-DSHADELAB_REAL=shadelab::half", "-include", "shadelab/half.hpp"]


@dataclass(frozen=True)
class Recipe:
    """What of a student's file is compiled, and how."""

    double: bool = False
    functions: bool = True  # whether each function can be evaluated alone
    # The shading loops (MODEL_KIND, as `shadelab-render needs` prints them). None: all. They are what takes long to compile.
    loops: tuple[str, ...] | None = None
    terms: bool = True  # whether the loops give the single terms beside the total
    follow: bool = (
        False  # calls among the functions can be answered from a record (follow-through); for our own code only
    )
    contract: bool = False  # fused multiply-add: only to measure how far correct code strays
    half: bool = False  # 16-bit numbers (half.hpp): only for studies; the plugin takes and gives floats
    # Functions run over columns (all x, then all y, ...) in loops compiled as those that shade: to measure their time.
    columns: bool = False
    quick: bool = False  # compiled in half the time, for few images: slower code, the same bits

    def flags(self) -> list[str]:
        out = [*_common, f"-DSHADELAB_TERMS={int(self.terms)}"]
        if self.loops is not None:
            out += ["-DSHADELAB_ONLY", *(f"-DSHADELAB_LOOP_{loop}" for loop in sorted(self.loops))]
        out += [] if self.functions else ["-DSHADELAB_NO_FUNCTIONS"]
        out += ["-DSHADELAB_FOLLOW"] if self.follow else []
        out += ["-DSHADELAB_COLUMNS"] if self.columns else []
        return [*out, *self.arithmetic()]

    def arithmetic(self) -> list[str]:
        """What the numbers and the speed depend on. Functions alone are evaluated a few thousand times: -O1 compiles them in half the
        time, to the same bits."""
        if self.half:
            return _half
        if self.double:
            return [*_double, "-O3", *_architecture()] if self.columns else _double
        if self.contract:
            return [*_float, "-O3", *_architecture(), "-ffp-contract=fast"]
        if self.quick or (self.loops == () and not self.columns):
            return [*_float, "-O1"]
        return [*_float, "-O3", *_architecture()]


FUNCTIONS = Recipe(loops=())


@dataclass
class Plugin:
    file: Path
    double: bool


@dataclass
class BuildError(Exception):
    """The student's code does not compile. `message` names the student's own file and line."""

    message: str


LEVELS = ("plain", "v2", "v3", "v4")
_needed = {
    "v2": {"sse4_2", "popcnt"},
    "v3": {"avx2", "fma", "bmi2"},
    "v4": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
}


@cache
def processor_level() -> str:
    """The x86-64 level whose instructions renderer and plugins use: SHADELAB_LEVEL, or the best that the processor has.

    It changes the speed and no bit. "plain" is the compiler's default, and what other processors have.
    """
    try:
        flags = set(re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE).group(1).split())
    except (OSError, AttributeError):
        flags = set()
    best = "plain"
    for level in LEVELS[1:]:
        if not _needed[level] <= flags:
            break
        best = level
    asked = os.environ.get("SHADELAB_LEVEL") or best
    if asked not in LEVELS:
        raise UserError(f"SHADELAB_LEVEL={asked}: must be plain, v2, v3 or v4")
    if LEVELS.index(asked) > LEVELS.index(best):
        raise UserError(f"SHADELAB_LEVEL={asked}: this processor has {best} at most")
    return asked


def _architecture() -> list[str]:
    """Plugins are built where they run, so they may use what this processor has."""
    level = processor_level()
    return [] if level == "plain" else [f"-march=x86-64-{level}"]


@cache
def glue_folder(directory: Path) -> Path:
    """The generated code of an assignment, made anew when its manifests, the framework's headers or the generator changed."""
    sources = [RENDER, FRAMEWORK / "interface.toml", *sorted((FRAMEWORK / "include" / "shadelab").iterdir())]
    sources.append(directory / "assignment.toml")
    for given in load_assignment(directory).given:  # their files are part of the glue, the assignment's own are not
        sources += [given.directory / name for name in ("assignment.toml", *given.files)]
    digest = hashlib.sha256(str(directory).encode())
    for source in sources:
        digest.update(source.read_bytes())
    folder = STATE / "glue" / f"{directory.name}-{digest.hexdigest()[:16]}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with work_folder("glue") as work:
            outcome = Sandbox(work).run([str(RENDER), "glue", str(directory), str(work / "glue")])
            if not outcome.ok:
                raise InfrastructureError(f"glue: {outcome.stderr.strip() or outcome.explain(Limits())}")
            try:
                (work / "glue").rename(folder)
            except OSError:
                pass  # another run was faster
        by_age = _by_age(folder.parent)
        for old in by_age[:-GLUE_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        for old in by_age[:-PRECOMPILED_KEPT]:
            shutil.rmtree(old / "prelude.hpp.gch", ignore_errors=True)
    os.utime(folder)  # its age counts from the last use
    return folder


def _by_age(folder: Path) -> list[Path]:
    """Oldest first. Another run may remove some meanwhile."""

    def age(path: Path) -> float:
        try:
            return path.stat().st_mtime
        except OSError:
            return 0.0

    return sorted(folder.iterdir(), key=age)


def build_plugin(assignment: Assignment, source: Path, sandbox: Sandbox, recipe: Recipe = Recipe()) -> Plugin:  # noqa: B008
    """Compiles `source` (a shading.cpp). Raises BuildError with the student's lines. Equal sources are compiled once."""
    glue = glue_folder(assignment.directory)
    flags = recipe.flags()
    digest = hashlib.sha256("\0".join(flags).encode() + str(glue).encode() + source.read_bytes()).hexdigest()[:32]
    cached = STATE / "plugins" / f"{digest}.so"
    if cached.exists():
        os.utime(cached)
        return Plugin(cached, recipe.double)
    _precompile(glue, recipe)
    work = sandbox.folder / f"build-{digest}"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    shutil.copy(source, work / "shading.cpp")
    shutil.copy(glue / "glue.cpp", work / "glue.cpp")
    command = ["g++", *flags, f"-I{FRAMEWORK / 'include'}", f"-I{glue}", "glue.cpp", "-o", "plugin.so"]
    outcome = sandbox.run(command, COMPILE_LIMITS, cwd=work)
    if not outcome.ok:
        raise BuildError(
            readable_errors(outcome.stderr, assignment) or f"the compiler {outcome.explain(COMPILE_LIMITS)}"
        )
    cached.parent.mkdir(parents=True, exist_ok=True)
    temporary = cached.with_suffix(f".{os.getpid()}")
    shutil.copy(work / "plugin.so", temporary)
    os.replace(temporary, cached)
    for old in _by_age(cached.parent)[:-PLUGINS_KEPT]:
        old.unlink(missing_ok=True)
    shutil.rmtree(work)
    return Plugin(cached, recipe.double)


def _precompile(glue: Path, recipe: Recipe) -> None:
    """The headers, compiled once per glue and kind of arithmetic: they are half of what compiling a plugin takes. The compiler looks
    into prelude.hpp.gch/ for one that fits, and does without where there is none."""
    flags = [f for f in [*_common, *recipe.arithmetic()] if f != "-shared" and not f.startswith("-Wl,")]
    folder = glue / "prelude.hpp.gch"
    file = folder / hashlib.sha256("\0".join(flags).encode()).hexdigest()[:16]
    if file.exists() or recipe.contract or recipe.half:  # for the last, the compiler would not use one
        return
    with work_folder("precompile") as work:
        command = [
            "g++",
            *flags,
            f"-I{FRAMEWORK / 'include'}",
            f"-I{glue}",
            "-x",
            "c++-header",
            str(glue / "prelude.hpp"),
        ]
        if Sandbox(work).run([*command, "-o", str(work / "gch")], COMPILE_LIMITS).ok:
            try:
                folder.mkdir(exist_ok=True)
                shutil.move(work / "gch", temporary := glue / f"gch-{os.getpid()}-{threading.get_ident()}")
                os.replace(temporary, file)
            except OSError:
                pass  # another run has thrown it away meanwhile, for younger ones


# ------------------------------------------------------------------------------------------------- C++ messages

_located = re.compile(
    r"^(?P<file>[^\s:][^:]*):(?P<line>\d+)(?::(?P<column>\d+))?: (?P<kind>fatal error|error|note|warning): (?P<text>.*)$"
)
_required = re.compile(r"^(?:\./)?shading\.cpp:(?P<line>\d+):(?P<column>\d+):\s+required from here")
_undefined = re.compile(r"(?:undefined reference to|undefined symbol) [`'](?P<name>[^'(]+)")
_vec = re.compile(r"(?:glm::)?vec<(\d), (?:Real|float|double)(?:, (?:\(glm::qualifier\)0|glm::\w+))?>")


def _plain(text: str) -> str:
    """Types and functions as students write them: no namespaces, no template arguments, no aliases."""
    text = text.replace("‘", "'").replace("’", "'")
    text = _vec.sub(r"vec\1", text)
    text = re.sub(r"\bvec<(\d)(?:,\[\.\.\.\])*>", r"vec\1", text)
    text = re.sub(r" ?\{aka [^}]*\}", "", text)
    text = re.sub(r"\b(?:shadelab|glsl|glm|given|gen)::", "", text)
    text = re.sub(r"(\w)<[^<>]*(?:float|double|packed_highp|qualifier|defaultp)[^<>]*>", r"\1", text)
    return re.sub(r" +", " ", text).strip()


def _declared(assignment: Assignment) -> dict[str, str]:
    """How each function of the assignment is declared."""
    types = {name: name for name in assignment.structs}
    return {
        f.name: f"{f.returns} {f.name}({', '.join(f'{types.get(v.domain.type, v.domain.type)} {v.name}' for v in f.values)})"
        for f in assignment.functions
    }


def _behind_the_file(text: str, assignment: Assignment) -> str:
    """An error in the generated code is about how it calls the student's functions, or about what the file left open."""
    declared = _declared(assignment)
    for name, prototype in declared.items():
        if re.search(rf"\b{name}\b", text):
            if "not declared" in text:
                return f"the function {name} is missing; declare it as {prototype}"
            return f"the framework cannot call {name} ({text}); declare it as {prototype}"
    return f"{text} (noticed behind the file's end: is a brace, a comment or an #if left open?)"


def _name_is_taken(text: str, assignment: Assignment) -> str:
    """A helper with the name of a given function, called or defined: say so."""
    for earlier in assignment.given:
        for function in earlier.functions:
            if re.search(rf"'{function.name}\b", text) and ("ambiguous" in text or "redefin" in text):
                return f"{text}: {function.name} is a given function ({earlier.name}); choose another name for yours"
    return text


def readable_errors(stderr: str, assignment: Assignment) -> str:
    """At most MAX_LINES lines for each of the first errors, all in terms of the student's file."""
    lines = stderr.splitlines()
    out: list[str] = []
    called_from: str | None = None
    index = 0
    while index < len(lines):
        line = lines[index]
        index += 1
        if required := _required.match(line):
            called_from = f"shading.cpp:{required['line']}:{required['column']}"
            continue
        found = _located.match(line)
        if not found or "error" not in found["kind"]:
            continue
        text = _plain(found["text"])
        if Path(found["file"]).name == "shading.cpp" and "/" not in found["file"].removeprefix("./"):
            excerpt = []
            while index < len(lines) and re.match(r"^\s+\d* \|", lines[index]) and len(excerpt) < MAX_LINES - 1:
                excerpt.append(lines[index].rstrip())
                index += 1
            place = f"shading.cpp:{found['line']}" + (f":{found['column']}" if found["column"] else "")
            text = _name_is_taken(text, assignment)
            out.append("\n".join([f"{place}: {text}", *[e for e in excerpt if e.strip(" |")]]))
        elif called_from is not None:
            if not out:  # otherwise a consequence inside the library of what was reported already
                out.append(f"{called_from}: {text}")
        elif not out:
            out.append(f"shading.cpp: {_behind_the_file(text, assignment)}")
        called_from = None
    for name in dict.fromkeys(_plain(m["name"]) for m in _undefined.finditer(stderr)):
        out.append(f"shading.cpp: {name} is declared and called, but not defined")
    return "\n".join(out[:3])


# ------------------------------------------------------------------------------------------------ GLSL messages

_glsl = re.compile(
    r"^\s*(?P<source>\d+):(?P<line>\d+)\((?P<column>\d+)\): (?:preprocessor )?(?P<kind>error|warning): (?P<text>.*)$"
)


def readable_shader_errors(message: str, assignment: Assignment) -> str:
    """The driver's messages with the student's file and line; of lines outside it, what they mean for the student."""
    own: dict[int, str] = {}  # the first message of each line: what follows on it is a consequence
    others = []
    for line in message.splitlines():
        found = _glsl.match(line)
        if found and found["kind"] == "error":
            number, text = int(found["line"]), found["text"].removesuffix("; candidates are:").replace("`", "'")
            text = _name_is_taken(text, assignment)
            if "'main' redefined" in text:
                others.append("shading.glsl: remove main: the framework puts its own around your functions")
            elif number == 0:  # of the shader as a whole
                others.append(f"shading.glsl: {text}")
            elif number < PRELUDE_LINE:
                own.setdefault(number, f"shading.glsl:{number}:{found['column']}: {text}")
            else:
                others.append(
                    f"shading.glsl: {text} (noticed behind the file's end: is a brace, a comment or an #if left open?)"
                )
        elif "unresolved reference to function" in line:
            name = line.split("`")[-1].rstrip("'")
            others.append(
                f"shading.glsl: the function {name} is missing, or its arguments differ from the declared ones"
            )
    words = [line for line in message.splitlines() if line.strip(" =")]
    return "\n".join([*own.values()][:3] or others[:1] or words[:MAX_LINES])
