"""A study on the terminal, and in the files that it leaves."""

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from shadelab.files import write_whole
from shadelab.measure.timing import milliseconds
from shadelab.study.plot import draw_part
from shadelab.study.points import Part
from shadelab.study.run import as_csv


def write_files(result: dict[str, Any], parts: list[Part], folder: Path) -> list[Path]:
    json_file, csv_file = folder / "study.json", folder / "study.csv"
    write_whole(json_file, as_text(result))
    write_whole(csv_file, as_csv(result))
    return [json_file, csv_file, *(file for part in parts for file in draw_part(part, folder))]


def as_text(result: dict[str, Any]) -> str:
    return json.dumps(result, indent=1, allow_nan=False) + "\n"


def print_study(result: dict[str, Any], parts: list[Part], output: Console) -> None:
    for part in parts:
        _print_points(part, output)
        if part.slopes:
            _print_slopes(part, output)
        if part.leaving_out:
            _print_leaving_out(part, output)
        for line in [*part.claims, *(f"skipped {line}" for line in part.skipped)]:
            output.print(line, markup=False, soft_wrap=True)
        output.print(noise_sentence(part.as_json()["noise"]), markup=False, soft_wrap=True)
        output.print()
    output.print(machine_sentence(result), markup=False, soft_wrap=True)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right")
    return table


def _print_points(part: Part, output: Console) -> None:
    knobs = list(dict.fromkeys(key for point in part.points for key in point.knob))
    # Evaluations are timed a million at a time: their milliseconds are nanoseconds of one.
    unit = "ns" if "(ns)" in part.time_label else "ms"
    table = _table(part.title, "series", *knobs, "RMSE", "largest", unit, "least to most", "runs", "front")
    for point in part.points:
        seconds = point.seconds
        times = ["-"] * 3
        if seconds:
            times = [ms(seconds["median"]), f"{ms(seconds['min'])} - {ms(seconds['max'])}", str(seconds["runs"])]
        knob = [_short(point.knob.get(key, "")) for key in knobs]
        errors = [f"{point.error[key]:.2e}" for key in ("rmse", "max")]
        table.add_row(point.series, *knob, *errors, *times, "*" if point.front else "")
    output.print(table)


def _print_slopes(part: Part, output: Console) -> None:
    table = _table("order of convergence", "series", "against", "theory", "fitted", "standard error", "over")
    for s in part.slopes:
        table.add_row(s.series, s.against, s.expected, f"{s.fitted:.3f}", f"{s.standard_error:.3f}", s.fit)
    output.print(table)


def _print_leaving_out(part: Part, output: Console) -> None:
    columns = ("scene", "language", "needed, ms", "everything, ms", "ratio", "largest difference")
    table = _table("leaving out: a frame with what is needed, and with everything (--full)", *columns)
    for o in part.leaving_out:
        table.add_row(
            o["scene"], o["language"], ms(o["needed"]["median"]), ms(o["full"]["median"]), f"{o['ratio']:.2f}",
            f"{o['difference']['max']:.1e}",
        )  # fmt: skip
    output.print(table)


def noise_sentence(noise: dict[str, float]) -> str:
    """How much of the numbers is chance."""
    out = []
    if "median_spread" in noise:
        out.append(
            f"the runs of a point lie {100 * noise['median_spread']:.0f} % apart (most less least over median; the median"
            f" of the points; at most {100 * noise['largest_spread']:.0f} %)"
        )
    if "reference_error" in noise:
        out.append(f"the reference is off by {noise['reference_error']:.1e} at most (RMSE)")
    return f"Noise: {'; '.join(out) or 'nothing was timed'}."


def machine_sentence(result: dict[str, Any]) -> str:
    machine = result["machine"]
    threads = "thread" if machine["threads"] == 1 else "threads"
    return (
        f"{result['repeats']} timed runs or more of each, all in turn, after one that warms up; medians. {machine['threads']}"
        f" {threads}, {machine['processors']} processors: {machine['cpu']}, code for {machine['level']}; {machine['system']},"
        f" {'; '.join([machine['compiler'], *machine['gl']])}; {result['date']}."
    )


def ms(seconds: float) -> str:
    return milliseconds(1000 * seconds)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
