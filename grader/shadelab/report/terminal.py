"""The result in a terminal, and the words and numbers that the HTML report shares with it."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from shadelab.paths import shown
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, FILES, plain

# In the order in which data flows: what comes first is to be mended first.
KINDS = {
    "build": "Build", "function": "Functions", "image": "Images", "parity": "Parity", "stability": "Stability",
    "custom": "Further checks", "runtime": "Run time",
}  # fmt: skip
SYMBOLS = {"passed": "✓", "failed": "✗", "skipped": "–", "error": "!"}
ASCII_SYMBOLS = {"passed": "+", "failed": "X", "skipped": "-", "error": "!"}
STATUS = {"passed": "passed", "failed": "failed", "skipped": "skipped", "error": "grader error"}
OUR_FAULT = "The grader's fault, not yours. Run it again; if it happens again, show this to the course staff."

_STYLES = {"passed": "green", "failed": "bold red", "skipped": "dim", "error": "yellow"}
_MESSAGE_LINES = 8


# --- Words and numbers ---


def number(value: Any) -> str:
    """Six significant digits; None stands for what is not finite."""
    if value is None:
        return "not finite"
    return f"{value:.6g}" if isinstance(value, float) else plain(value)


def points(value: float) -> str:
    return f"{round(value, 2):.10g}"


def label(check: Check) -> str:
    """The part of the id that differs within a backend and a kind: half_vector of cpp/function/half_vector."""
    return plain(check.id.removeprefix(f"{check.backend}/").removeprefix(f"{check.kind}/"))


def error_text(check: Check) -> str:
    return f"{number_short(check.error.value)} / {number_short(check.error.limit)}" if check.error else ""


def number_short(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"


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
    letters = "rgb" if check.kind == "image" else "xyzw"
    name = "colour" if check.kind == "image" else "result"
    expected, actual = (list(components(v, name, letters)) for v in (check.worst.expected, check.worst.actual))
    names = [n for n, _ in max(expected, actual, key=len)]
    pad = [(None, "none")] * len(names)
    pairs = [(e, a) for _, (_, e), (_, a) in zip(names, expected + pad, actual + pad)]
    # An image's limit is a share of pixels, not an error of one.
    limit = 1e-2 if check.kind == "image" else check.error.limit if check.error else 1e-3
    scale = max((abs(e) for e, _ in pairs if isinstance(e, int | float)), default=0.0)
    errors = []
    for e, a in pairs:
        if isinstance(e, int | float) and isinstance(a, int | float):
            errors.append(0.0 if a == e else abs(a - e) / (abs(e) + 1e-3 * scale or 1e-30))
        else:
            errors.append(0.0 if a == e else float("inf"))
    bar = min(limit, max(errors, default=0.0))
    return [(n, e, a, error > 0 and error >= bar) for n, (e, a), error in zip(names, pairs, errors)]


# --- What to say first ---


def in_order(result: Result, *statuses: str) -> list[Check]:
    """The checks of these statuses in data-flow order, the two backends' checks of one thing side by side."""
    kinds, names = list(KINDS), list(dict.fromkeys(label(c) for c in result.checks))
    chosen = [c for c in result.checks if c.status in statuses]
    return sorted(chosen, key=lambda c: (kinds.index(c.kind), names.index(label(c))))


def first_step(result: Result) -> tuple[str, Check | None]:
    """One sentence of what to do first, and the check that it speaks of."""
    failed, errors, skipped = (in_order(result, s) for s in ("failed", "error", "skipped"))
    if failed:
        check = failed[0]
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
        why = "" if check.kind == "build" else plain(check.mistake.hint if check.mistake else check.message).strip()
        return f"{what}: {_shortened(why.splitlines()[0])}" if why else f"{what}.", check
    if errors:
        return f"Nothing of yours failed, but the grader did, at {plain(errors[0].id)}: run it again.", errors[0]
    if not result.complete:
        return "Nothing failed so far, but grading was cut off: run it again.", None
    if skipped:
        return "Nothing failed; see why some checks were skipped.", None
    return "Nothing to mend: every check passes.", None


def _shortened(text: str, width: int = 160) -> str:
    return text if len(text) <= width else text[: width - 1].rstrip() + "…"


def waits_for(check: Check, result: Result) -> list[str]:
    """The ids in `needs` that did not pass."""
    passed = {c.id for c in result.checks if c.status == "passed"}
    return [plain(need) for need in check.needs if need not in passed]


# --- The terminal ---


