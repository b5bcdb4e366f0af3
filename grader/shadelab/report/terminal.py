"""The result in a terminal."""

import re
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from shadelab.paths import shown
from shadelab.report.wording import (
    ASCII_SYMBOLS,
    OUR_FAULT,
    STATUS,
    SYMBOLS,
    beside_the_score,
    findings,
    first_step,
    in_order,
    label,
    not_begun,
    shortened,
    told,
    warned,
    worst_lines,
)
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, FILES, listed, number_short, plain, points

_STYLES = {"passed": "green", "failed": "bold red", "skipped": "dim", "error": "yellow"}
_MESSAGE_LINES = 8


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
    if note := beside_the_score(result):
        say(note, "dim")
    if not result.complete:
        say("Grading was cut off before its end: this is what was earned until then.", "yellow")
    say(first_step(result)[0])
    for line in not_begun(result):
        say(line)
    width = console.width - 2
    # Kinds whose replay line was shown once: the others read alike, and the HTML report has them.
    replayed: set[str] = set()
    for check in warned(result):
        say("")
        say(f"{FILES[check.backend]} compiles; the compiler warns of", _STYLES["error"])
        for line in plain(check.message).splitlines()[:_MESSAGE_LINES]:
            say(shortened(line, 4 * width), indent=2)
    shown_checks = [c for c in in_order(result, "failed", "error") if hidden_details or not c.hidden]
    explained = [c for c in shown_checks if c.because and c.begun]
    for group in findings([c for c in shown_checks if not c.because]):
        check = group[0]
        say("")
        say(_heading(group, symbols), _STYLES[check.status])
        if check.status == "error":
            say(OUR_FAULT, indent=2)
        lines = plain(told(group)).strip("\n").splitlines()
        for line in lines[:_MESSAGE_LINES]:
            say(shortened(line, 4 * width), indent=2)
        if len(lines) > _MESSAGE_LINES:
            say(f"… {len(lines) - _MESSAGE_LINES} more lines", indent=2)
        if check.mistake:
            say(f"Hint: {plain(check.mistake.hint)}", "bold", indent=2)
        if check.error and check.kind == "function":
            say(_error_line(group), indent=2)
        if check.worst and check.kind != "parity":  # its function's check shows the like
            for line in worst_lines(check):
                say(shortened(" ".join(line.split()), 3 * width), indent=2)
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
    check, backends = group[0], listed([BACKENDS[c.backend] for c in group])
    possible = sum(c.max_score for c in group)
    cost = f"  {points(sum(c.score for c in group))} of {points(possible)} points" if possible else ""
    kind = "" if check.kind == "function" else f"{check.kind} "
    name = check.kind if check.kind == "build" else kind + label(check)
    return f"{symbols[check.status]} {name} ({backends}){cost}"


def _error_line(group: list[Check]) -> str:
    errors = [c.error for c in group if c.error]
    limits = dict.fromkeys(number_short(e.limit) for e in errors)
    floors = dict.fromkeys(number_short(e.floor) for e in errors if e.floor is not None)
    respectively = f" ({' and '.join(BACKENDS[c.backend] for c in group)})" if len(limits) > 1 else ""
    floor = f", correct programs stay below {' and '.join(floors)}" if floors else ""
    return f"error {number_short(errors[0].value)}: the limit is {' and '.join(limits)}{respectively}{floor}"


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
