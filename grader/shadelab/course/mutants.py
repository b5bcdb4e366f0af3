"""Mistakes that nobody thought of: the reference with one thing changed. A mutant changes a single operator, constant, call or
pair of arguments (mutation testing: `check` holds that the grader's tables tell each from the solution). A slip is what people
do besides: the wrong one of two directions, a clamp, a factor, a term, a root or a pair of brackets forgotten.

Each has words for what it changes, made from the declaration and never from a line: they are told to a student whose numbers are
those of the changed reference. Where a change has no such words, it has none, and is bred for `check` alone."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations, product

from shadelab.course.assignment import Assignment, Function
from shadelab.course.bodies import Node, Statement, parse

SWAPS = {
    "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "<": ["<=", ">"], "<=": ["<", ">"], ">": [">=", "<"], ">=": [">", "<"],
    "==": ["!="], "!=": ["=="], "&&": ["||"], "||": ["&&"],
}  # fmt: skip
SYMMETRIC = ("dot", "min", "max")  # exchanging their arguments changes nothing
SISTERS = {
    "min": "max",
    "max": "min",
    "sin": "cos",
    "cos": "sin",
    "acos": "asin",
    "asin": "acos",
    "exp": "exp2",
    "log": "log2",
}
# What one argument decides of the type of a call's result; others give a Real.
_as_argument = {
    "normalize",
    "reflect",
    "cross",
    "abs",
    "min",
    "max",
    "clamp",
    "mix",
    "pow",
    "exp",
    "log",
    "sqrt",
    "sign",
    "floor",
}


@dataclass(frozen=True)
class Mutant:
    id: str  # "phong_lobe: <= -> < in if (c <= limit) return less;"
    function: str
    body: str
    words: str = ""  # "with n.v in the place of n.l": after "as those of the reference"
    slip: bool = False


@dataclass(frozen=True)
class InnerQuantity:
    """A body that gives an inner quantity in the place of the result: what a local or a called function stands for."""

    words: str  # "n.l", "fresnel_schlick", "t"
    function: str
    body: str
    moved: str  # the same with 1 added: where both give the same, the quantity was not come to
    width: int  # 1 or 3, the first columns of what it gives


@dataclass(frozen=True)
class _Change:
    what: str
    start: int
    end: int
    new: str
    at: int = 0  # where it is listed: in the order of the text
    words: str = ""
    slip: bool = False


@dataclass
class Scope:
    """What names stand for inside of a function."""

    types: dict[str, str]  # of arguments; of locals once they are declared
    members: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # struct -> member -> type
    functions: Mapping[str, Function] = field(default_factory=dict)  # those that it may call
    colours: frozenset[str] = frozenset()  # arguments, and members of them, that are one
    contract: str = ""  # the comment above the function: the names that it uses are everybody's

    @classmethod
    def of(cls, assignment: Assignment, function: Function, text: str = "") -> "Scope":
        """`text`: of the solution, for the contract."""
        types = {v.name: v.domain.type for v in function.values}
        members = {name: {v.name: v.domain.type for v in s.values} for name, s in assignment.structs.items()}
        before = [f for given in assignment.given for f in given.functions]
        for one in assignment.functions:
            if one.name == function.name:
                break
            before.append(one)
        above = re.search(rf"((?://.*\n)+)\w+ {function.name}\(", text)
        colours = frozenset(c.path for c in function.inputs if c.width == 3 and c.domain.kind == "rgb")
        return cls(types, members, {f.name: f for f in before}, colours, above[1] if above else "")


def mutants(function: str, body: str, scope: Scope | None = None) -> list[Mutant]:
    """Slips need a scope: without one, single tokens are changed alone."""
    out, seen, bodies = [], Counter(), {body}
    for change in sorted(_Breeder(body, scope or Scope({})).changes(), key=lambda c: c.at):
        if change.slip and scope is None:
            continue
        changed = body[: change.start] + change.new + body[change.end :]
        if changed in bodies:
            continue
        bodies.add(changed)
        line = body[body.rfind("\n", 0, change.at) + 1 :].split("\n", 1)[0].strip()
        name = f"{function}: {change.what} in {line}"
        seen[name] += 1
        numbered = name + (f" ({seen[name]})" if seen[name] > 1 else "")
        out.append(Mutant(numbered, function, changed, change.words, change.slip))
    return out


def probes(function: Function, body: str, scope: Scope) -> list[InnerQuantity]:
    """Of what has words."""
    return list(_Breeder(body, scope).probes(function))


class _Breeder:
    def __init__(self, body: str, scope: Scope) -> None:
        self.body, self.scope = body, scope
        self.types = dict(scope.types)
        self.meanings: dict[str, Node] = {}  # of locals: what they were declared as
        self.statements = parse(body, tuple(scope.members))

    def changes(self) -> Iterator[_Change]:
        without = re.sub(r"\b(\w+) \* \1\b(?! \*)", r"\1", self.body)
        if without != self.body:
            yield _Change("no squares", 0, len(self.body), without, 0, "without the squares", True)
            absolute = re.sub(r"\b(\w+) \* \1\b(?! \*)", r"abs(\1)", self.body)
            yield _Change(
                "abs for squares", 0, len(self.body), absolute, 0, "with absolute values in the place of squares", True
            )
        for top in self.statements:
            for statement in top.all():
                yield from self._of_statement(statement)
                for expression in statement.expressions[1:] if statement.kind == "assign" else statement.expressions:
                    yield from self._of_expression(expression)
                if statement.kind == "declare":
                    self.types[statement.name] = statement.type
                    if statement.expressions:
                        self.meanings[statement.name] = statement.expressions[0]

    def probes(self, function: Function) -> Iterator[InnerQuantity]:
        seen: set[str] = set()
        for statement in self.statements:
            values = statement.expressions[1:] if statement.kind == "assign" else statement.expressions
            if statement.kind in ("declare", "assign", "return"):
                for node in (n for value in values for n in value.all()):
                    if node.kind == "call" and node.name in self.scope.functions and node.name not in seen:
                        seen.add(node.name)
                        yield from self._probe(function, node.name, self._text(node), self._type(node), statement.start)
            if statement.kind == "declare":
                self.types[statement.name] = statement.type
                if statement.expressions:
                    self.meanings[statement.name] = statement.expressions[0]
                words = self._words(Node("name", 0, 0, statement.name))
                if words and words not in seen and not _is_number(words):
                    seen.add(words)
                    yield from self._probe(function, words, statement.name, statement.type, statement.end)

    def _probe(self, function: Function, words: str, value: str, type: str, at: int) -> Iterator[InnerQuantity]:
        texts = [self._as(function.returns, text, type) for text in (value, f"({value} + 1.0)")]
        if all(texts):
            bodies = [f"{self.body[:at]};\nreturn {text};" for text in texts]
            yield InnerQuantity(words, function.name, *bodies, 3 if type == "vec3" else 1)

    def _as(self, returns: str, value: str, type: str) -> str:
        """A quantity as a function's result; empty where it does not fit into one."""
        if type not in ("Real", "vec3"):
            return ""
        if returns == "Real":
            return value if type == "Real" else ""
        if returns == "vec3":
            return value if type == "vec3" else f"vec3({value})"
        first, *others = self.scope.members.get(returns, {}).values()
        zeros = [{"Real": "0.0", "vec3": "vec3(0.0)"}.get(other, "") for other in others]
        return f"{returns}({', '.join([self._as(first, value, type), *zeros])})" if all(zeros) else ""

    # --- words ---

    def _words(self, node: Node) -> str:
        """What a value is for whoever knows the contract; empty where that takes more than a few words."""
        if node.kind == "bracket":
            return self._words(node.parts[0])
        if node.kind == "name":
            if node.name in self.scope.types:
                return node.name
            meaning = self.meanings.get(node.name)
            words = self._words(meaning) if meaning else ""
            known = node.name not in ("a", "I") and re.search(rf"\b{node.name}\b", self.scope.contract)
            return words or (node.name if known else "")
        if node.kind == "member":
            of = self._words(node.parts[0])
            return f"{of}.{node.name}" if of and re.fullmatch(r"[\w.]+", of) else ""
        if node.kind == "number":
            return f"{float(node.name.rstrip('f')):.7g}"
        if node.kind == "unary" and node.name == "-":
            inner = self._words(node.parts[0])
            return f"-{inner}" if inner else ""
        if node.kind == "call":
            return self._words_of_call(node)
        if node.kind == "binary" and node.name in ("*", "+", "-"):
            return self._words_of_few(node)
        return ""

    def _words_of_few(self, node: Node) -> str:
        """Two quantities that belong together: ior^2, (1 - c). More would be a line."""
        one, other = (self._words(part) for part in node.parts)
        if not one or not other or len(one + other) > 16 or "(" in one + other or " " in one + other:
            return ""
        if node.name == "*":
            return f"{one}^2" if one == other else f"{one} {other}"
        return f"({one} {node.name} {other})"

    def _words_of_call(self, node: Node) -> str:
        arguments = [self._words(part) for part in node.parts]
        if node.name == "dot" and len(arguments) == 2 and all(arguments):
            return _dot(*arguments)
        if node.name.startswith("vec") and len(arguments) == 1 and _is_number(arguments[0]):
            return arguments[0]
        if node.name in ("max", "clamp") and arguments and arguments[0]:
            return f"{arguments[0]} clamped"
        if node.name in self.scope.functions:
            return self.scope.functions[node.name].name
        return ""

    def _text(self, node: Node) -> str:
        return self.body[node.start : node.end]

    # --- types ---

    def _type(self, node: Node) -> str:
        if node.kind == "number":
            return "Real"
        if node.kind == "name":
            return self.types.get(node.name, "")
        if node.kind in ("bracket", "unary"):
            return self._type(node.parts[0])
        if node.kind == "member":
            of = self._type(node.parts[0])
            return "Real" if of.startswith("vec") else self.scope.members.get(of, {}).get(node.name, "")
        if node.kind == "index":
            return "Real"
        if node.kind == "ternary":
            return self._type(node.parts[1])
        if node.kind == "binary":
            if node.name in ("+", "-", "*", "/"):
                kinds = {self._type(part) for part in node.parts}
                return next((k for k in kinds if k.startswith("vec")), "Real" if kinds <= {"Real", "int"} else "")
            return "bool"
        if node.name in self.scope.functions:
            return self.scope.functions[node.name].returns
        if node.name in _as_argument and node.parts:
            kinds = [self._type(part) for part in node.parts]
            return next((k for k in kinds if k.startswith("vec")), kinds[0])
        return node.name if node.name.startswith("vec") or node.name in self.scope.members else "Real"

    # --- what is changed ---

    def _of_statement(self, s: Statement) -> Iterator[_Change]:
        if s.kind == "if" and len(s.inner) == 1 and s.inner[0].kind == "return":
            about = self._asked(s.expressions[0])
            yield _Change(
                "if dropped", s.start, s.end, "", s.start, f"without the question about {about}" if about else ""
            )
        if s.kind == "assign" and s.name != "=":
            value = self._words(s.expressions[1])
            for new, said in {"*=": [("+=", "added")], "+=": [("*=", "multiplied")]}.get(s.name, ()):
                at = self.body.index(s.name, s.expressions[0].end)
                words = (
                    f"with {value} {said} where it is to be {'multiplied' if new == '+=' else 'added'}" if value else ""
                )
                yield _Change(f"{new} for {s.name}", at, at + 2, new, s.start, words, slip=True)
            verb = {"*=": "without the factor", "/=": "without the division by"}.get(s.name, "without the term")
            yield _Change(
                "assignment dropped", s.start, s.end, "", s.start, f"{verb} {value}" if value else "", slip=True
            )

    def _asked(self, condition: Node) -> str:
        """About what a condition asks."""
        found = []
        for node in condition.all():
            if node.kind == "binary" and node.name in ("<", "<=", ">", ">=", "==", "!="):
                found += [words for part in node.parts if (words := self._words(part)) and not _is_number(words)]
        return " and ".join(dict.fromkeys(found))

    def _of_expression(self, root: Node) -> Iterator[_Change]:
        yield from self._throughout(root)
        self.divisors = {id(n) for q in root.all() if q.kind == "binary" and q.name == "/" for n in q.parts[1].all()}
        parents = {id(part): node for node in root.all() for part in node.parts}
        for node in root.all():
            yield from getattr(self, f"_of_{node.kind}", lambda *_: ())(node, parents.get(id(node)))

    def _throughout(self, root: Node) -> Iterator[_Change]:
        """What somebody does wherever a formula has the same: a square forgotten, another quantity taken."""
        text = self._text(root)
        for new, words in ((r"\1", "without the squares in"), (r"abs(\1)", "with absolute values for the squares of")):
            changed = re.sub(r"\b(\w+) \* \1\b(?! \*)", new, text)
            if changed != text:
                yield self._slip(f"{words} one formula", root, changed, f"{words} one formula")
        uses: dict[str, list[Node]] = {}
        for node in root.all():
            if node.kind == "name":
                uses.setdefault(node.name, []).append(node)
        for name, nodes in uses.items():
            type, mine = self.types.get(name, ""), self._words(nodes[0])
            if len(nodes) < 2 or not type or not mine:
                continue
            others = {other: self._words(Node("name", 0, 0, other)) for other, t in self.types.items() if t == type}
            if type == "Real":
                others |= {f"sqrt({name})": f"the root of {mine}", f"({name} * {name})": f"the square of {mine}"}
            for other, theirs in others.items():
                if theirs and theirs != mine:
                    said = f"with {theirs} in the place of {mine} throughout a formula"
                    yield self._slip(f"{other} for every {name}", root, self._with(root, nodes, other), said)

    def _with(self, root: Node, nodes: list[Node], new: str) -> str:
        """The text of `root` with others in the place of some of its nodes."""
        text = self._text(root)
        for node in sorted(nodes, key=lambda n: -n.start):
            text = text[: node.start - root.start] + new + text[node.end - root.start :]
        return text

    def _terms(self, node: Node) -> list[tuple[str, Node]]:
        """Of a sum, each with its sign."""
        if node.kind != "binary" or node.name not in ("+", "-"):
            return [("+", node)]
        return [*self._terms(node.parts[0]), (node.name, node.parts[1])]

    def _of_sum(self, node: Node) -> Iterator[_Change]:
        """Two of its terms changed at once; a sum of squares as the square of the sum."""
        terms = self._terms(node)
        texts, words = [self._text(t) for _, t in terms], [self._words(t) for _, t in terms]
        changes = {
            "left out": lambda sign: None, "negated": lambda sign: "-" if sign == "+" else "+", "doubled": lambda sign: f"{sign} 2.0 *"
        }  # fmt: skip
        if len(terms) > 2 and all(words):
            for i, j in combinations(range(len(terms)), 2):
                for (one, first), (two, second) in product(changes.items(), repeat=2):
                    signs = [sign for sign, _ in terms]
                    signs[i], signs[j] = first(signs[i]), second(signs[j])
                    left = "".join(f" {sign} ({text})" for sign, text in zip(signs, texts) if sign)
                    said = f"with {words[i]} {one} and {words[j]} {two}"
                    yield self._slip(f"{said}", node, f"({left.lstrip(' +') or '0.0'})", said)
        for (_, term), text, word in zip(terms, texts, words) if len(terms) > 1 and self._type(node) == "Real" else ():
            if word and term.kind == "binary":
                yield self._slip(f"{word} squared", term, f"(({text}) * ({text}))", f"with {word} squared")
        roots = [self._root(t) for _, t in terms]
        if len(terms) == 2 and all(roots):
            total = f"({roots[0]} {terms[1][0]} {roots[1]})"
            said = "with the square of a sum in the place of a sum of squares"
            yield self._slip("square of the sum", node, f"({total} * {total})", said)

    def _root(self, node: Node) -> str:
        """Of what it is the square."""
        if node.kind == "bracket":
            return self._root(node.parts[0])
        texts = [self._text(part) for part in node.parts] if node.kind == "binary" and node.name == "*" else ["", "."]
        return f"({texts[0]})" if texts[0] == texts[1] else ""

    def _of_binary(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        left, right = node.parts
        if node.name in ("+", "-") and not (
            parent is not None and parent.kind == "binary" and parent.name in ("+", "-")
        ):
            yield from self._of_sum(node)
        for new in SWAPS.get(node.name, ()):
            yield _Change(
                f"{node.name} -> {new}", node.at, node.at + len(node.name), new, node.at, self._swapped(node, new)
            )
        texts = [self._text(part) for part in node.parts]
        words = [self._words(part) for part in node.parts]
        if node.name in ("&&", "||"):
            for k, other in ((0, 1), (1, 0)):
                about = self._asked(node.parts[other])
                said = f"without the question about {about}" if about else ""
                yield self._slip("half of a condition", node, texts[k], said)
        if node.name in ("+", "-"):
            for k, word in enumerate(words):
                rest = texts[1 - k] if k or node.name == "+" else f"(-({texts[1]}))"
                yield self._slip(f"term {k + 1} left out", node, rest, f"without the term {word}" if word else "")
                twice = f"2.0 * ({texts[k]})"
                new = f"{twice} {node.name} {texts[1]}" if k == 0 else f"{texts[0]} {node.name} {twice}"
                yield self._slip(f"term {k + 1} twice", node, f"({new})", f"with {word} counted twice" if word else "")
        if node.name == "*":
            for k, word in enumerate(words):
                below = id(node) in self.divisors
                if self._type(node.parts[1 - k]) == self._type(node) or self._type(node) == "Real":
                    said = f"without the {'division by' if below else 'factor'} {word}" if word else ""
                    yield self._slip(f"factor {k + 1} left out", node, texts[1 - k], said)
                said = f"with the {'divisor' if below else 'factor'} {word} squared" if word else ""
                yield self._slip(f"factor {k + 1} twice", node, f"({texts[k]}) * {self._text(node)}", said)
        yield from self._other_operations(node, texts, words)
        if node.name == "/":
            yield self._slip(
                "divisor left out", node, texts[0], f"without the division by {words[1]}" if words[1] else ""
            )
            if self._type(node) == "Real":
                yield self._slip("fraction upside down", node, f"({texts[1]}) / ({texts[0]})", "")
        # a / (b + c) with the bracket closed too early, or each term divided by
        terms = self._terms(right.parts[0]) if node.name == "/" and right.kind == "bracket" else []
        if len(terms) > 1:
            (_, first), *rest = ((sign, self._text(term)) for sign, term in terms)
            after = "".join(f" {sign} {text}" for sign, text in rest)
            yield self._slip(
                "bracket closed too early", node, f"({texts[0]} / ({first}){after})", "with the first term of the divisor alone as divisor"
            )  # fmt: skip
            each = "".join(f" {sign} {texts[0]} / ({self._text(term)})" for sign, term in terms)
            yield self._slip(
                "divided one by one",
                node,
                f"({each.lstrip(' +')})",
                "with the terms of the divisor inverted one by one",
            )
        # a * (b + c) and (a + b) * c without their brackets
        for part in node.parts:
            inside = part.parts[0] if part.kind == "bracket" else None
            if node.name in ("*", "/") and inside and inside.kind == "binary" and inside.name in ("+", "-"):
                yield _Change(
                    "brackets left out",
                    part.start,
                    part.end,
                    self._text(inside),
                    part.start,
                    "with a pair of brackets left out",
                    True,
                )

    def _other_operations(self, node: Node, texts: list[str], words: list[str]) -> Iterator[_Change]:
        """A sum for a product, the larger for a sum; two factors of a quotient exchanged."""
        both = f"{words[0]} and {words[1]}" if all(words) else "two"
        if node.name in ("+", "*"):
            new, said = ("*", "the product") if node.name == "+" else ("+", "the sum")
            mine = {"+": "their sum", "*": "their product"}[node.name]
            yield self._slip(
                f"{new} for {node.name}",
                node,
                f"(({texts[0]}) {new} ({texts[1]}))",
                f"with {said} of {both} in the place of {mine}",
            )
        if node.name == "+":
            for extreme, said in (("max", "the larger"), ("min", "the smaller")):
                yield self._slip(
                    f"{extreme} for +",
                    node,
                    f"{extreme}({texts[0]}, {texts[1]})",
                    f"with {said} of {both} in the place of their sum",
                )
        if node.name == "/":
            for one in self._factors(node.parts[0]):
                for other in self._factors(node.parts[1]):
                    mine, theirs = self._words(one), self._words(other)
                    if mine and theirs and mine != theirs and not _is_number(mine) and not _is_number(theirs):
                        new = self._exchanged(node, one, other)
                        yield self._slip("factors exchanged", node, new, f"with {mine} and {theirs} exchanged")

    def _factors(self, node: Node) -> list[Node]:
        if node.kind == "bracket":
            return self._factors(node.parts[0])
        if node.kind == "binary" and node.name == "*":
            return [*self._factors(node.parts[0]), *self._factors(node.parts[1])]
        return [node]

    def _exchanged(self, root: Node, one: Node, other: Node) -> str:
        """The text of `root` with two of its nodes in one another's place; `one` comes first."""
        parts = [self.body[root.start : one.start], self._text(other), self.body[one.end : other.start]]
        return "".join([*parts, self._text(one), self.body[other.end : root.end]])

    def _swapped(self, node: Node, new: str) -> str:
        left, right = (self._words(part) for part in node.parts)
        if node.name in ("+", "-"):
            return f"with the sign of {right} exchanged" if right else ""
        if node.name == "*" and right:
            return f"with a division by {right} in the place of a product"
        if node.name == "/" and right:
            return f"multiplied by {right} where it is to be divided"
        about = self._asked(node)
        if node.name in ("<", "<=", ">", ">=", "==", "!=") and about:
            edge = new.rstrip("=") == node.name.rstrip("=")
            return (
                f"with the edge case of {about} on the other side"
                if edge
                else f"with the question about {about} turned round"
            )
        return ""

    def _of_unary(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        if node.name == "-":
            inner = self._words(node.parts[0])
            words = f"with the sign of {inner} exchanged" if inner else ""
            yield _Change("- dropped", node.start, node.start + 1, "", node.start, words)

    def _of_number(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        value = float(node.name.rstrip("f"))
        for new in dict.fromkeys([value + 1, 0.0 if value else 1.0, 1.1 * value]):
            if new != value:
                words = f"with {new:g} for a constant that is {value:g}" if value else ""
                yield _Change(
                    f"{node.name} -> {new:g}", node.start, node.end, _literal(new, node.name), node.start, words
                )
        for new in (2 * value, 0.5 * value, value - 1):
            if value and "." in node.name:
                words = f"with {new:g} for a constant that is {value:g}"
                yield self._slip(f"{new:g} for {node.name}", node, f"({_literal(new, node.name)})", words)

    def _of_name(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        if parent is None or parent.kind != "member":
            yield from self._replaced(node, parent)

    def _of_member(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        of = self._type(node.parts[0])
        if of in self.scope.members:
            for name, type in self.scope.members[of].items():
                if name != node.name and type == self._type(node):
                    word = f"{self._text(node.parts[0])}.{name}"
                    yield self._slip(
                        f"{name} for {node.name}", node, word, f"with {word} in the place of {self._text(node)}"
                    )
        elif of.startswith("vec"):
            for letter in "xyzw"[: int(of[3])]:
                if letter != node.name:
                    base, words = self._text(node.parts[0]), self._words(node.parts[0])
                    said = f"with {words}.{letter} in the place of {words}.{node.name}" if words else ""
                    yield self._slip(f"{letter} for {node.name}", node, f"{base}.{letter}", said)
        yield from self._one_channel(node, self._words(node))
        yield from self._powers(node, parent)

    def _replaced(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        """Another name of the same type in its place."""
        type, mine = self._type(node), self._meaning(node, parent)
        for name, other in [*self.types.items(), *self._members()]:
            if name != node.name and other == type and type:
                theirs = name if "." in name else self._words(Node("name", 0, 0, name))
                yield self._slip(f"{name} for {node.name}", node, name, self._place(node, parent, mine, theirs))
        yield from self._one_channel(node, mine)
        if type == "vec3" and node.name in self.scope.types:
            yield self._slip(f"-{node.name}", node, f"(-{node.name})", self._place(node, parent, mine, f"-{mine}"))
        yield from self._powers(node, parent)

    def _one_channel(self, node: Node, mine: str) -> Iterator[_Change]:
        for k, which in enumerate(("first", "second", "third") if mine in self.scope.colours else ()):
            said = f"with the {which} channel of {mine} for all in one place"
            yield self._slip(f"{which} channel", node, f"vec3({self._text(node)}.{'xyz'[k]})", said)

    def _members(self) -> list[tuple[str, str]]:
        """Those of arguments that are structs."""
        return [
            (f"{name}.{member}", type)
            for name, struct in self.scope.types.items()
            for member, type in self.scope.members.get(struct, {}).items()
        ]

    def _meaning(self, node: Node, parent: Node | None) -> str:
        """Its words, or what the function that it is handed to calls it."""
        words = self._words(node)
        called = self.scope.functions.get(parent.name) if parent is not None and parent.kind == "call" else None
        if words or called is None:
            return words
        place = next(k for k, part in enumerate(parent.parts) if part is node)
        return f"the {called.values[place].name} of {called.name}" if place < len(called.values) else ""

    def _place(self, node: Node, parent: Node | None, mine: str, theirs: str) -> str:
        """What takes the place of what, with what stands around it where that has words."""
        if not mine or not theirs or mine == theirs:
            return ""
        if parent is not None and parent.kind == "call" and (whole := self._words_of_call(parent)):
            if parent.name == "dot":
                others = [theirs if part is node else self._words(part) for part in parent.parts]
                return f"with {_dot(*others)} in the place of {whole}"
            if parent.name in self.scope.functions:
                return f"with {theirs} in the place of {mine} in {whole}"
        return f"with {theirs} in the place of {mine}"

    def _powers(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        asked = parent is not None and parent.name in ("<", "<=", ">", ">=", "==", "!=")
        if self._type(node) == "Real" and not asked:
            mine, text = self._meaning(node, parent), self._text(node)
            yield self._slip("squared", node, f"({text} * {text})", f"with {mine} squared" if mine else "")
            yield self._slip("its root", node, f"sqrt({text})", f"with the square root of {mine}" if mine else "")
            yield self._slip(
                "1 - it", node, f"(1.0 - {text})", f"with 1 - {mine} in the place of {mine}" if mine else ""
            )

    def _of_call(self, node: Node, parent: Node | None) -> Iterator[_Change]:
        texts = [self._text(part) for part in node.parts]
        words = [self._words(part) for part in node.parts]
        if len(node.parts) == 1 and node.parts[0].kind == "binary" and node.parts[0].name in ("*", "/"):
            inner, outer = (self._text(part) for part in node.parts[0].parts)
            verb = "a factor" if node.parts[0].name == "*" else "a division"
            said = f"with {verb} outside of {node.name} that belongs inside"
            yield self._slip(
                "bracket closed too early", node, f"({node.name}({inner}) {node.parts[0].name} ({outer}))", said
            )
        if len(texts) == 3 and node.name not in self.scope.functions and not node.name.startswith("vec"):
            for turned in ([texts[1], texts[2], texts[0]], [texts[2], texts[0], texts[1]]):
                said = f"with the arguments of {node.name} in another order"
                yield self._slip("arguments turned", node, f"{node.name}({', '.join(turned)})", said)
        for number, text in enumerate(texts):
            said = self._instead(node, number, words)
            yield _Change(
                f"{node.name}(...) -> its argument {number + 1}", node.start, node.end, f"({text})", node.start, said
            )
        for i in range(len(texts) - 1 if node.name not in SYMMETRIC else 0):
            if texts[i] != texts[i + 1]:
                swapped = [*texts[:i], texts[i + 1], texts[i], *texts[i + 2 :]]
                both = words[i] and words[i + 1]
                said = f"with {words[i]} and {words[i + 1]} exchanged" + self._in_call(node) if both else ""
                yield _Change(
                    f"arguments {i + 1} and {i + 2} of {node.name} swapped", node.start, node.end,
                    f"{node.name}({', '.join(swapped)})", node.start, said,
                )  # fmt: skip
        yield from self._clamps(node, texts, words)
        if node.name == "dot":
            yield from self._other_dots(node)
        if node.name == "dot" and (said := self._words(node)):
            yield self._slip(
                "clamp put in", node, f"max({self._text(node)}, 0.0)", f"with {said} clamped at 0 in one place"
            )
            yield self._slip(
                "abs put in", node, f"abs({self._text(node)})", f"with the absolute value of {said} in one place"
            )
        yield from self._other_calls(node, texts, words)

    def _other_dots(self, node: Node) -> Iterator[_Change]:
        """The cosine of another pair of directions."""
        mine = self._words(node)
        known = {name: self._words(Node("name", 0, 0, name)) for name, type in self.types.items() if type == "vec3"}
        for one, other in combinations([name for name, words in known.items() if words], 2):
            theirs = _dot(known[one], known[other])
            if mine and theirs != mine:
                yield self._slip(
                    f"{theirs} for {mine}", node, f"dot({one}, {other})", f"with {theirs} in the place of {mine}"
                )

    def _instead(self, node: Node, number: int, words: list[str]) -> str:
        """Without this call."""
        called = self.scope.functions.get(node.name)
        if called and words[number] and self._type(node.parts[number]) == called.returns:
            return f"with {words[number]} in the place of {called.name}"
        if number == 0 and node.name in ("max", "clamp"):
            return f"without the clamp of {words[0]}" if words[0] else "without a clamp"
        if number == 0 and node.name in ("normalize", "sqrt", "abs", "floor"):
            return {
                "normalize": "without normalising",
                "sqrt": "without a square root",
                "abs": "without an absolute value",
            }.get(node.name, "")
        if number == 0 and node.name == "pow":
            return f"without the power {words[1]}" if words[1] else "without the power"
        if node.name == "min" and len(words) == 2:
            return (
                "without the limit of 1"
                if words[1 - number] == "1"
                else "with one of the two of which the smaller is taken"
            )
        return ""

    def _in_call(self, node: Node) -> str:
        return f" in {node.name}" if node.name in self.scope.functions else ""

    def _clamps(self, node: Node, texts: list[str], words: list[str]) -> Iterator[_Change]:
        """What is taken in the place of a clamp at 0."""
        if node.name not in ("max", "clamp") or len(texts) < 2:
            return
        for k in range(len(texts) if node.name == "max" else 1):
            if node.name == "clamp" or _is_zero(texts[1 - k]):
                inner, said = texts[k], words[k] or "what is clamped"
                yield self._slip(
                    "abs for a clamp",
                    node,
                    f"abs({inner})",
                    f"with the absolute value of {said} in the place of a clamp",
                )
                yield self._slip(
                    "half for a clamp",
                    node,
                    f"(0.5 * ({inner}) + 0.5)",
                    f"with 0.5 + 0.5 {said} in the place of a clamp",
                )
                yield self._slip(
                    "sign for a clamp", node, f"max(-({inner}), 0.0)", f"with the sign of {said} exchanged"
                )
                if node.name == "clamp":
                    yield self._slip("no lower clamp", node, f"min({inner}, 1.0)", f"without the clamp of {said} at 0")
                    yield self._slip("no upper clamp", node, f"max({inner}, 0.0)", f"without the clamp of {said} at 1")

    def _other_calls(self, node: Node, texts: list[str], words: list[str]) -> Iterator[_Change]:
        if node.name in SISTERS:
            sister = SISTERS[node.name]
            every = re.sub(rf"\b{node.name}\(", f"{sister}(", self.body)
            yield _Change(
                f"{sister} for every {node.name}",
                0,
                len(self.body),
                every,
                node.start,
                f"with {sister} in the place of {node.name}",
                True,
            )
            yield self._slip(
                f"{sister} for {node.name}",
                node,
                f"{sister}({', '.join(texts)})",
                f"with {sister} in the place of {node.name}",
            )
        if node.name == "pow" and len(texts) == 2:
            yield self._slip(
                "product for power", node, f"(({texts[0]}) * ({texts[1]}))", "with a product in the place of a power"
            )
            base = node.parts[0]
            if base.kind == "binary" and base.name in ("+", "-"):
                a, b = (self._text(part) for part in base.parts)
                said = f"with the power taken of {self._words(base.parts[1]) or 'one term'} alone"
                yield self._slip("power of one term", node, f"({a} {base.name} pow({b}, {texts[1]}))", said)
        if node.name in ("min", "max") and len(texts) == 2 and not any(_is_number(word) for word in words):
            which = "smaller" if node.name == "min" else "larger"
            for new, said in (("+", "the sum"), ("*", "the product")):
                yield self._slip(
                    f"{new} for {node.name}", node, f"(({texts[0]}) {new} ({texts[1]}))", f"with {said} of two in the place of the {which}"
                )  # fmt: skip
        yield from self._distances(node, texts, words)
        if node.name == "normalize":
            return
        called = self.scope.functions.get(node.name)
        if called:
            signature = [v.domain.type for v in called.values]
            for name, other in self.scope.functions.items():
                if (
                    name != node.name
                    and other.returns == called.returns
                    and [v.domain.type for v in other.values] == signature
                ):
                    call = f"{name}({', '.join(texts)})"
                    yield self._slip(f"{name} for {node.name}", node, call, f"with {name} in the place of {node.name}")
                    both = f"({self._text(node)} + {call})"
                    yield self._slip(f"{name} added", node, both, f"with {name} added to {node.name}")
            if called.returns == "Real":
                for value in ("1.0", "0.0"):
                    yield self._slip(
                        f"{value} for {node.name}", node, value, f"as if {node.name} were {float(value):g}"
                    )
            if called.returns == "vec3":
                for value in ("1.0", "0.0"):
                    yield self._slip(
                        f"{value} for {node.name}", node, f"vec3({value})", f"as if {node.name} were {float(value):g}"
                    )

    def _distances(self, node: Node, texts: list[str], words: list[str]) -> Iterator[_Change]:
        """Other lengths than the one that is asked for."""
        if node.name not in ("length", "distance"):
            return
        apart = f"(({texts[0]}) - ({texts[1]}))" if node.name == "distance" else f"({texts[0]})"
        yield self._slip("squared length", node, f"dot({apart}, {apart})", "with the square of a distance in its place")
        sum_of = "with the sum of the absolute components in the place of a distance"
        yield self._slip("taxicab", node, f"dot(abs({apart}), vec3(1.0))", sum_of)
        largest = f"max(max(abs({apart}.x), abs({apart}.y)), abs({apart}.z))"
        yield self._slip("largest component", node, largest, "with the largest component in the place of a distance")
        for text, word in zip(texts, words) if node.name == "distance" else ():
            said = f"with the distance of {word} from the origin" if word else ""
            yield self._slip("from the origin", node, f"length({text})", said)

    def _slip(self, what: str, node: Node, new: str, words: str) -> _Change:
        return _Change(what, node.start, node.end, new, node.start, words, slip=True)


def _dot(a: str, b: str) -> str:
    """As the contracts write it: n.l."""
    if b in ("n", "-n") and a != "n":
        a, b = b, a
    simple = all(re.fullmatch(r"[a-z]", word) for word in (a, b))
    return f"{a}.{b}" if simple else f"dot({a}, {b})"


def _is_zero(text: str) -> bool:
    return text.strip("() ") in ("0.0", "0", "0.0f", "vec3(0.0")


def _is_number(words: str) -> bool:
    return re.fullmatch(r"-?[\d.e+-]+", words) is not None


def _literal(value: float, like: str) -> str:
    text = f"{value:.9g}"
    return text if "." not in like or "." in text or "e" in text else text + ".0"
