"""What compilers say, as lines that a student can act on: the student's own file and line, and types as students write them."""

import re
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.evidence.missing import advice, definition, prototypes

MAX_LINES = 5  # of one error
PRELUDE_LINE = 1_000_001  # where the lines of the generated GLSL begin (glue.hpp); below it are the student's

# ------------------------------------------------------------------------------------------------- C++ messages

_located = re.compile(
    r"^(?P<file>[^\s:][^:]*):(?P<line>\d+)(?::(?P<column>\d+))?: (?P<kind>fatal error|error|note|warning): (?P<text>.*)$"
)
_in_function = re.compile(r"In (?:member )?function [‘'](?P<signature>[^’']*)")
_inlined = re.compile(r"^\s+inlined from .* at (?:\./)?shading\.cpp:(?P<line>\d+):(?P<column>\d+)")
_unset = re.compile(r"^'(?P<name>\w+)[^']*' (?:(?P<how>is|may be) )?used uninitialized")
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


# Of what g++ names no header, or another one than people include, and of what it hints at but once: the header of a name.
_headers = {
    "cstdio": "printf fprintf sprintf snprintf puts putchar fputs fflush stdout stderr FILE",
    "iostream": "cout cerr clog endl",
    "algorithm": "sort max_element min_element clamp find fill copy any_of all_of none_of count for_each transform",
    "numeric": "accumulate inner_product iota", "utility": "swap pair make_pair move", "limits": "numeric_limits",
    "cmath": "INFINITY NAN M_PI M_PI_2 M_1_PI isnan isinf isfinite signbit copysign hypot fma",
    "cstdlib": "abs rand srand malloc free exit getenv atoi", "cstring": "memcpy memset strlen strcmp",
    "cfloat": "FLT_MAX FLT_MIN FLT_EPSILON DBL_MAX DBL_EPSILON", "cassert": "assert", "cstddef": "size_t ptrdiff_t",
    "numbers": "numbers", "random": "mt19937 uniform_real_distribution", "chrono": "chrono", "thread": "thread",
    "vector": "vector", "string": "string to_string", "array": "array", "map": "map", "set": "set",
    "functional": "function", "sstream": "ostringstream stringstream", "iomanip": "setprecision setw",
    "format": "format", "optional": "optional", "tuple": "tuple tie", "memory": "unique_ptr make_unique shared_ptr",
}  # fmt: skip
_HEADERS = {name: header for header, names in _headers.items() for name in names.split()}
_GLOBAL = {"cstdio", "cstdlib", "cstring", "cfloat", "cassert", "cstddef", "cmath"}  # from C: known without std::, too
_unknown_name = re.compile(r"^'(?P<name>\w+)' (?:was not declared in this scope|is not a member of 'std')")
_hint = re.compile(r"[‘'](?:std::)?(?P<name>\w+)[’'] is defined in header [‘']<(?P<header>[\w.]+)>[’']")


def _missing_header(text: str, hints: dict[str, str]) -> str | None:
    """What to include, where a name of the standard library is missing. hints: g++'s own, which say of each header once."""
    found = _unknown_name.match(text)
    name = found["name"] if found else ""
    header = _HEADERS.get(name) or hints.get(name)
    if not header:
        return None
    inside = "is not a member" in found[0] or header in _GLOBAL
    said = found[0] if inside else f"{found[0]}: it is std::{name}"
    return f"{said}; put #include <{header}> at the top of shading.cpp"


def _called(signature: str) -> str:
    """The function's name in a signature."""
    found = re.search(r"(\w+)\(", signature)
    return found[1] if found else ""


def _behind_the_file(text: str, assignment: Assignment) -> str:
    """An error in the generated code is about how it calls the student's functions, or about what the file left open."""
    declared = prototypes(assignment)
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


def _own(file: str) -> bool:
    """Whether it is the student's file, which is compiled in the folder where it lies."""
    return Path(file).name == "shading.cpp" and "/" not in file.removeprefix("./")


def _no_return(text: str, function: str) -> str:
    """The compiler speaks of control and of void; what is missing is a return."""
    if not function or not ("control reaches end of" in text or "no return statement in function" in text):
        return text
    return f"no return at the end of {function}: where none before it is reached, what it gives is undefined"


def readable_errors(stderr: str, assignment: Assignment) -> str:
    """At most MAX_LINES lines for each of the first errors, all in terms of the student's file."""
    lines = stderr.splitlines()
    hints = {m["name"]: m["header"] for m in _hint.finditer(stderr)}
    without: set[str] = set()  # lines that lack a header, of which more errors are a consequence
    out: list[str] = []
    called_from: str | None = None
    function = ""  # which one the messages are about
    index = 0
    while index < len(lines):
        line = lines[index]
        index += 1
        if required := _required.match(line):
            called_from = f"shading.cpp:{required['line']}:{required['column']}"
            continue
        if inside := _in_function.search(line):
            function = _called(inside["signature"])
        found = _located.match(line)
        if not found or "error" not in found["kind"]:
            continue
        text = _no_return(_plain(found["text"]), function)
        if _own(found["file"]):
            excerpt = []
            while index < len(lines) and re.match(r"^\s+\d* \|", lines[index]) and len(excerpt) < MAX_LINES - 1:
                excerpt.append(lines[index].rstrip())
                index += 1
            place = f"shading.cpp:{found['line']}" + (f":{found['column']}" if found["column"] else "")
            if header := _missing_header(text, hints):
                text, excerpt = header, [] if found["line"] in without else excerpt[:1]
                without.add(found["line"])
            elif found["line"] in without:
                continue
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


