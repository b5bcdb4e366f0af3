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


_function = re.compile(r"^[ \t]*(?P<type>\w+)\s+(?P<name>\w+)\s*\([^()]*\)\s*(?=\{)", re.MULTILINE)
_token = re.compile(r"\w+|[(){};]|[^\s\w(){};]+")


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
    text = _without_main(text)
    remarks += _missing_returns(text)
    # Macros end where the file ends.
    end = "".join(f"\n#undef {name}" for name in dict.fromkeys(macros))
    end += "\n#define Real float" if "Real" in macros else ""
    return ShaderText(text + end, remarks, includes)


def _without_main(text: str) -> str:
    found = _main.search(text)
    end = _end_of_block(text, found.start()) if found else None
    if end is None:
        return text
    return text[: found.start()] + re.sub(r"[^\n]", " ", text[found.start() : end]) + text[end:]


def _end_of_block(text: str, start: int) -> int | None:
    """Behind the brace that closes the first one from there on; None where it is missing, which the driver says."""
    depth = 0
    for brace in re.compile("[{}]").finditer(text, start):
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            return brace.end()
    return None


def _missing_returns(text: str) -> list[str]:
    """Drivers take a function whose end is reached without a return, and give whatever they like."""
    remarks = []
    for found in _function.finditer(text):
        end = _end_of_block(text, found.end())
        body = text[found.end() : end]
        if found["type"] == "void" or end is None or "#" in body or _returns(_token.findall(body), 0)[0]:
            continue
        what = f"no return at the end of {found['name']}: where none before it is reached, what it gives is undefined"
        remarks.append(f"0:{_line(text, end)}(1): warning: {what}")
    return remarks


def _returns(tokens: list[str], at: int) -> tuple[bool, int]:
    """Whether the statement there always leaves the function, and where the next one begins. Loops without an end do, and of a
    switch it is assumed."""
    word = tokens[at] if at < len(tokens) else ";"
    if word == "{":
        leaves, at = False, at + 1
        while at < len(tokens) and tokens[at] != "}":
            one, at = _returns(tokens, at)
            leaves |= one
        return leaves, at + 1
    if word in ("if", "for", "while", "switch"):
        asked = at + 2
        at = _behind_parenthesis(tokens, at + 1)
        endless = "true" in tokens[asked:at] or tokens[asked : asked + 2] == [";", ";"]
        leaves, at = _returns(tokens, at)
        if word == "if" and tokens[at : at + 1] == ["else"]:
            other, at = _returns(tokens, at + 1)
            return leaves and other, at
        return word == "switch" or (word != "if" and endless), at
    if word == "do":
        leaves, at = _returns(tokens, at + 1)
    else:
        leaves = word in ("return", "discard")
    while at < len(tokens) and tokens[at] not in (";", "}"):
        at += 1
    return leaves, at + (tokens[at : at + 1] == [";"])


def _behind_parenthesis(tokens: list[str], at: int) -> int:
    depth = 0
    while at < len(tokens):
        depth += {"(": 1, ")": -1}.get(tokens[at], 0)
        at += 1
        if depth == 0:
            break
    return at


def _blank(found: re.Match, group: str | int = 0) -> str:
    return re.sub(r"[^\n]", " ", found[group])


def _line(text: str, place: int) -> int:
    return 1 + text.count("\n", 0, place)
