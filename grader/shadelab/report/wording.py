"""How every report words a result: names of checks and statuses, what is wrong, and what to do first."""

import re
from collections.abc import Iterator
from typing import Any

from shadelab.result import Check, Result, Worst
from shadelab.words import BACKENDS, FILES, number, plain, points

# In the order in which data flows: what comes first is to be mended first. A kind that has no title here goes by its name.
TITLES = {
    "build": "Build", "function": "Functions", "image": "Images", "parity": "Parity", "stability": "Stability",
    "custom": "Further checks", "runtime": "Run time",
}  # fmt: skip
SYMBOLS = {"passed": "✓", "failed": "✗", "skipped": "–", "error": "!"}
ASCII_SYMBOLS = {"passed": "+", "failed": "X", "skipped": "-", "error": "!"}
STATUS = {"passed": "passed", "failed": "failed", "skipped": "skipped", "error": "grader error"}
OUR_FAULT = "The grader's fault, not yours. Run it again; if it happens again, show this to the course staff."


def label(check: Check) -> str:
    """The part of the id that differs within a backend and a kind: half_vector of cpp/function/half_vector."""
    return plain(check.id.removeprefix(f"{check.backend}/").removeprefix(f"{check.kind}/"))


def components(value: Any, name: str, letters: str = "xyzw") -> Iterator[tuple[str, Any]]:
    """The numbers in a value of a result, each with a name: result.y, result.diffuse.z, result[7]."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from components(item, f"{name}.{plain(key)}" if name else plain(key), letters)
    elif isinstance(value, list | tuple):
        vector = 1 < len(value) <= len(letters) and not any(isinstance(v, list | tuple | dict) for v in value)
        for k, item in enumerate(value):
            alone = len(value) == 1 or isinstance(item, dict)
            yield from components(
                item, name if alone else f"{name}.{letters[k]}" if vector else f"{name}[{k}]", letters
            )
    else:
        yield name, value


def compared(check: Check) -> list[tuple[str, Any, Any, bool]]:
    """Of the worst input: each component's name, expected and actual value, and whether it is wrong.

    A result does not carry every component's own tolerance, so the limit is applied to the components of this one input.
    """
    # An image's limit is a share of pixels, not an error of one.
    limit = 1e-2 if check.kind == "image" else check.error.limit if check.error else 1e-3
    names = ("colour", "rgb") if check.kind == "image" else ("result", "xyzw")
    return compared_values(check.worst, limit, *names)


def compared_values(
    worst: Worst, limit: float = 1e-3, name: str = "result", letters: str = "xyzw"
) -> list[tuple[str, Any, Any, bool]]:
    expected, actual = (list(components(v, name, letters)) for v in (worst.expected, worst.actual))
    names = [n for n, _ in max(expected, actual, key=len)]
    pad = [(None, "none")] * len(names)
    pairs = [(e, a) for _, (_, e), (_, a) in zip(names, expected + pad, actual + pad)]
    scale = max((abs(e) for e, _ in pairs if isinstance(e, int | float)), default=0.0)
    errors = []
    for e, a in pairs:
        if isinstance(e, int | float) and isinstance(a, int | float):
            errors.append(0.0 if a == e else abs(a - e) / (abs(e) + 1e-3 * scale or 1e-30))
        else:
            errors.append(0.0 if a == e else float("inf"))
    bar = min(limit, max(errors, default=0.0))
    return [(n, e, a, error > 0 and error >= bar) for n, (e, a), error in zip(names, pairs, errors)]


def worst_lines(check: Check) -> Iterator[str]:
    """The input in one line, the result in another: all of a vector, the wrong components of anything larger. Lines are cut, so
    that the inputs come first that the explanation speaks of."""
    told = f"{check.message} {check.mistake.hint if check.mistake else ''}"
    named = sorted(check.worst.inputs.items(), key=lambda item: not _speaks_of(told, item[0]))
    if named:
        yield "at " + ", ".join(f"{plain(name)} = {in_brackets(value)}" for name, value in named)
    if rows := compared(check):
        yield compared_line(rows)


def _speaks_of(told: str, name: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(name)}(?!\w)", told) is not None


def compared_line(rows: list[tuple[str, Any, Any, bool]], digits: int = 6) -> str:
    if len(rows) <= 4:
        expected, actual = ([row[k] for row in rows] for k in (1, 2))
        return f"expected {in_brackets(expected, digits)}, yours {in_brackets(actual, digits)}"
    return "; ".join(
        f"{name}: expected {number(e, digits)}, yours {number(a, digits)}" for name, e, a, wrong in rows if wrong
    )


def in_brackets(value: Any, digits: int = 6) -> str:
    numbers = [number(v, digits) for _, v in components(value, "")]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def warned(result: Result) -> list[Check]:
    """Builds of code that compiles, of which the compiler has something to say."""
    return [c for c in in_order(result, "passed") if c.kind == "build" and c.message]


# --- What to say first ---


def kinds_of(result: Result) -> dict[str, str]:
    """All kinds in data-flow order, with their titles; kinds that nobody has titled come last."""
    return TITLES | {c.kind: c.kind.capitalize() for c in result.checks if c.kind not in TITLES}


def in_order(result: Result, *statuses: str) -> list[Check]:
    """The checks of these statuses in data-flow order, the two backends' checks of one thing side by side."""
    kinds, names = list(kinds_of(result)), list(dict.fromkeys(label(c) for c in result.checks))
    chosen = [c for c in result.checks if c.status in statuses]
    return sorted(chosen, key=lambda c: (kinds.index(c.kind), names.index(label(c))))