def readable_warnings(stderr: str) -> str:
    """A line for each of the first warnings about the student's own lines, one for all members of a variable."""
    out: dict[tuple, str] = {}
    at: re.Match | None = None  # the student's line into which the compiler has copied the code that it warns of
    last: tuple | None = None  # of a warning that stands outside the student's file, until a note names a line in it
    for line in stderr.splitlines():
        if inlined := _inlined.match(line):
            at = at or inlined
            continue
        found = _located.match(line)
        if not found:
            continue
        own = found if _own(found["file"]) else None
        if found["kind"] == "warning":
            place, at = own or at, None
            text = _plain(found["text"])
            unset = _unset.match(text)
            if unset:
                text = f"{unset['name']} {unset['how']} used before anything was stored in it"
            last = (unset["name"] if unset else text, text)
            if place:
                out.setdefault((last[0], place["line"]), f"shading.cpp:{place['line']}:{place['column']}: {text}")
                last = None
        elif found["kind"] == "note" and own and last:
            out.setdefault((last[0], own["line"]), f"shading.cpp:{own['line']}:{own['column']}: {last[1]}")
            last = None
    return "\n".join([*out.values()][:MAX_LINES])


# ------------------------------------------------------------------------------------------------ GLSL messages

_glsl = re.compile(
    r"^\s*(?P<source>\d+):(?P<line>\d+)\((?P<column>\d+)\): (?:preprocessor )?(?P<kind>error|warning): (?P<text>.*)$"
)


def readable_shader_warnings(log: str) -> str:
    """A line for each of the first warnings about the student's own lines."""
    found = (
        m
        for m in map(_glsl.match, log.splitlines())
        if m and m["kind"] == "warning" and 0 < int(m["line"]) < PRELUDE_LINE
    )
    lines = {}
    for m in found:
        text = _unset.sub(r"\g<name> is used before anything was stored in it", m["text"].replace("`", "'"))
        lines.setdefault(text, f"shading.glsl:{m['line']}:{m['column']}: {text}")
    return "\n".join([*lines.values()][:MAX_LINES])


def _missing(name: str, student: str, assignment: Assignment) -> str:
    """The linker misses what a prototype of ours promises."""
    prototype = prototypes(assignment).get(name)
    if prototype is None:
        return f"shading.glsl: the function {name} is called and not defined"
    if own := definition(name, student):
        return f"shading.glsl:{own[0]}: {own[1]} is not the function that is asked for; declare it as {prototype}"
    return f"shading.glsl: the function {name} {advice(name, student, assignment)}"


def _told(text: str, student: str, assignment: Assignment) -> str:
    """What a driver says of a student's line, as advice where its words speak of code that the student does not see."""
    name = (re.search(r"function '(\w+)'", text) or ["", ""])[1]
    prototype = prototypes(assignment).get(name)
    if "qualifiers don't match prototype" in text and prototype:
        return f"{name} is given values, and cannot have out or inout arguments; declare it as {prototype}"
    if "return type doesn't match prototype" in text and prototype:
        return f"{name} returns another type than is asked for; declare it as {prototype}"
    if f"function '{name}' redefined" in text and len(re.findall(rf"\b{name}\s*\([^()]*\)\s*\{{", student)) == 1:
        if not any(name == f.name for earlier in assignment.given for f in earlier.functions):
            return f"{name} is one of the framework's functions already; remove yours, or choose another name"
    return _name_is_taken(text, assignment)


def _of_the_whole(text: str, student: str) -> str:
    """What a driver says without a line: the line is found in the student's text."""
    if recursive := re.match(r"function '[\w ]*?(\w+)\(.*static recursion", text):
        line = (definition(recursive[1], student) or ["?"])[0]
        return f"shading.glsl:{line}: {recursive[1]} calls itself, directly or through others; GLSL has no recursion"
    if written := re.search(r"gl_Frag(?:Color|Data|Depth)", text):
        line = 1 + student.partition(written[0])[0].count("\n")
        return f"shading.glsl:{line}: {written[0]} is for a main; a function gives what it returns"
    return f"shading.glsl: {text}"


def readable_shader_errors(message: str, assignment: Assignment, student: str) -> str:
    """The driver's messages with the student's file and line; of lines outside it, what they mean for the student."""
    own: dict[int, str] = {}  # the first message of each line: what follows on it is a consequence
    others = []
    for line in message.splitlines():
        found = _glsl.match(line)
        if found and found["kind"] == "error":
            number, text = int(found["line"]), found["text"].removesuffix("; candidates are:").replace("`", "'")
            if text == "Unterminated comment":  # told at the end; what helps is where it begins
                number = 1 + student.count("\n", 0, student.rfind("/*"))
            if number == 0:
                others.append(_of_the_whole(text, student))
            elif number < PRELUDE_LINE:
                own.setdefault(number, f"shading.glsl:{number}:{found['column']}: {_told(text, student, assignment)}")
            else:
                others.append(
                    f"shading.glsl: {text} (noticed behind the file's end: is a brace, a comment or an #if left open?)"
                )
        elif "unresolved reference to function" in line:
            others.append(_missing(line.split("`")[-1].rstrip("'"), student, assignment))
    words = [line for line in message.splitlines() if line.strip(" =")]
    return "\n".join([*own.values()][:3] or others[:1] or words[:MAX_LINES])
