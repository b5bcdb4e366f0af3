"""The benchmark on the terminal, and in the README."""

from typing import Any

from rich.console import Console
from rich.table import Table

from shadelab.errors import UserError
from shadelab.machine.processor import LEVELS
from shadelab.measure.bars import error_ratio
from shadelab.measure.declaration import Declaration, load_declaration
from shadelab.measure.timing import milliseconds
from shadelab.paths import ROOT


def print_report(bench: dict[str, Any], output: Console) -> None:
    """Times beside errors, ratios, and then the bars."""
    table = Table(title="one frame, ours and llvmpipe's: time and RMSE against the double build", title_justify="left")
    for heading in ("case", "ours ms", "peer ms", "ratio", "our error", "peer's error"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    for c in [*bench["cases"], *bench["full"]]:
        times, errors = ([c[who][what] for who in ("ours", "peer")] for what in ("median", "error"))
        table.add_row(c["name"], *map(milliseconds, times), f"{c['ratio']:.3f}", *(f"{e:.2e}" for e in errors))
    if table.row_count:
        output.print(table)
    lines = [
        f"{t['name']}: {t['frame_gain']:.2f} times as fast with two threads, arithmetic {t['arithmetic_gain']:.2f} times"
        for t in bench["threads"]
    ]
    for each in bench["supersampling"]:
        lines.append(f"{each['name']}: {each['size']} x {each['size']} pixels, RMSE against 4096 samples in double")
        lines += [
            f"    {p['series']:<11} {p['samples']:>2} samples  {milliseconds(p['ms']['median']):>6} ms  {p['error']:.2e}"
            for p in each["points"]
        ]
    lines += [f"{each['name']}: {milliseconds(each['median'])} ms" for each in bench["load"]]
    lines += [
        f"{m['name']}: {m['peak_bytes'] / 2**20:.0f} MiB at most, with {m['geometry_bytes'] / 2**20:.0f} MiB of geometry and"
        f" {m['framebuffer_bytes'] / 2**20:.0f} MiB of framebuffers"
        for m in bench["memory"]
    ]
    lines += [
        f"{o['name']}: frame {milliseconds(o['lean']['frame_ms'])} ms, with --full {milliseconds(o['full']['frame_ms'])} ms"
        f" ({o['frame_ratio']:.2f}); with set-up {o['ratio']:.2f}"
        for o in bench["omissions"]
    ]
    lines += [f"skipped {each['name']}: {each['why']}" for each in bench["skipped"]]
    for line in lines:
        output.print(line, markup=False, soft_wrap=True)
    for b in bench["bars"]:
        verdict = "[green]met   [/]" if b["met"] else "[red]missed[/]"
        output.print(f"{verdict} {b['name']}: {b['value']:.3g} ({b['sense']} {b['limit']:g})", soft_wrap=True)


def markdown(declared: Declaration, bench: dict[str, Any]) -> str:
    """The README's table: a row for each mesh and sample count, cells with both times in ms."""
    by_place = {(c["mesh"], c["samples"], c["shading"]): c for c in bench["cases"]}
    looks, heads = [look.name for look in declared.look], [look.heading for look in declared.look]
    lines = [f"| ours / llvmpipe, ms | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads)]
    for samples in declared.samples:
        for mesh in declared.meshes:
            cells = [markdown_cell(by_place.get((mesh, samples, look))) for look in looks]
            if any(cells):
                plural = "sample" if samples == 1 else "samples"
                lines.append(f"| `{mesh}`, {samples} {plural} | {' | '.join(cells)} |")
    bars = ["| | measured | bar | |", "|---|---:|---:|---|"]
    for b in bench["bars"]:
        sign = "≥" if b["sense"] == "at least" else "≤"
        bars.append(f"| {b['name']} | {b['value']:.3g} | {sign} {b['limit']:g} | {'met' if b['met'] else 'missed'} |")
    return "\n".join([*lines, "", errors_sentence(bench), "", *bars, "", machine_sentence(bench)])


def markdown_cell(case: dict[str, Any] | None) -> str:
    return f"{milliseconds(case['ours']['median'])} / {milliseconds(case['peer']['median'])}" if case else ""


def errors_sentence(bench: dict[str, Any]) -> str:
    cases, size = bench["cases"], bench["settings"]["size"]
    if not cases:
        return ""
    ours, peer = ([c[who]["error"] for c in cases] for who in ("ours", "peer"))
    no_worse = sum(error_ratio(c) <= 1 for c in cases)
    return (
        f"{size} x {size} pixels, the same layers read back. Error (RMSE against our double build): ours {min(ours):.1e} to"
        f" {max(ours):.1e}, llvmpipe {min(peer):.1e} to {max(peer):.1e}; ours is no worse in {no_worse} of {len(cases)} cases."
    )


def machine_sentence(bench: dict[str, Any]) -> str:
    machine, settings = bench["machine"], bench["settings"]
    return (
        f"{settings['threads']} threads of {machine['processors']} on {machine['cpu']}, code for {level_name(settings['level'])};"
        f" {machine['system']}, {machine['compiler']};"
        f" {'; '.join(machine['peer'])}; {machine['date']}. Ratios are medians over at least {settings['pairs']} pairs of"
        f" frames drawn in turn. `./shadelab bench{level_option(settings['level'])} --readme` measures anew and rewrites this."
    )


def level_name(level: str) -> str:
    return f"x86-64-{level}" if level in LEVELS[1:] else level


def level_option(level: str) -> str:
    return f" --level {level}" if level in LEVELS else ""


def replace_block(text: str, block: str) -> str:
    """`text` with `block` between the lines <!-- bench --> and <!-- /bench -->."""
    begin, end = "<!-- bench -->", "<!-- /bench -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise UserError(f"README.md: there must be one line {begin} and below it one line {end}")
    head, rest = text.split(begin)
    return f"{head}{begin}\n{block}\n{end}{rest.split(end)[1]}"


def write_readme(bench: dict[str, Any]) -> None:
    file = ROOT / "README.md"
    file.write_text(replace_block(file.read_text(), markdown(load_declaration(), bench)))
