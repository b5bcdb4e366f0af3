"""Mistakes that nobody thought of: the solution with one operator, constant, call or argument changed (mutation testing). The
grader's tables must tell each from the solution. One that computes the same is listed in mistakes.toml as equivalent, with the
reason why it is."""

import re
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import load_changes, regions, with_bodies
from shadelab.errors import UserError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import BuildError, Evaluate
from shadelab.judge.functions import judge_function
from shadelab.machine.build import FUNCTIONS
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import shown
from shadelab.truth.expected import Expected, with_callees, with_callers
from shadelab.words import FILES

SWAPS = {
    "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "<": ["<=", ">"], "<=": ["<", ">"], ">": [">=", "<"], ">=": [">", "<"],
    "==": ["!="], "!=": ["=="], "&&": ["||"], "||": ["&&"],
}  # fmt: skip
_token = re.compile(r"//[^\n]*|\d+\.\d*(?:e[+-]?\d+)?|\d+|[A-Za-z_]\w*|<=|>=|==|!=|&&|\|\||.", re.DOTALL)


@dataclass
class Mutant:
    id: str  # "phong_lobe: dot(n, l) <= 0.0: <= -> <"
    function: str
    body: str


@dataclass
class Token:
    text: str
    start: int
    end: int


def tokens(body: str) -> list[Token]:
    found = [Token(m.group(), m.start(), m.end()) for m in _token.finditer(body)]
    return [t for t in found if not t.text.isspace() and not t.text.startswith("//")]


def mutants(function: str, body: str) -> list[Mutant]:
    out, seen = [], Counter()
    for what, start, end, new in _changes(body):
        line = body[body.rfind("\n", 0, start) + 1 :].split("\n", 1)[0].strip()
        name = f"{function}: {what} in {line}"
        seen[name] += 1
        numbered = name + (f" ({seen[name]})" if seen[name] > 1 else "")
        out.append(Mutant(numbered, function, body[:start] + new + body[end:]))
    return out


def _changes(body: str) -> Iterator[tuple[str, int, int, str]]:
    """What is changed, the place, and the new text."""
    all_ = tokens(body)
    for k, token in enumerate(all_):
        before = all_[k - 1].text if k else ""
        operand = bool(re.match(r"[\w)\]]", before)) and before != "return"
        if token.text in SWAPS and operand:
            for new in SWAPS[token.text]:
                yield f"{token.text} -> {new}", token.start, token.end, new
        elif token.text == "-":
            yield "- dropped", token.start, token.end, ""
        elif re.match(r"\d", token.text) and before != ".":
            value = float(token.text)
            for new in dict.fromkeys([value + 1, 0.0 if value else 1.0, 1.1 * value]):
                if new != value:
                    yield f"{token.text} -> {new:g}", token.start, token.end, _literal(new, token.text)
        elif token.text == "if" and (end := _after_return(all_, k)):
            yield "if dropped", token.start, all_[end].end, ""
        elif k + 1 < len(all_) and all_[k + 1].text == "(" and token.text not in ("if", "while", "for", "return"):
            yield from _call_changes(body, all_, k)


def _literal(value: float, like: str) -> str:
    text = f"{value:.9g}"
    return text if "." not in like or "." in text or "e" in text else text + ".0"


def _after_return(all_: list[Token], k: int) -> int | None:
    """The ; that ends an `if (...) return ...;`."""
    depth = 0
    for j in range(k + 1, len(all_)):
        depth += {"(": 1, ")": -1}.get(all_[j].text, 0)
        if depth == 0:
            if all_[j + 1].text != "return":
                return None
            return next(i for i in range(j, len(all_)) if all_[i].text == ";")
    return None


def _call_changes(body: str, all_: list[Token], k: int) -> Iterator[tuple[str, int, int, str]]:
    """The call replaced by one of its arguments, and two neighbouring arguments swapped."""
    depth, parts, first = 0, [], k + 2
    for j in range(k + 1, len(all_)):
        depth += {"(": 1, ")": -1}.get(all_[j].text, 0)
        if (depth == 1 and all_[j].text == ",") or depth == 0:
            if j > first:
                parts.append((all_[first].start, all_[j - 1].end))
            first = j + 1
        if depth == 0:
            break
    start, end, name = all_[k].start, all_[j].end, all_[k].text
    texts = [body[a:b] for a, b in parts]
    for number, text in enumerate(texts):
        yield f"{name}(...) -> its argument {number + 1}", start, end, f"({text})"
    for i in range(len(parts) - 1):
        if texts[i] != texts[i + 1]:
            swapped = [*texts[:i], texts[i + 1], texts[i], *texts[i + 2 :]]
            yield f"arguments {i + 1} and {i + 2} of {name} swapped", start, end, f"{name}({', '.join(swapped)})"


