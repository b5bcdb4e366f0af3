"""Error against run time: a drawing for each scene."""

import math
from dataclasses import dataclass

from markupsafe import Markup, escape

from shadelab.report.wording import STATUS, in_order, label
from shadelab.result import Render, Result
from shadelab.words import BACKENDS, plain


@dataclass
class Plot:
    """The renders of one scene."""

    name: str
    svg: Markup
    rows: list[tuple[str, str, str]]  # series, error, milliseconds


def plots(result: Result) -> list[Plot]:
    scenes: dict[str, dict[str, list[Render]]] = {}
    for check in in_order(result, *STATUS):
        for point in check.runs:
            own = point.series == "yours"
            series = f"yours, {BACKENDS[check.backend]}" if own else plain(point.series)
            points = scenes.setdefault(label(check), {}).setdefault(series, [])
            if point not in points and point.seconds > 0 and math.isfinite(point.rmse):
                points.append(point)
    return [_plot(name, series) for name, series in scenes.items() if any(series.values())]


def _plot(name: str, series: dict[str, list[Render]]) -> Plot:
    """Log-log, one mark a series; yours are filled. An error of 0 stands on the lower border."""
    series = {s: sorted(points, key=lambda p: p.seconds) for s, points in series.items() if points}
    points = [p for own in series.values() for p in own]
    errors = [p.rmse for p in points if p.rmse > 0] or [1e-6]
    low, high = math.log10(min(errors)) - 0.3, math.log10(max(errors)) + 0.3
    times = [s for p in points for s in (p.seconds, p.least, p.most) if s > 0]
    left, right = math.log10(min(times)) - 0.15, math.log10(max(times)) + 0.15
    low, high = (low, high) if high - low > 1 else ((low + high) / 2 - 0.7, (low + high) / 2 + 0.7)
    left, right = (left, right) if right - left > 1 else ((left + right) / 2 - 0.6, (left + right) / 2 + 0.6)
    wide, tall, x0, x1, y1 = 340, 250, 58, 314, 206  # the drawing, its axes' ends: left, right, bottom

    def place(seconds: float, error: float) -> tuple[float, float]:
        x = x0 + (math.log10(seconds) - left) / (right - left) * (x1 - x0)
        share = (math.log10(error) - low) / (high - low) if error > 0 else 0.0
        return round(x, 1), round(y1 - share * (y1 - 10), 1)

    out = []
    ticks = [
        d * 10.0**k
        for k in range(math.floor(left), math.ceil(right) + 1)
        for d in ((1, 2, 5) if right - left < 2 else (1,))
    ]
    for t in (t for t in ticks if left <= math.log10(t) <= right):
        x, _ = place(t, 1)
        label = f"{t:g} s" if t > 0.9 else f"{1e3 * t:.3g} ms" if t > 9e-4 else f"{1e6 * t:.3g} µs"
        out.append(
            f'<path class="grid" d="M{x} 10V{y1}"/><text x="{x}" y="{y1 + 16}" text-anchor="middle">{label}</text>'
        )
    step = max(1, math.ceil((high - low) / 6))
    for k in range(math.ceil(low), math.floor(high) + 1, step):
        _, y = place(1, 10.0**k)
        out.append(f'<path class="grid" d="M{x0} {y}H{x1}"/>')
        out.append(f'<text x="{x0 - 6}" y="{y + 4}" text-anchor="end">1e{k}</text>')
    out.append(f'<path class="axis" d="M{x0} 10V{y1}H{x1}"/>')
    out.append(f'<text x="{(x0 + x1) / 2}" y="{y1 + 36}" text-anchor="middle">run time of one frame</text>')
    out.append(f'<text transform="translate(12 {(10 + y1) / 2}) rotate(-90)" text-anchor="middle">error (RMSE)</text>')
    rows, key = [], []
    # Yours last: drawn on top of the others.
    for k, (what, own) in enumerate(sorted(series.items(), key=lambda item: item[0].startswith("yours,"))):
        yours = what.startswith("yours,")
        style = "yours" if yours else "reference"
        places = [place(p.seconds, p.rmse) for p in own]
        if len(places) > 1:
            out.append(f'<path class="line {style}" d="M{"L".join(f"{x} {y}" for x, y in places)}"/>')
        for (x, y), point in zip(places, own):
            label = f"{what}: {point.rmse:.3g}, {1e3 * point.seconds:.3g} ms"
            if point.least > 0:
                ends = " ".join(f"{place(s, point.rmse)[0]} {y}" for s in (point.least, point.most))
                out.append(f'<path class="spread {style}" d="M{ends}"/>')
            out.append(f'<g class="{style}"><title>{escape(label)}</title>{_mark(k, x, y, 6 if yours else 4)}</g>')
            spread = f" ({1e3 * point.least:.3g} to {1e3 * point.most:.3g})" if point.frames > 1 else ""
            rows.append((what, f"{point.rmse:.3g}", f"{1e3 * point.seconds:.3g}{spread}"))
        key.append(f'<li><svg width="16" height="14" aria-hidden="true"><g class="{style}">{_mark(k, 8, 7, 5)}</g></svg> '
                   f"{escape(what)}</li>")  # fmt: skip
    title = escape(f"Error against run time of {name}; the numbers are in the table below")
    svg = f'<svg class="plot" viewBox="0 0 {wide} {tall}" role="img" aria-label="{title}">{"".join(out)}</svg>'
    return Plot(name, Markup(f'{svg}<ul class="marks">{"".join(key)}</ul>'), rows)


def _mark(k: int, x: float, y: float, r: float) -> str:
    """Shapes, so that series differ without colour too."""
    shapes = (
        "M{a} {t}H{b}V{u}H{a}Z",
        "M{x} {t}L{b} {u}H{a}Z",
        "M{x} {t}L{b} {y}L{x} {u}L{a} {y}Z",
        "M{a} {t}H{b}L{x} {u}Z",
    )
    if k % 5 == 4:
        return f'<circle cx="{x}" cy="{y}" r="{r}"/>'
    corners = {"x": x, "y": y, "a": x - r, "b": x + r, "t": y - r, "u": y + r}
    return f'<path d="{shapes[k % 5].format(**{n: round(v, 1) for n, v in corners.items()})}"/>'
