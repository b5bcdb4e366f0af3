"""What check has found, as a table: a line for each submission, a column for each thing that must hold."""

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from shadelab.prove.check import Matrix, Row
from shadelab.words import BACKENDS

# A line for each submission, also where the terminal breaks it.
WIDTH = 110
HEADINGS = ["submission", "kind", "C++ loses", "named", "GLSL loses", "named", "RMSE", ""]


def print_matrix(name: str, matrix: Matrix, console: Console) -> int:
    """Returns how many submissions and mutants the grader missed."""
    title = f"{name}: what each submission loses; named: by which margin"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="right" if 1 < k < 7 else "left", no_wrap=True)
    for row in matrix.rows:
        table.add_row(*_cells(row))
    console.width = max(console.width, WIDTH)
    console.print(table)
    for row in matrix.rows:
        for fault in row.faults:
            console.print(f"{row.name}: {fault}", markup=False, soft_wrap=True)
    if matrix.crossed:
        wrong = sum(row.kind == "crossed" for row in matrix.rows)
        console.print(
            f"{name}: {matrix.crossed} times a mistake below a variant of its callers, {wrong} times it costs those points"
        )
    for mutation in matrix.mutations:
        console.print(
            f"{name}: {mutation.killed} mutants in {BACKENDS[mutation.backend]} found out, {len(mutation.survivors)} survive; "
            f"{len(mutation.equivalent)} compute the same, {mutation.stillborn} do not compile",
            soft_wrap=True,
        )
        for survivor in mutation.survivors:
            console.print(f"  survives: {survivor}", markup=False, soft_wrap=True)
    for remark in matrix.remarks:
        console.print(f"{name}: note: {remark}", markup=False, soft_wrap=True)
    mistakes, variants = (sum(r.kind == kind for r in matrix.rows) for kind in ("mistake", "variant"))
    missed = sum(bool(r.faults) for r in matrix.rows) + sum(len(m.survivors) for m in matrix.mutations)
    console.print(f"{name}: {mistakes} mistakes and {variants} correct variants in 2 languages, {missed} missed\n")
    return missed


def _cells(row: Row) -> list[str | Text]:
    cells: list[str | Text] = [row.name, row.kind]
    for backend in BACKENDS:
        cells += [f"{row.lost[backend]:.2f}", f"{row.named[backend]:.0f}" if backend in row.named else ""]
    cells.append("" if row.rmse is None else f"{row.rmse:.2g}")
    return [*cells, Text("MISSED", "bold red") if row.faults else "ok"]
