"""The body of a shading function as a tree: the small dialect that C++ and GLSL share. Only our own text is read so (the
solution, declared mistakes and variants); a statement that is none of these is left out of the tree, and so of what is bred
from it."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

_token = re.compile(
    r"//[^\n]*|\d+\.\d*(?:e[+-]?\d+)?f?|\d+|[A-Za-z_]\w*|<=|>=|==|!=|&&|\|\||[-+*/]=|\+\+|--|.", re.DOTALL
)
TYPES = ("Real", "int", "bool", "vec2", "vec3", "vec4")
# Loosest first.
_binary = [["||"], ["&&"], ["==", "!="], ["<", "<=", ">", ">="], ["+", "-"], ["*", "/", "%"]]


@dataclass
class Token:
    text: str
    start: int
    end: int


def tokens(body: str) -> list[Token]:
    found = [Token(m.group(), m.start(), m.end()) for m in _token.finditer(body)]
    return [t for t in found if not t.text.isspace() and not t.text.startswith("//")]


@dataclass
class Node:
    """An expression. `kind`: number | name | member | index | call | unary | binary | ternary | bracket."""

    kind: str
    start: int
    end: int
    name: str = ""  # of a name, a member or a called function; an operator; a number's digits
    parts: list["Node"] = field(default_factory=list)
    at: int = 0  # where the operator stands

    def all(self) -> Iterator["Node"]:
        yield self
        for part in self.parts:
            yield from part.all()


@dataclass
class Statement:
    """`kind`: declare | assign | return | if | loop | expression."""

    kind: str
    start: int
    end: int
    name: str = ""  # what is declared; the operator of an assignment
    type: str = ""
    expressions: list[Node] = field(default_factory=list)  # an assignment's: its target, then its value
    inner: list["Statement"] = field(default_factory=list)

    def all(self) -> Iterator["Statement"]:
        yield self
        for statement in self.inner:
            yield from statement.all()


class _Unknown(Exception):
    """This is not of the dialect."""


def parse(body: str, structs: tuple[str, ...] = ()) -> list[Statement]:
    """Its statements. `structs`: the names of types beside TYPES."""
    return _Parser(tokens(body), {*TYPES, *structs}).statements()


class _Parser:
    def __init__(self, tokens: list[Token], types: set[str]) -> None:
        self.tokens, self.types, self.at = tokens, types, 0

    def _next(self, ahead: int = 0) -> str:
        return self.tokens[self.at + ahead].text if self.at + ahead < len(self.tokens) else ""

    def _take(self, text: str | None = None) -> Token:
        if self.at >= len(self.tokens) or (text is not None and self._next() != text):
            raise _Unknown
        self.at += 1
        return self.tokens[self.at - 1]

    # --- statements ---

    def statements(self) -> list[Statement]:
        out = []
        while self.at < len(self.tokens) and self._next() != "}":
            first = self.at
            try:
                out += self._statement()
            except _Unknown:
                self.at = max(self.at, first)
                while self.at < len(self.tokens) and self._next() not in (";", "}"):
                    self.at += 1
                self.at += self._next() == ";"
        return out

    def _statement(self) -> list[Statement]:
        start = self.tokens[self.at].start
        if self._next() == "{":
            self._take()
            inner = self.statements()
            self._take("}")
            return inner
        if self._next() == ";":
            self._take()
            return []
        if self._next() == "if":
            return [self._if(start)]
        if self._next() in ("for", "while"):
            self._take()
            self._skip_brackets()
            inner = self._statement()
            return [Statement("loop", start, self._end(), inner=inner)]
        if self._next() == "return":
            self._take()
            value = self._expression()
            self._take(";")
            return [Statement("return", start, self._end(), expressions=[value])]
        if self._next() == "const":
            self._take()
        if self._next() in self.types and re.match(r"[A-Za-z_]", self._next(1)):
            return self._declarations(start)
        target = self._expression()
        if self._next() in ("=", "+=", "-=", "*=", "/="):
            operator = self._take().text
            value = self._expression()
            self._take(";")
            return [Statement("assign", start, self._end(), operator, expressions=[target, value])]
        self._take(";")
        return [Statement("expression", start, self._end(), expressions=[target])]

    def _if(self, start: int) -> Statement:
        self._take("if")
        self._take("(")
        condition = self._expression()
        self._take(")")
        inner = self._statement()
        if self._next() == "else":
            self._take()
            inner = inner + self._statement()
        return Statement("if", start, self._end(), expressions=[condition], inner=inner)

    def _declarations(self, start: int) -> list[Statement]:
        type, out = self._take().text, []
        while True:
            name = self._take().text
            values = []
            if self._next() == "=":
                self._take()
                values = [self._expression()]
            out.append(Statement("declare", start, self._end(), name, type, values))
            if self._next() != ",":
                break
            self._take()
        self._take(";")
        return out

    def _skip_brackets(self) -> None:
        depth = 0
        while True:
            depth += {"(": 1, ")": -1}.get(self._take().text, 0)
            if depth == 0:
                return

    def _end(self) -> int:
        return self.tokens[self.at - 1].end

    # --- expressions ---

    def _expression(self) -> Node:
        condition = self._operation(0)
        if self._next() != "?":
            return condition
        at = self._take().start
        yes = self._expression()
        self._take(":")
        no = self._expression()
        return Node("ternary", condition.start, no.end, "?", [condition, yes, no], at)

    def _operation(self, level: int) -> Node:
        if level == len(_binary):
            return self._unary()
        left = self._operation(level + 1)
        while self._next() in _binary[level]:
            operator = self._take()
            right = self._operation(level + 1)
            left = Node("binary", left.start, right.end, operator.text, [left, right], operator.start)
        return left

    def _unary(self) -> Node:
        if self._next() in ("-", "!", "+", "++", "--"):
            operator = self._take()
            operand = self._unary()
            return Node("unary", operator.start, operand.end, operator.text, [operand], operator.start)
        return self._postfix(self._primary())

    def _postfix(self, node: Node) -> Node:
        while True:
            if self._next() == ".":
                self._take()
                name = self._take()
                node = Node("member", node.start, name.end, name.text, [node])
            elif self._next() == "[":
                self._take()
                index = self._expression()
                node = Node("index", node.start, self._take("]").end, "", [node, index])
            else:
                return node

    def _primary(self) -> Node:
        token = self._take()
        if token.text == "(":
            inner = self._expression()
            return Node("bracket", token.start, self._take(")").end, "", [inner])
        if re.match(r"\d", token.text):
            return Node("number", token.start, token.end, token.text)
        if not re.match(r"[A-Za-z_]", token.text):
            raise _Unknown
        if self._next() != "(":
            return Node("name", token.start, token.end, token.text)
        self._take("(")
        arguments = []
        while self._next() != ")":
            arguments.append(self._expression())
            if self._next() != ")":
                self._take(",")
        return Node("call", token.start, self._take(")").end, token.text, arguments)
