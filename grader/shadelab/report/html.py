"""The result as one HTML file that needs nothing else: no network, no script, pictures inside."""

import base64
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image

from shadelab.expected import EDGE
from shadelab.report import terminal as words
from shadelab.result import Check, Result

THUMBNAIL = 192
PRINTED = 4096  # of what the code printed, in characters
MESSAGE = 16384
VALUE = 200
MAGENTA = (255, 0, 255)
# How far beyond the tolerance, a colour per doubling from 1x to 64x. OKLCH with even steps of lightness and no magenta.
RAMP = ("#411ca2", "#1652c8", "#1185b2", "#1daea8", "#21d980", "#bbec47", "#fffcc7")


@dataclass
class Pictures:
    """Of one image check. Linear totals, (H, W, 3); row 0 is the top."""

    student: np.ndarray | None  # None where the code gave no picture
    expected: np.ndarray
    mask: np.ndarray | None  # (H, W) uint8: 0 background, 1 interior, 2 edge; None: every pixel is judged
    limit: np.ndarray  # the tolerance of each pixel and channel


@dataclass
class Figure:
    """A picture as the page shows it."""

    id: str
    name: str
    uri: str
    width: int
    height: int
    alt: str
    caption: str = ""
    ring: tuple[float, float] | None = None  # a place to look at, percent from the left and the top


def write_html(result: Result, pictures: dict[str, Pictures], file: Path, title: str) -> None:
    """`pictures` by the id of the image check."""
    ids = {check.id: _anchor(index, check) for index, check in enumerate(result.checks)}
    step, first = words.first_step(result)
    failed = words.in_order(result, "failed", "error")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"plain": words.plain, "points": words.points, "number": words.number, "cut": _cut}
    page = environment.get_template("report.html.j2").render(
        title=title,
        result=result,
        css=Markup((Path(__file__).parent / "report.css").read_text(encoding="utf-8")),
        words=words,
        anchors=ids,
        step=step,
        first=first,
        bar=_bar(result),
        backends=_backends(result),
        failed=failed,
        figures={c.id: _figures(c, pictures[c.id], ids[c.id]) for c in failed if c.id in pictures},
        thumbnails=_thumbnails(result, pictures, ids),
        comparison=_comparison,
        named_values=_named_values,
        ramp=RAMP,
        limits={"printed": PRINTED, "message": MESSAGE, "value": VALUE},
    )
    file.write_text(page.lstrip(), encoding="utf-8")


# --- Words ---


def _anchor(index: int, check: Check) -> str:
    return f"check-{index}-" + re.sub(r"[^a-z0-9]+", "-", check.id.lower()).strip("-")


def _cut(text: str, length: int) -> str:
    text = words.plain(text)
    return text if len(text) <= length else f"{text[:length]}\n… {len(text) - length} more characters"


def _bar(result: Result) -> list[dict[str, Any]]:
    """Where the points went: earned, lost, waiting, owed to the grader, not reached."""
    missing = {status: sum(c.max_score for c in result.checks if c.status == status) for status in ("skipped", "error")}
    checked = sum(c.max_score for c in result.checks)
    earned = result.score - sum(c.score for c in result.checks if c.status in missing)
    lost = checked - sum(missing.values()) - earned
    unseen = max(0.0, result.max_score - checked)
    parts = [
        ("passed", "earned", result.score), ("failed", "lost", lost), ("skipped", "skipped", missing["skipped"]),
        ("error", "open: grader error", missing["error"]), ("unseen", "not reached", unseen),
    ]  # fmt: skip
    total = max(result.max_score, checked) or 1.0
    return [{"kind": k, "name": n, "points": p, "percent": 100 * p / total} for k, n, p in parts if p > 1e-6]


def _backends(result: Result) -> list[dict[str, Any]]:
    out = []
    for backend, name in words.BACKENDS.items():
        checks = [c for c in words.in_order(result, *words.STATUS) if c.backend == backend]
        if checks:
            groups = [(title, [c for c in checks if c.kind == kind]) for kind, title in words.KINDS.items()]
            out.append({
                "id": backend, "name": name, "file": words.FILES[backend], "groups": [g for g in groups if g[1]],
                "score": sum(c.score for c in checks), "max_score": sum(c.max_score for c in checks),
            })  # fmt: skip
    return out


def _named_values(inputs: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Named vectors, at most four numbers a row."""
    rows = []
    for name, value in inputs.items():
        if isinstance(value, dict):
            rows += _named_values({f"{name}.{key}": item for key, item in value.items()})
            continue
        numbers = [words.number(v) for _, v in words.components(value, "")]
        rows += [(name if k == 0 else "", numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
    return rows


def _comparison(check: Check) -> list[dict[str, Any]]:
    return [{"name": n, "expected": e, "actual": a, "wrong": w} for n, e, a, w in words.compared(check)]


# --- Pictures ---


def srgb(linear: np.ndarray) -> np.ndarray:
    """Linear colour to 8-bit sRGB (IEC 61966-2-1); a pixel with a component that is not finite is magenta."""
    bad = ~np.isfinite(linear).all(axis=2)
    x = np.clip(np.where(bad[..., None], 0.0, linear), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
    out = np.rint(encoded * 255).astype(np.uint8)
    out[bad] = MAGENTA
    return out


def excess(student: np.ndarray, expected: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Each pixel's largest |delta| / limit over the channels; infinite where the student's pixel is not finite."""
    delta = np.abs(student.astype(np.float64) - expected)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(delta == 0, 0.0, delta / np.asarray(limit, np.float64))
    return np.nan_to_num(ratio, nan=np.inf, posinf=np.inf).max(axis=2)


def difference(ratio: np.ndarray, edge: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """Black within the tolerance, then the ramp; edges hatched grey, brighter where they are off; not finite magenta."""
    stops = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in RAMP], float)
    doublings = np.log2(np.clip(ratio, 1.0, 2.0 ** (len(RAMP) - 1)))
    places = np.arange(len(RAMP))
    out = np.stack([np.interp(doublings, places, stops[:, k]) for k in range(3)], axis=2)
    out[ratio <= 1] = 0
    y, x = np.indices(ratio.shape)
    grey = np.where((x + y) % 4 < 2, 1.0, 0.6) * (48 + 80 * doublings / places[-1])
    out = np.where(edge[..., None], grey[..., None], out)
    out[bad] = MAGENTA
    return np.rint(out).astype(np.uint8)