@dataclass
class Mutation:
    """What came of the mutants of one assignment, in one language."""

    backend: str
    killed: int
    stillborn: int  # they do not compile
    equivalent: list[str]
    survivors: list[str]


def mutate(assignment: Assignment, expected: Expected, folder: Path, progress) -> list[Mutation]:
    """`mutate` in mistakes.toml names the functions; those that they call are mutated with them."""
    changes = load_changes(assignment)
    targets = with_callees(set(changes.mutate), expected.facts.calls) & {
        f.name for f in assignment.functions if f.graded
    }
    if not targets:
        return []
    out, stale = [], {e.id for e in changes.equivalent}
    for backend, name in FILES.items():
        source = assignment.directory / name
        text = source.read_text()
        marked = regions(text, source)
        bred = [m for f in assignment.functions if f.name in targets for m in mutants(f.name, marked[f.name]["body"])]
        files = [folder / backend / str(number) / name for number in range(len(bred))]
        for mutant, file in zip(bred, files):
            file.parent.mkdir(parents=True)
            file.write_text(with_bodies(text, source, {mutant.function: mutant.body}))
        judge = _judge_cpp if backend == "cpp" else _judge_glsl
        verdicts = judge(assignment, expected, bred, files, folder, progress)
        listed = {e.id for e in changes.equivalent}
        alive = [m.id for m, verdict in zip(bred, verdicts) if verdict == "alive"]
        stale -= set(alive)
        survivors = [id for id in alive if id not in listed]
        counts = Counter(verdicts)
        out.append(
            Mutation(backend, counts["killed"], counts["stillborn"], [i for i in alive if i in listed], survivors)
        )
    if stale:
        raise UserError(
            f"{shown(assignment.directory / 'mistakes.toml')}: no surviving mutant is called {sorted(stale)[0]}"
        )
    return out


def _affected(assignment: Assignment, expected: Expected, mutant: Mutant) -> list:
    """The function itself first: most mutants end there."""
    names = with_callers({mutant.function}, expected.facts.calls)
    found = [f for f in assignment.functions if f.name in names and f.graded]
    return sorted(found, key=lambda f: f.name != mutant.function)


def _killed(expected: Expected, function, backend: str, array: np.ndarray) -> bool:
    table, floor = expected.table(function), expected.floor(function, backend)
    return bool(judge_function(function, backend, 1.0, table, floor, array).wrong.any())


def _judge_cpp(assignment, expected, bred: list[Mutant], files: list[Path], folder: Path, progress) -> list[str]:
    done = 0

    def verdict(item: tuple[Mutant, Path]) -> str:
        nonlocal done
        mutant, file = item
        runner = CppRunner(assignment, Sandbox(folder / "sandboxes" / file.parent.name), FUNCTIONS)
        done += 1
        progress(f"{assignment.name}: mutants, C++", done, len(bred))
        try:
            runner.build(file.parent)
        except BuildError:
            return "stillborn"
        for function in _affected(assignment, expected, mutant):
            output = runner.evaluate(Evaluate(function, expected.table(function).rows))
            if output.array is None or _killed(expected, function, "cpp", output.array):
                return "killed"
        return "alive"

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(verdict, zip(bred, files)))


def _judge_glsl(assignment, expected, bred: list[Mutant], files: list[Path], folder: Path, progress) -> list[str]:
    """In a few client processes; a mutant's own function first, and those that call it only for the survivors."""
    verdicts = ["alive"] * len(bred)
    pending = [(k, 0) for k in range(len(bred))]
    while pending:
        functions = [_affected(assignment, expected, bred[k])[place] for k, place in pending]
        tasks = [Evaluate(f, expected.table(f).rows, files[k]) for f, (k, _) in zip(functions, pending)]
        outputs: list = [None] * len(tasks)

        def run(part: int, tasks=tasks, outputs=outputs) -> None:
            runner = GlslRunner(assignment, Sandbox(folder / "sandboxes" / f"glsl-{part}"))
            runner.take(files[0].parent)
            for index, (_, output) in zip(range(part, len(tasks), 2), runner.run(tasks[part::2])):
                outputs[index] = output
                progress(f"{assignment.name}: mutants, GLSL", sum(o is not None for o in outputs), len(tasks))

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(run, range(min(2, len(tasks)))))
        again = []
        for (k, place), function, output in zip(pending, functions, outputs):
            if output.array is None:
                verdicts[k] = "stillborn" if place == 0 else "killed"
            elif _killed(expected, function, "glsl", output.array):
                verdicts[k] = "killed"
            elif place + 1 < len(_affected(assignment, expected, bred[k])):
                again.append((k, place + 1))
        pending = again
    return verdicts
