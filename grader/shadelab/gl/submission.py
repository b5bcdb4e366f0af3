"""A student's GLSL as it goes to the driver, line for line: what the framework writes itself, what other dialects have, and
what belongs to a main of the student's own gets out of the way, so that no habit costs a language."""

import re
from dataclasses import dataclass

from shadelab.words import decoded

_comment = re.compile(r"//(?:\\\n|[^\n])*|/\*.*?\*/", re.DOTALL)
_directive = re.compile(r"^[ \t]*#[ \t]*(?P<name>\w+)[ \t]*(?P<rest>.*)$", re.MULTILINE)
# What stands before every shader already, and may stand nowhere else; #line would move the lines of messages.
_framework_lines = ("version", "extension", "line")
# Precisions are a matter of OpenGL ES; ours has one. Prototypes have none, and drivers want the two alike.
_precision = re.compile(r"\bprecision\s+(?:lowp|mediump|highp)\s+\w+\s*;|\b(?:lowp|mediump|highp)\b")
# `const` of a parameter: a prototype of ours has none.
_const_parameter = re.compile(r"(?<=[(,])(?P<space>\s*)(?:const\s+in|in\s+const|const)(?=\s+\w+\s+\w+\s*[,)\[])")
_main = re.compile(r"^[ \t]*(?:void|int)\s+main\s*\([^)]*\)\s*\{", re.MULTILINE)
# What a stage of the student's own would get or give. The functions stand in whichever stage needs them.
_interface = re.compile(
    r"^(?P<words>[ \t]*(?:layout\s*\([^)]*\)\s*)?(?:(?:flat|smooth|noperspective|centroid|invariant)\s+)*"
    r"(?P<kind>in|out|attribute|varying))(?=\s+\w+\s+[^;(){}]*;)",
    re.MULTILINE,
)
_uniform = re.compile(r"^[ \t]*(?:layout\s*\([^)]*\)\s*)?(?P<kind>uniform)\s+\w+\s+[^;(){}]*;", re.MULTILINE)


@dataclass
class ShaderText:
    text: str
    remarks: list[str]  # as a driver writes warnings
    includes: list[str]  # as a driver writes errors: what is missing may be what else it complains of


def read(data: bytes) -> ShaderText:
    """In any encoding that says which it is."""
    text = decoded(data).replace("\r\n", "\n").replace("\r", "\n").replace("\0", " ")
    text = _comment.sub(_blank, text)
    remarks, includes, macros = [], [], []
    for found in _directive.finditer(text):
        name, line = found["name"], _line(text, found.start())
        if name in ("define", "undef"):
            macros += re.match(r"\w*", found["rest"]).group().split()
        elif name == "include":
            what = "GLSL has no #include; the line is left out, and what it would bring is missing"
            remarks.append(f"0:{line}(1): warning: {what}")
            includes.append(f"0:{line}(1): error: {what}")
    text = _directive.sub(lambda m: _blank(m) if m["name"] in (*_framework_lines, "include") else m[0], text)
    text = re.sub(r"^(?![ \t]*#).*$", lambda m: _precision.sub(_blank, m[0]), text, flags=re.MULTILINE)
    text = _const_parameter.sub(lambda m: m["space"] + " " * (len(m[0]) - len(m["space"])), text)
    for found in [*_interface.finditer(text), *_uniform.finditer(text)]:
        if found["kind"] != "out":
            what = (
                f"nothing sets this variable ({found['kind']}): a function is given all that it needs as its arguments"
            )
            remarks.append(f"0:{_line(text, found.start())}(1): warning: {what}")
    text = _interface.sub(lambda m: _blank(m, "words"), text)
    # Macros end where the file ends.
    end = "".join(f"\n#undef {name}" for name in dict.fromkeys(macros))
    end += "\n#define Real float" if "Real" in macros else ""
    return ShaderText(_without_main(text) + end, remarks, includes)


def _without_main(text: str) -> str:
    found = _main.search(text)
    if not found:
        return text
    depth = 0
    for brace in re.finditer(r"[{}]", text[found.start() :]):
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            end = found.start() + brace.end()
            return text[: found.start()] + re.sub(r"[^\n]", " ", text[found.start() : end]) + text[end:]
    return text  # the driver says where a brace is missing


def _blank(found: re.Match, group: str | int = 0) -> str:
    return re.sub(r"[^\n]", " ", found[group])


def _line(text: str, place: int) -> int:
    return 1 + text.count("\n", 0, place)