def print_result(result: Result, console: Console, html: Path | None, hidden_details: bool = False) -> None:
    """For ten seconds: a table, the score, then a few lines for each check that failed. Pictures that a wrong function explains
    stand in one line."""
    narrow = console.options.ascii_only
    symbols = ASCII_SYMBOLS if narrow else SYMBOLS

    def say(text: str, style: str = "", indent: int = 0) -> None:
        text = _ascii(text) if narrow else text
        # Without trailing spaces: one after a backslash would spoil a copied command.
        for line in Text(text.expandtabs(4), style).wrap(console, console.width - indent, overflow="fold") or [
            Text("")
        ]:
            line.rstrip()
            console.print(Text(" " * indent) + line, no_wrap=True)

    if result.checks:
        console.print(_table(result, narrow))
        say("")
    say(f"Score: {points(result.score)} of {points(result.max_score)} points", "bold")
    if not result.complete:
        say("Grading was cut off before its end: this is what was earned until then.", "yellow")
    say(first_step(result)[0])
    width = console.width - 2
    # Kinds whose replay line was shown once: the others read alike, and the HTML report has them.
    replayed: set[str] = set()
    shown_checks = [c for c in in_order(result, "failed", "error") if hidden_details or not c.hidden]
    explained = [c for c in shown_checks if c.because]
    for group in _alike([c for c in shown_checks if not c.because]):
        check = group[0]
        say("")
        say(_heading(group, symbols), _STYLES[check.status])
        if check.status == "error":
            say(OUR_FAULT, indent=2)
        lines = plain(check.message).strip("\n").splitlines()
        for line in lines[:_MESSAGE_LINES]:
            say(_shortened(line, 4 * width), indent=2)
        if len(lines) > _MESSAGE_LINES:
            say(f"… {len(lines) - _MESSAGE_LINES} more lines", indent=2)
        if check.mistake:
            say(f"Hint: {plain(check.mistake.hint)}", "bold", indent=2)
        if check.error and check.kind == "function":
            say(_error_line(check), indent=2)
        if check.worst and check.kind != "parity":  # its function's check shows the like
            for line in worst_lines(check):
                say(_shortened(" ".join(line.split()), 3 * width), indent=2)
            if check.worst.replay and check.kind not in replayed:
                replayed.add(check.kind)
                for line in _command_lines(plain(check.worst.replay), width):
                    say(line, "cyan", indent=2)
    if explained:
        say("")
        say("These pictures show what is wrong above; mend that first:")
        for backend, name in BACKENDS.items():
            if labels := [label(c) for c in explained if c.backend == backend]:
                say(f"{name}: {', '.join(labels)}", indent=2)
    if html:
        say("")
        say(f"Details and pictures: {plain(shown(html))}")


def _heading(group: list[Check], symbols: dict[str, str]) -> str:
    check, backends = group[0], " and ".join(BACKENDS[c.backend] for c in group)
    possible = sum(c.max_score for c in group)
    cost = f"  {points(sum(c.score for c in group))} of {points(possible)} points" if possible else ""
    kind = "" if check.kind == "function" else f"{check.kind} "
    name = check.kind if check.kind == "build" else kind + label(check)
    return f"{symbols[check.status]} {name} ({backends}){cost}"


def _error_line(check: Check) -> str:
    floor = "" if check.error.floor is None else f", correct programs stay below {number_short(check.error.floor)}"
    return f"error {number_short(check.error.value)}: the limit is {number_short(check.error.limit)}{floor}"


def _alike(checks: list[Check]) -> list[list[Check]]:
    """Neighbours that say the same of both languages, together."""
    groups: list[list[Check]] = []
    for check in checks:
        last = groups[-1][0] if groups else None
        if last and (last.kind, label(last), last.status, last.message) == (
            check.kind,
            label(check),
            check.status,
            check.message,
        ):
            groups[-1].append(check)
        else:
            groups.append([check])
    return groups


def _ascii(text: str) -> str:
    return text.replace("…", "...").encode("ascii", "replace").decode()


def _table(result: Result, narrow: bool) -> Table:
    symbols = ASCII_SYMBOLS if narrow else SYMBOLS
    backends = [b for b in BACKENDS if any(c.backend == b for c in result.checks)]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("check", overflow="fold")
    for backend in backends:
        table.add_column(BACKENDS[backend], no_wrap=True)
    kind = None
    wide = max(len(points(c.score)) for c in result.checks)
    # Parity has no points, and is told where the languages disagree.
    checks = [c for c in in_order(result, *STATUS) if c.kind != "parity" or c.status in ("failed", "error")]
    for this_kind, name in dict.fromkeys((c.kind, label(c)) for c in checks):
        of_backend = {c.backend: c for c in checks if (c.kind, label(c)) == (this_kind, name)}
        if this_kind != kind and kind is not None:
            table.add_section()
        kind = this_kind
        shown_name = name if this_kind in ("build", "function") else f"{this_kind} {name}"
        cells = [_cell(of_backend.get(b), symbols, wide) for b in backends]
        table.add_row(Text(_ascii(shown_name) if narrow else shown_name), *cells)
    return table


def _cell(check: Check | None, symbols: dict[str, str], wide: int) -> Text:
    if check is None:
        return Text("")
    words = STATUS[check.status]
    if check.max_score and check.status in ("passed", "failed"):
        words = f"{points(check.score):>{wide}} / {points(check.max_score)}"
    return Text(f"{symbols[check.status]} {words}", _STYLES[check.status])


def worst_lines(check: Check) -> Iterator[str]:
    """The input in one line, the result in another: all of a vector, the wrong components of anything larger."""
    inputs = (f"{plain(name)} = {_tuple(value)}" for name, value in check.worst.inputs.items())
    if check.worst.inputs:
        yield "at " + ", ".join(inputs)
    rows = compared(check)
    if rows and len(rows) <= 4:
        yield f"expected {_tuple([e for _, e, _, _ in rows])}, yours {_tuple([a for _, _, a, _ in rows])}"
    elif rows:
        yield "; ".join(f"{name}: expected {number(e)}, yours {number(a)}" for name, e, a, wrong in rows if wrong)


def _tuple(value: Any) -> str:
    numbers = [number(v) for _, v in components(value, "")]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def _command_lines(command: str, width: int) -> list[str]:
    """A command broken between its words with backslashes, so that it can still be copied."""
    lines = [""]
    for word in re.findall(r"""(?:'[^']*'|"[^"]*"|\S)+""", command):
        if lines[-1] and len(lines[-1]) + len(word) + 3 > width:
            lines[-1] += " \\"
            lines.append("    " + word)
        else:
            lines[-1] += (" " if lines[-1] else "") + word
    return lines
