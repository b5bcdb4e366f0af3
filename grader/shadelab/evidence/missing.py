"""Functions that a submission lacks, a worked example that was deleted, say: whatever does not need them is graded all the same.
The compiler gets stand-ins. In C++ they end the program; in GLSL, which cannot, whatever leads to a call of one is not asked."""

import difflib
import re

from shadelab.course.assignment import Assignment

MARK = "shadelab: called, and missing: "  # what a stand-in says as its last word


def prototypes(assignment: Assignment) -> dict[str, str]:
    """How each function of the assignment is declared."""
    types = {name: name for name in assignment.structs}
    return {
        f.name: f"{f.returns} {f.name}({', '.join(f'{types.get(v.domain.type, v.domain.type)} {v.name}' for v in f.values)})"
        for f in assignment.functions
    }


def definition(name: str, text: str) -> tuple[int, str] | None:
    """Where the student's text defines a function, and how."""
    found = re.search(rf"^[ \t]*(?:\w+[ \t]+)+{name}\s*\([^)]*\)(?=\s*\{{)", text, re.MULTILINE)
    return (1 + text.count("\n", 0, found.start()), " ".join(found[0].split())) if found else None


def missing(assignment: Assignment, text: str) -> list[str]:
    """The functions that the text does not define; none where it defines none, which then is another fault."""
    names = [f.name for f in assignment.functions]
    bare = re.sub(r"//[^\n]*|/\*.*?\*/", " ", text, flags=re.DOTALL)
    absent = [name for name in names if not re.search(rf"\b{name}\s*\([^;{{}}]*\)\s*(?:noexcept\s*)?\{{", bare)]
    return absent if len(absent) < len(names) else []


def with_stand_ins(assignment: Assignment, text: str, names: list[str]) -> str:
    """The C++ with them: its own lines keep their numbers."""
    declared = prototypes(assignment)
    before = "".join(f"{declared[name]}; " for name in names)
    after = "".join(f'{declared[name]} {{ shadelab_missing("{name}"); }}\n' for name in names)
    stop = (
        "[[noreturn]] static void shadelab_missing(const char* name) "
        f'{{ std::fprintf(stderr, "\\n{MARK}%s\\n", name); std::_Exit(3); }}\n'
    )
    return f"#include <cstdio>\n#include <cstdlib>\n{before}\n#line 1\n{text}\n{stop}{after}"


def with_empty(assignment: Assignment, text: str, names: list[str]) -> str:
    """The GLSL with definitions that give 0, behind the lines of its own."""

    def zero(type: str) -> str:
        if type in assignment.structs:
            return f"{type}({', '.join(zero(v.domain.type) for v in assignment.structs[type].values)})"
        return {"Real": "0.0", "int": "0"}.get(type, f"{type}(0.0)")

    declared = prototypes(assignment)
    returns = {f.name: f.returns for f in assignment.functions}
    bodies = (f"{declared[name]} {{ return {zero(returns[name])}; }}" for name in names)
    return text + "\n" + re.sub(r"\bReal\b", "float", "\n".join(bodies)) + "\n"


def leading_to(names: list[str], text: str) -> dict[str, str]:
    """The functions that call one of these, directly or through others of the text, and which one; themselves, too."""
    bare = re.sub(r"//[^\n]*|/\*.*?\*/", " ", text, flags=re.DOTALL)
    starts = [*re.finditer(r"\b(?!return\b|else\b)\w+\s+(\w+)\s*\([^;{}()]*\)\s*\{", bare)]
    ends = [*(m.start() for m in starts[1:]), len(bare)]
    calls = {m[1]: set(re.findall(r"\b(\w+)\s*\(", bare[m.end() : end])) for m, end in zip(starts, ends)}
    out = {name: name for name in names}
    while more := {f: out[c] for f, callees in calls.items() if f not in out for c in sorted(callees & set(out))}:
        out |= more
    return out


def called(stderr: str, names: list[str]) -> str | None:
    """Which one a program ended with."""
    last = stderr.rstrip().rpartition(MARK)[2]
    return last if MARK in stderr and last in names else None


def advice(name: str, text: str, assignment: Assignment) -> str:
    """What to do: after "the function f" and the like. text: the student's file."""
    declared = prototypes(assignment)
    others = [n for n in re.findall(r"(\w+)\s*\([^()]*\)\s*\{", text) if n not in declared]
    near = difflib.get_close_matches(name, others, 1)
    like = f" ({near[0]} in line {at[0]} looks like it)" if near and (at := definition(near[0], text)) else ""
    return f"is missing{like}; declare it as {declared[name]}"
