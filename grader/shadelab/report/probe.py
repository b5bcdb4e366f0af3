"""What a probe found, in a terminal: the facts of the pixel, then for each light the calls and the values of all sides."""

from collections.abc import Iterable

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from shadelab.course.assignment import named_arrays
from shadelab.inspect.probe import SAME, TERMS, Call, Probe, facts
from shadelab.paths import shown
from shadelab.report.wording import ASCII_SYMBOLS, SYMBOLS
from shadelab.truth.expected import CHANNELS
from shadelab.words import BACKENDS, listed, number, plain

SIDES = {**BACKENDS, "expected": "expected"}


def print_probe(out: Probe, console: Console) -> None:
    ascii_only = console.options.ascii_only
    mark = (ASCII_SYMBOLS if ascii_only else SYMBOLS)["failed"]

    def say(text: str = "", style: str = "") -> None:
        text = text.encode("ascii", "replace").decode() if ascii_only else text
        console.print(Text(text, style), soft_wrap=not console.is_terminal)

    say(f"{shown(out.scene)}, pixel {out.pixel[0]},{out.pixel[1]}", "bold")
    say(f"object {out.object}, material {plain(out.material)}: {out.model}")
    for name, value in facts(out, out.known[0]):
        say(f"  {name} = {_tuple(value)}")
    for backend, failures in out.failures.items():
        for words in failures:
            say(f"{BACKENDS[backend]}: {words}", "red")
    for light, kind in enumerate(out.kinds):
        say()
        say(f"light {light + 1}, {kind}", "bold")
        for name in ("l", "h"):
            say(f"  {name} = {_tuple(out.known[light][name, 'vec3'])}")
        grid, sides = _grid(side for call in out.calls for side in call.values)
        for call in (c for c in out.calls if c.light == light):
            _add_call(grid, out, call, sides, mark)
        if grid.row_count:
            console.print(grid)
    if out.rendered:
        say()
        say("as rendered: all lights", "bold")
        grid, sides = _grid(out.rendered)
        for term in TERMS:
            cells = [[Text(number(float(v))) for v in out.rendered[side][CHANNELS[term]]] for side in sides]
            _add_rows(grid, term, "rgb", list(zip(*cells)))
        console.print(grid)
    for function, text in out.printed.items():
        say()
        say(f"{function} prints (C++):", "bold")
        say(text.rstrip("\n"))
    say()
    for note in out.notes:
        say(note)
    if out.judged and (first := out.first_wrong()):
        languages = {name: [BACKENDS[b] for b in first if first[b] == name] for name in first.values()}
        wrong = "; ".join(f"{name} ({listed(which)})" for name, which in languages.items())
        say(f"{mark} is off. The first that is wrong, in data-flow order: {wrong}.", "bold red")
    elif out.judged and any(call.wrong for call in out.calls):
        say("Every value here is within its limit.", "green")


def _grid(given: Iterable[str]) -> tuple[Grid, list[str]]:
    """An empty table with a column for each side that gave something."""
    given = set(given)
    sides = [side for side in SIDES if side in given]
    grid = Grid(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    grid.add_column("", overflow="fold", min_width=12)
    for side in sides:
        grid.add_column(SIDES[side], justify="right", no_wrap=True)
    return grid, sides


def _add_call(grid: Grid, out: Probe, call: Call, sides: list[str], mark: str) -> None:
    """The call in one row, its numbers below it; a single number beside it."""

    def cell(side: str, k: int) -> Text:
        values, off = call.values.get(side), side in call.wrong and call.wrong[side][k]
        text = "none" if values is None else number(float(values[k]))
        return Text(f"{text} {mark}" if off else f"{text}  ", "bold red" if off else "")

    title, columns = Text(_call_text(out, call), "bold"), call.function.outputs
    if len(columns) == 1:
        grid.add_row(title, *(cell(side, 0) for side in sides))
    else:
        grid.add_row(title)
        for k, column in enumerate(columns):
            if column.index == 0:
                cells = [[cell(side, k + i) for side in sides] for i in range(column.width)]
                _add_rows(grid, "  " + column.path.removeprefix("result").removeprefix("."), "xyzw", cells)
    grid.add_section()


def _add_rows(grid: Grid, name: str, letters: str, rows: list[Iterable[Text]]) -> None:
    """A row for each number of a vector; one for all where they look the same."""
    name = f"{name}." if name.strip() else name
    rows = [tuple(row) for row in rows]
    if len(rows) > 1 and all(row == rows[0] for row in rows):
        grid.add_row(Text(name + letters[: len(rows)]), *rows[0])
        return
    for letter, row in zip(letters, rows):
        grid.add_row(Text(name + letter if len(rows) > 1 else name.removesuffix(".")), *row)


def _call_text(out: Probe, call: Call) -> str:
    """half_vector(l, v), beckmann(n, h, m = 0.3): the names of what stands above, the values of everything else."""
    known, texts, at = out.known[call.light], [], 0
    for value in call.function.values:
        columns = call.function.columns(value.name)
        numbers = call.row[at : at + len(columns)]
        at += len(columns)
        key = (value.name, value.domain.type)
        if key in known and np.allclose(numbers, known[key], **SAME):
            texts.append(value.name)
        else:
            texts += [f"{p} = {_tuple(v[0])}" for p, v in named_arrays(columns, numbers[None]).items()]
    return f"{call.function.name}({', '.join(texts)})"


def _tuple(value: np.ndarray) -> str:
    numbers = [number(float(v)) for v in np.atleast_1d(value)]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
