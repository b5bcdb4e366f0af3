"""The terminal's view of `stability`."""

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from shadelab.inspect.stability import SERIES, Line, Report
from shadelab.judge.stability import FLOORS, ROUNDINGS, Stability, describe, first_input
from shadelab.report.wording import compared_line, compared_values, in_brackets
from shadelab.result import Worst

NINE = 9  # digits: all of float32, for what is wrong here may differ in the last ones


def print_stability(report: Report, console: Console) -> None:
    table = Table(box=box.SIMPLE, title_justify="left", header_style="bold", pad_edge=False)
    table.add_column("function", no_wrap=True)
    table.add_column("inputs", justify="right")
    for title in SERIES.values():
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("")
    for line in report.lines:
        found = [_cell(line.found.get(series), series in line.failures) for series in SERIES]
        inputs = next((str(len(f.table.rows)) for f in line.found.values()), "")
        verdict = Text("stable", "green") if line.stable else Text("unstable", "bold red")
        table.add_row(line.function.name, inputs, *found, verdict)
    console.print(table)
    bad = [line.function.name for line in report.lines if not line.stable]
    for line in report.lines:
        if not line.stable:
            _print_unstable(line, report, bad, console)
    for note in report.notes:
        console.print(Text(f"note: {note}"))
    driver = max(report.expected.facts.driver.values())
    console.print(
        Text(
            f"Largest error in floors; at most {FLOORS} may be. A floor is what half a unit in the last place of the float32 inputs moves "
            f"the result by, and {ROUNDINGS} roundings of it; in GLSL also {driver:.1e} of it, which the driver's own functions are off "
            f"({report.expected.facts.gl}). C++ double is held to the limits of float: where it passes and float does not, the algebra is unstable.",
            "dim",
        )
    )
    total = len(report.lines)
    console.print(f"{total - len(bad)} of {total} functions are stable" + (f"; not {', '.join(bad)}" if bad else ""))


def _print_unstable(line: Line, report: Report, bad: list[str], console: Console) -> None:
    function = line.function
    console.print(Text(function.name, "bold red"))
    called = [name for name in report.expected.facts.calls[function.name] if name in bad]
    if called and not line.failures:
        console.print(Text(f"  calls {', '.join(called)}: begin there"))
        return
    for series in ("cpp", "glsl"):
        double = line.found.get("double") if series == "cpp" else None
        if series in line.failures:
            console.print(Text(f"  {SERIES[series]}: {line.failures[series]}"))
        elif series in line.found and (said := describe(line.found[series], double)):
            console.print(Text(f"  {SERIES[series]}: {said}"))
    if line.first:
        first = first_input(function, line.found[line.first[0]])
        given = ", ".join(f"{name} = {in_brackets(value, NINE)}" for name, value in first["inputs"].items())
        console.print(Text(f"  first ({first['case']}): {given}"))
        worst = Worst(**{name: first[name] for name in ("inputs", "expected", "actual")})
        console.print(Text(f"  {compared_line(compared_values(worst), NINE)}"))
    if function.name in report.replays:
        console.print(Text(f"  {report.replays[function.name]}"), soft_wrap=True)
    declared = report.assignment.stability.get(function.name)
    if declared and declared.idea:
        console.print(Text(f"  idea: {declared.idea}", "cyan"))


def _cell(found: Stability | None, failed: bool) -> Text:
    if found is None:
        return Text("failed" if failed else "–", "red" if failed else "dim")
    worst = found.error.max(initial=0.0)
    text = f"{worst:.2g}" if worst < 1e4 else "not finite" if worst == float("inf") else f"{worst:.0e}"
    return Text(text, "red" if found.faults else "")
