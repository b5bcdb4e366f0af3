"""Figures of a study: log-log, and readable in print. Series differ by marker and line as well as by colour; each figure exists
on white and on dark ground."""

from dataclasses import dataclass, field
from pathlib import Path

from shadelab.errors import InfrastructureError
from shadelab.files import whole
from shadelab.study.points import Guide, Part, Point

# Colours that stay apart for colour-blind eyes and in grey (Okabe and Ito 2008), with a marker and a line each.
STYLES = [("#0072B2", "o", "-"), ("#D55E00", "s", "--"), ("#009E73", "^", "-."), ("#CC79A7", "D", ":"),
          ("#E69F00", "v", (0, (5, 1, 1, 1, 1, 1))), ("#56B4E9", "P", (0, (8, 2))), ("#7F7F7F", "X", (0, (2, 1)))]  # fmt: skip
DARK_STYLES = [("#56B4E9", *STYLES[0][1:]), ("#FF8A3D", *STYLES[1][1:]), ("#2EC4A0", *STYLES[2][1:]),
               ("#E39FC8", *STYLES[3][1:]), ("#F0C040", *STYLES[4][1:]), ("#9DB8FF", *STYLES[5][1:]),
               ("#C0C0C0", *STYLES[6][1:])]  # fmt: skip
GROUNDS = {"light": ("#FFFFFF", "#1F2328", "#D0D7DE"), "dark": ("#0D1117", "#E6EDF3", "#30363D")}  # and text, grid


@dataclass
class Curve:
    name: str
    x: list[float]
    y: list[float]
    x_range: list[tuple[float, float]] | None = None  # error bars: from, to
    y_range: list[tuple[float, float]] | None = None
    joined: bool = True
    ringed: list[bool] | None = None  # on the Pareto front


@dataclass
class Panel:
    x_label: str
    y_label: str
    curves: list[Curve]
    guides: list[Guide] = field(default_factory=list)
    diagonal: str = ""  # a label for the line y = x


ERROR = "error (RMSE)"


def series_of(points: list[Point]) -> dict[str, list[Point]]:
    out: dict[str, list[Point]] = {}
    for point in points:
        out.setdefault(point.series, []).append(point)
    return out


def knob_panel(part: Part) -> Panel:
    """Error against what is turned."""
    curves = [
        Curve(name, [p.knob[part.knob] for p in points], [p.error["rmse"] for p in points])
        for name, points in series_of(part.points).items()
    ]
    return Panel(part.knob_label, ERROR, curves, part.guides)


def time_panel(part: Part) -> Panel:
    """Error against time. Where points compete within groups, lines between them would mean nothing."""
    curves = []
    for name, points in series_of(part.points).items():
        timed = [p for p in points if p.seconds]
        if not timed:
            continue
        curves.append(
            Curve(
                name, [1000 * p.seconds["median"] for p in timed], [p.error["rmse"] for p in timed],
                [(1000 * p.seconds["min"], 1000 * p.seconds["max"]) for p in timed],
                joined=part.front_within is None, ringed=[p.front for p in timed],
            )
        )  # fmt: skip
    return Panel(f"{part.time_label}; bars: least to most", ERROR, curves)


def leaving_out_panel(part: Part) -> Panel:
    curves = []
    for language in dict.fromkeys(o["language"] for o in part.leaving_out):
        pairs = [(o["needed"], o["full"]) for o in part.leaving_out if o["language"] == language]
        x, y = ([1000 * pair[k]["median"] for pair in pairs] for k in (0, 1))
        ranges = ([(1000 * pair[k]["min"], 1000 * pair[k]["max"]) for pair in pairs] for k in (0, 1))
        curves.append(Curve(language, x, y, *ranges, joined=False))
    return Panel("with what is needed (ms)", "with everything, --full (ms)", curves, diagonal="no difference")


def panels_of(part: Part) -> list[Panel]:
    panels = [knob_panel(part)] if part.knob else []
    if any(p.seconds for p in part.points):
        panels.append(time_panel(part))
    return panels + ([leaving_out_panel(part)] if part.leaving_out else [])


def draw_part(part: Part, folder: Path) -> list[Path]:
    return plot(part.title, panels_of(part), folder / part.name)


def plot(title: str, panels: list[Panel], stem: Path) -> list[Path]:
    """Writes STEM-light.png, STEM-light.svg, STEM-dark.png and STEM-dark.svg: the panels side by side."""
    try:
        import matplotlib
    except ImportError:
        raise InfrastructureError(
            "matplotlib is missing: ./shadelab study installs it when it is first called"
        ) from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    written = []
    for ground, (background, text, grid) in GROUNDS.items():
        styles = STYLES if ground == "light" else DARK_STYLES
        settings = {
            "figure.facecolor": background, "axes.facecolor": background, "savefig.facecolor": background,
            "text.color": text, "axes.labelcolor": text, "axes.edgecolor": text, "xtick.color": text, "ytick.color": text,
            "grid.color": grid, "font.size": 10, "svg.hashsalt": "shadelab", "svg.fonttype": "path",
            "legend.facecolor": background, "legend.edgecolor": grid,
        }  # fmt: skip
        with pyplot.rc_context(settings):
            figure, axes = pyplot.subplots(
                1, len(panels), figsize=(5.2 * len(panels), 4.8), squeeze=False, layout="constrained"
            )
            figure.suptitle(title, fontsize=12)
            for panel, each in zip(panels, axes[0]):
                _draw(panel, each, styles, text, background)
            figure.draw_without_rendering()  # finds the layout, once for both files
            figure.set_layout_engine("none")
            for suffix, metadata in ((".png", {"Software": None}), (".svg", {"Date": None, "Creator": None})):
                file = stem.with_name(f"{stem.name}-{ground}{suffix}")
                with whole(file) as part:
                    figure.savefig(part, dpi=110, metadata=metadata)
                written.append(file)
            pyplot.close(figure)
    return written