def thumbnail(linear: np.ndarray, side: int = THUMBNAIL) -> np.ndarray:
    """As sRGB, box-filtered in linear light so that neither side is longer than `side`; never enlarged."""
    height, width = linear.shape[:2]
    scale = min(1.0, side / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    bad = ~np.isfinite(linear).all(axis=2)
    planes = [*np.moveaxis(np.clip(np.where(bad[..., None], 0, linear), 0, 1), 2, 0), bad]
    small = [
        np.asarray(Image.fromarray(plane.astype(np.float32)).resize(size, Image.Resampling.BOX)) for plane in planes
    ]
    out = srgb(np.stack(small[:3], axis=2))
    out[small[3] > 0] = MAGENTA
    return out


def png_uri(pixels: np.ndarray) -> str:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=4)  # a smaller file costs ten times the time
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _figure(anchor: str, which: str, name: str, pixels: np.ndarray, alt: str, caption: str, ring=None) -> Figure:
    height, width = pixels.shape[:2]
    return Figure(f"{anchor}-{which}", name, png_uri(pixels), width, height, alt, caption, ring)


def _figures(check: Check, pictures: Pictures, anchor: str) -> list[Figure]:
    """Yours, expected, difference."""
    what = f"{words.label(check)} in {words.BACKENDS[check.backend]}"
    expected = srgb(pictures.expected)
    if pictures.student is None:
        return [
            _figure(
                anchor,
                "expected",
                "Expected",
                expected,
                f"The expected picture of {what}",
                "Your code gave no picture.",
            )
        ]
    ratio = excess(pictures.student, pictures.expected, pictures.limit)
    bad = ~np.isfinite(pictures.student).all(axis=2)
    edge = np.zeros(bad.shape, bool) if pictures.mask is None else pictures.mask == EDGE
    place = _worst_place(check, np.where(edge, 0.0, ratio))
    parts = [(~edge, "strictly judged pixels"), (edge, "edge pixels")]
    counts = [_count((ratio > 1) & where, where, name) for where, name in parts if where.any()]
    worst = f"Beyond the tolerance: {', '.join(counts)}."
    ring = None
    if place is not None:
        x, y = place
        far = f"{ratio[y, x]:.3g} times the tolerance" if np.isfinite(ratio[y, x]) else "not finite"
        worst += f" The ringed one, x {x}, y {y}, is the worst: {far}."
        ring = (100 * (x + 0.5) / ratio.shape[1], 100 * (y + 0.5) / ratio.shape[0])
    magenta = f" {int(bad.sum())} pixels are not finite (magenta)." if bad.any() else ""
    return [
        _figure(
            anchor, "yours", "Yours", srgb(pictures.student), f"Your picture of {what}.{magenta}", magenta.strip(), ring
        ),
        _figure(anchor, "expected", "Expected", expected, f"The expected picture of {what}", "", ring),
        _figure(
            anchor, "difference", "Difference", difference(ratio, edge, bad), f"The difference: {worst}", worst, ring
        ),
    ]


def _count(chosen: np.ndarray, among: np.ndarray, name: str) -> str:
    few, total = int(chosen.sum()), int(among.sum())
    share = 100 * few / total
    return f"{few} of {total} {name}" + (f" ({share:.0f} %)" if share >= 1 else " (under 1 %)" if few else "")


def _worst_place(check: Check, judged: np.ndarray) -> tuple[int, int] | None:
    """(x, y): the pixel that the check names, or else the farthest that is judged strictly."""
    named = check.worst.inputs.get("pixel") if check.worst else None
    pixel = isinstance(named, list) and len(named) == 2 and all(isinstance(n, int) for n in named)
    if pixel and 0 <= named[0] < judged.shape[1] and 0 <= named[1] < judged.shape[0]:
        return named[0], named[1]
    if not (judged > 1).any():
        return None
    y, x = np.unravel_index(np.argmax(judged), judged.shape)
    return int(x), int(y)


def _thumbnails(result: Result, pictures: dict[str, Pictures], ids: dict[str, str]) -> dict[str, list[Figure]]:
    """What the student's code drew in the image checks that pass, by backend."""
    out: dict[str, list[Figure]] = {backend: [] for backend in words.BACKENDS}
    for check in words.in_order(result, "passed"):
        shown = pictures.get(check.id)
        if shown and shown.student is not None:
            alt = f"Your picture of {words.label(check)} in {words.BACKENDS[check.backend]}; it passes"
            figure = _figure(ids[check.id], "thumbnail", words.label(check), thumbnail(shown.student), alt, "")
            out[check.backend].append(figure)
    return out