def first_step(result: Result) -> tuple[str, Check | None]:
    """One sentence of what to do first, and the check that it speaks of."""
    failed, errors, skipped = (in_order(result, s) for s in ("failed", "error", "skipped"))
    if failed:
        check = next((c for c in failed if c.begun), failed[0])
        waiting = sum(check.id in c.needs and c.status == "skipped" for c in result.checks)
        if check.kind == "build":
            what = f"Make {FILES[check.backend]} compile first"
        elif check.kind == "function":
            what = f"Start with {label(check)} in {FILES[check.backend]}"
        elif check.kind == "image":
            what = f"Start with the image {label(check)}, drawn with {BACKENDS[check.backend]}"
        else:
            what = f"Start with {plain(check.id)}"
        if waiting:
            what += f"; {waiting} other {'check waits' if waiting == 1 else 'checks wait'} for it"
        why = (
            ""
            if check.kind == "build"
            else "nothing is written there yet"
            if not check.begun
            else plain(check.mistake.hint if check.mistake else check.message).strip()
        )
        return f"{what}: {shortened(why.splitlines()[0])}" if why else f"{what}.", check
    if errors:
        return f"Nothing of yours failed, but the grader did, at {plain(errors[0].id)}: run it again.", errors[0]
    if not result.complete:
        return "Nothing failed so far, but grading was cut off: run it again.", None
    if skipped:
        return "Nothing failed; see why some checks were skipped.", None
    if not any(check.max_score for check in result.checks):
        return "What was asked for passes; it carries no points.", None
    return "Nothing to mend: every check passes.", None


def beside_the_score(result: Result) -> str | None:
    """What a release's score is a score of."""
    if result.elsewhere is None:
        return None
    more = f"{points(result.elsewhere)} more are for scenes that only the course has. " if result.elsewhere else ""
    return (
        f"These are the points of the checks in this release. {more}There, a function or a picture that is right given what another of "
        "your functions gives keeps its points; here it does not."
    )


def not_begun(result: Result) -> list[str]:
    """A line for each language in which nothing, or not everything, was begun."""
    lines = []
    for backend, name in BACKENDS.items():
        functions = [c for c in result.checks if c.backend == backend and c.kind == "function"]
        stubs = [c for c in functions if not c.begun]
        lacking = [label(c) for c in stubs if c.status == "failed"]
        if lacking:
            lines.append(f"{name}: not begun" + ("" if len(stubs) == len(functions) else f": {', '.join(lacking)}"))
    return lines


def findings(checks: list[Check]) -> list[list[Check]]:
    """Checks in order, those that say the same of both languages together. What was not begun is no finding."""
    groups: list[list[Check]] = []
    for check in checks:
        if not check.begun:
            continue
        if groups and check.backend != groups[-1][0].backend and _alike(groups[-1][0], check, checks):
            groups[-1].append(check)
        else:
            groups.append([check])
    return groups


_SHARE = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?(?:e-\d+)?) %|\b(nearly all|all)(?= of\b)")
FEW = 5.0  # percent: two languages round differently, and what one tells is within this of what the other does


def _alike(a: Check, b: Check, checks: list[Check]) -> bool:
    """Whether they are one finding: the same sentence, but for shares that are a few percent apart. A picture's sentence says
    little of how it is wrong, so what explains it must be alike, too, or its worst pixel must be."""
    if (a.kind, label(a), a.status, a.mistake and a.mistake.id) != (
        b.kind,
        label(b),
        b.status,
        b.mistake and b.mistake.id,
    ):
        return False
    if _SHARE.sub("#", a.message) != _SHARE.sub("#", b.message):
        return False
    if any(abs(s - t) > FEW for s, t in zip(_shares(a.message), _shares(b.message))):
        return False
    if a.kind != "image":
        return True
    causes = [[c for c in checks if c.id in check.because] for check in (a, b)]
    if a.because and [label(c) for c in causes[0]] == [label(c) for c in causes[1]]:
        return all(_alike(x, y, checks) for x, y in zip(*causes))
    return a.worst is not None and b.worst is not None and a.worst.expected == b.worst.expected and _near(a, b)


def _near(a: Check, b: Check) -> bool:
    pairs = list(zip(components(a.worst.actual, ""), components(b.worst.actual, "")))
    return all(
        x == y or (isinstance(x, float) and isinstance(y, float) and abs(x - y) <= FEW / 100 * max(abs(x), abs(y)))
        for (_, x), (_, y) in pairs
    )


def _shares(message: str) -> list[float]:
    return [float(m[1]) if m[1] else 100.0 for m in _SHARE.finditer(message)]


def told(group: list[Check]) -> str:
    """The message of a finding: with both shares, where they differ."""
    if len(group) == 1 or group[0].message == group[1].message:
        return group[0].message
    others = iter(_SHARE.finditer(group[1].message))

    def both(match: re.Match) -> str:
        other = next(others)
        if other[0] == match[0]:
            return match[0]
        if match[1] and other[1]:
            low, high = sorted([match[1], other[1]], key=float)
            return f"{low} to {high} %"
        return f"{match[0]} and {other[0]}"

    return _SHARE.sub(both, group[0].message)


def shortened(text: str, width: int = 160) -> str:
    return text if len(text) <= width else text[: width - 1].rstrip() + "…"


def waits_for(check: Check, result: Result) -> list[str]:
    """The ids in `needs` that did not pass."""
    passed = {c.id for c in result.checks if c.status == "passed"}
    return [plain(need) for need in check.needs if need not in passed]