def _draw(panel: Panel, axes, styles: list[tuple], text: str, background: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(True, which="major", linewidth=0.6)
    positive = [y for curve in panel.curves for y in curve.y if y > 0]
    # What has no error at all stands on the lower edge, where a logarithm ends, with an open marker.
    floor = min(positive, default=1.0) / 4
    for index, curve in enumerate(panel.curves):
        colour, marker, line = styles[index % len(styles)]
        y = [max(value, floor) for value in curve.y]
        exact = [value <= 0 for value in curve.y]
        bars = {
            name: [[max(v - low, 0) for v, (low, _) in zip(values, ranges)], [max(high - v, 0) for v, (_, high) in zip(values, ranges)]]
            for name, values, ranges in (("xerr", curve.x, curve.x_range), ("yerr", y, curve.y_range))
            if ranges
        }  # fmt: skip
        axes.errorbar(
            curve.x, y, **bars, color=colour, linestyle=line if curve.joined else "none", linewidth=1.5, marker=marker,
            markersize=6, markerfacecolor=colour, elinewidth=0.9, capsize=2, label=curve.name, zorder=3,
        )  # fmt: skip
        open_x = [x for x, is_exact in zip(curve.x, exact) if is_exact]
        axes.plot(
            open_x, [floor] * len(open_x), linestyle="none", marker=marker, markersize=6, color=colour,
            markerfacecolor=background, zorder=4,
        )  # fmt: skip
        if curve.ringed and any(curve.ringed):
            ringed = [(x, value) for x, value, on in zip(curve.x, y, curve.ringed) if on]
            axes.plot(*zip(*ringed), linestyle="none", marker="o", markersize=12, markerfacecolor="none",
                      markeredgecolor=text, markeredgewidth=0.9, zorder=2)  # fmt: skip
    if any(value <= 0 for curve in panel.curves for value in curve.y):
        axes.plot([], [], linestyle="none", marker="o", color=text, markerfacecolor=background, label="open: no error")
    if any(curve.ringed and any(curve.ringed) for curve in panel.curves):
        axes.plot([], [], linestyle="none", marker="o", markersize=11, markerfacecolor="none", markeredgecolor=text,
                  label="ringed: Pareto front")  # fmt: skip
    limits = [_wide_enough(*axes.get_xlim()), _wide_enough(*axes.get_ylim())]
    for guide in panel.guides:
        _draw_guide(guide, panel, axes, text)
    if panel.diagonal:
        ends = [*(x for c in panel.curves for x in c.x), *(y for c in panel.curves for y in c.y if y > 0)]
        axes.plot([min(ends), max(ends)], [min(ends), max(ends)], color=text, linewidth=0.9, linestyle=(0, (1, 2)),
                  label=panel.diagonal)  # fmt: skip
    axes.set(xlim=limits[0], ylim=limits[1])  # whatever lines there are: the points decide
    _readable_ticks(axes)
    # Below the axes, where it hides no point; the series first.
    known = dict(zip(*reversed(axes.get_legend_handles_labels())))
    names = sorted(known, key=[c.name for c in panel.curves if c.name in known].__contains__, reverse=True)
    axes.legend([known[name] for name in names], names, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.14),
                ncols=len(names) if len(names) <= 4 else 3, frameon=False, columnspacing=1.4)  # fmt: skip


def _wide_enough(low: float, high: float) -> tuple[float, float]:
    """A decade at least, so that what hardly differs looks it."""
    middle, half = (low * high) ** 0.5, max((high / low) ** 0.5, 10**0.5)
    return middle / half, middle * half


def _draw_guide(guide: Guide, panel: Panel, axes, text: str) -> None:
    """Through the most exact point of its series, moved up so that it does not hide in the series' own line."""
    [curve] = [c for c in panel.curves if c.name == guide.series]
    known = sorted((x, y) for x, y in zip(curve.x, curve.y) if y > 0)
    if len(known) < 2:
        return
    x = [known[0][0], known[-1][0]]
    fine = known[-1] if guide.slope < 0 else known[0]  # the end where theory holds best
    y = [1.4 * fine[1] * (value / fine[0]) ** guide.slope for value in x]
    axes.plot(x, y, color=text, linewidth=0.9, linestyle=(0, (1, 2)), zorder=1)
    place = fine[0] * (x[0] * x[1] / fine[0] ** 2) ** 0.15  # on the line, towards that end
    axes.text(place, 1.4 * fine[1] * (place / fine[0]) ** guide.slope, guide.label, color=text, fontsize=10, ha="center",
              va="center", clip_on=True, bbox={"facecolor": axes.get_facecolor(), "edgecolor": "none", "pad": 1})  # fmt: skip


def _readable_ticks(axes) -> None:
    """Where an axis spans less than two decades, its numbers in between are written, too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_minor_formatter(NullFormatter())
        if high / low < 150:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            if low > 1e-3 and high < 1e4:
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
