"""The result as one HTML file that needs nothing else: no network, and without its script it only lacks the viewers."""

import base64
import hashlib
import io
import math
import os
import re
import zlib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup, escape
from PIL import Image

from shadelab.grading.pictures import Pictures
from shadelab.report import terminal
from shadelab.result import Check, Point, Result
from shadelab.truth.expected import BACKGROUND, EDGE, INTERIOR, SceneTruth
from shadelab.words import plain

THUMBNAIL = 192
PRINTED = 4096  # of what the code printed, in characters
MESSAGE = 16384
VALUE = 200
MAGENTA = (255, 0, 255)
# How far beyond the tolerance, a colour per doubling from 1x to 64x. OKLCH with even steps of lightness and no magenta.
RAMP = ("#411ca2", "#1652c8", "#1185b2", "#1daea8", "#21d980", "#bbec47", "#fffcc7")
TERMS = ("total", "ambient", "diffuse", "specular")

PAGE = 24_000_000  # bytes of the whole file
WORDS = 1_000_000  # of these, for all that is no picture
PICTURE = 160_000  # bytes of one picture; a noisier one loses detail
TOTAL = 350_000  # bytes that are set aside for the values of the total, for each check


@dataclass
class Figure:
    """A picture as the page shows it."""

    id: str
    name: str
    uri: Markup
    width: int
    height: int
    alt: str
    caption: str = ""
    ring: tuple[float, float] | None = None  # a place to look at, percent from the left and the top


@dataclass
class Illustrated:
    """What the page shows of the checks with pictures, by the check's id."""

    figures: dict[str, list[Figure]] = field(default_factory=dict)  # of those that failed
    thumbnails: dict[str, Figure] = field(default_factory=dict)  # of those that passed
    viewers: dict[str, dict[str, Any]] = field(default_factory=dict)  # what report.js has to know
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)  # the same of what checks share
    blobs: dict[str, Markup] = field(default_factory=dict)  # base64, by the name of a viewer's or a scene's data


def write_html(
    result: Result, pictures: dict[str, Pictures], file: Path, title: str, hidden_details: bool = False
) -> None:
    """`pictures` by the id of the image check. Of hidden checks only name, status and points, unless `hidden_details`."""
    if not hidden_details:
        result = _without_hidden(result)
        pictures = {c.id: pictures[c.id] for c in result.checks if c.id in pictures and not c.hidden}
    here = Path(__file__).parent
    ids = {check.id: _anchor(index, check) for index, check in enumerate(result.checks)}
    step, first = terminal.first_step(result)
    shown = [c for c in terminal.in_order(result, "failed", "error") if hidden_details or not c.hidden]
    illustrated = _illustrated(result, pictures, ids)
    script = (here / "report.js").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(here),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"plain": plain, "points": terminal.points, "number": terminal.number, "cut": _cut}
    page = environment.get_template("report.html.j2").render(
        title=title,
        result=result,
        css=Markup((here / "report.css").read_text(encoding="utf-8")),
        script=Markup(script),
        # With its hash in the page's policy, nothing that a student wrote could ever run.
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        words=terminal,
        anchors=ids,
        step=step,
        first=first,
        bar=_bar(result),
        backends=_backends(result),
        failed=shown,
        hidden_details=hidden_details,
        illustrated=illustrated,
        floors=any(c.error and c.error.floor is not None for c in result.checks),
        plots=_plots(result),
        comparison=_comparison,
        named_values=_named_values,
        ramp=RAMP,
        data={"checks": illustrated.viewers, "scenes": illustrated.scenes, "ramp": RAMP},
        limits={"printed": PRINTED, "message": MESSAGE, "value": VALUE},
    )
    file.write_text(page.lstrip(), encoding="utf-8")


def _without_hidden(result: Result) -> Result:
    """With name, status and points of the hidden checks, and nothing else of them: nothing else can leak."""
    kept = {"id", "kind", "backend", "status", "score", "max_score", "hidden"}
    checks = [Check(**c.model_dump(include=kept)) if c.hidden else c for c in result.checks]
    return result.model_copy(update={"checks": checks})


# --- Words ---


def _anchor(index: int, check: Check) -> str:
    return f"check-{index}-" + re.sub(r"[^a-z0-9]+", "-", check.id.lower()).strip("-")


def _cut(text: str, length: int) -> str:
    text = plain(text)
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
    for backend, name in terminal.BACKENDS.items():
        checks = [c for c in terminal.in_order(result, *terminal.STATUS) if c.backend == backend]
        if checks:
            groups = [(title, [c for c in checks if c.kind == kind]) for kind, title in terminal.KINDS.items()]
            out.append({
                "id": backend, "name": name, "file": terminal.FILES[backend], "groups": [g for g in groups if g[1]],
                "passed": [c for c in checks if c.status == "passed"],
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
        numbers = [terminal.number(v) for _, v in terminal.components(value, "")]
        rows += [(name if k == 0 else "", numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
    return rows


def _comparison(check: Check) -> list[dict[str, Any]]:
    return [{"name": n, "expected": e, "actual": a, "wrong": w} for n, e, a, w in terminal.compared(check)]


# --- Pictures ---

_LINEAR = np.arange(1 << 14) / ((1 << 14) - 1)  # finely enough for each of 256 levels
_SRGB = np.where(_LINEAR <= 0.0031308, 12.92 * _LINEAR, 1.055 * np.power(_LINEAR, 1 / 2.4) - 0.055)
SRGB = np.rint(255 * _SRGB).astype(np.uint8)

# The difference picture's palette: black, magenta, then the ramp and the hatching's two greys, STEPS colours per doubling.
STEPS = 12
SHADES = STEPS * (len(RAMP) - 1) + 1


def _palette() -> np.ndarray:
    stops = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in RAMP], float)
    doublings = np.arange(SHADES) / STEPS
    ramp = np.stack([np.interp(doublings, np.arange(len(RAMP)), stops[:, k]) for k in range(3)], axis=1)
    grey = np.repeat((48 + 80 * doublings / (len(RAMP) - 1))[:, None], 3, axis=1)
    return np.rint(np.concatenate([[(0, 0, 0), MAGENTA], ramp, grey, 0.6 * grey])).astype(np.uint8)


PALETTE = _palette()


def _every(true: np.ndarray) -> np.ndarray:
    """(H, W, 3) -> (H, W). Written out: numpy's own reduction over so short an axis takes ten times as long."""
    return true[..., 0] & true[..., 1] & true[..., 2]


def srgb(linear: np.ndarray) -> np.ndarray:
    """Linear colour to 8-bit sRGB (IEC 61966-2-1); a pixel with a component that is not finite is magenta."""
    x = np.multiply(linear, len(SRGB) - 1, dtype=np.float32)
    bad = ~_every(np.isfinite(x))
    if bad.any():
        x[bad] = 0
    np.clip(x, 0, len(SRGB) - 1, out=x)
    out = SRGB[np.add(x, 0.5, out=x).astype(np.uint16)]
    out[bad] = MAGENTA
    return out


def excess(student: np.ndarray, expected: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """(H, W, 3) -> (H, W): each pixel's largest |delta| / limit; infinite where the student's pixel is not finite."""
    return _excess(_planes(student), _planes(expected), _planes(limit))


def difference(ratio: np.ndarray, edge: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """In PALETTE: black within the tolerance, then the ramp; edges hatched grey, brighter where they are off; not finite
    magenta."""
    shade = np.rint(STEPS * np.log2(np.clip(ratio, 1.0, 2.0 ** (len(RAMP) - 1)))).astype(np.uint8)
    out = np.where(ratio <= 1, np.uint8(0), 2 + shade)
    y, x = np.nonzero(edge)
    out[y, x] = 2 + SHADES + shade[y, x] + np.where((x + y) % 4 < 2, 0, SHADES).astype(np.uint8)
    out[bad] = 1
    return out


def thumbnail(linear: np.ndarray, side: int = THUMBNAIL) -> np.ndarray:
    """As sRGB, box-filtered in linear light so that neither side is longer than `side`; never enlarged."""
    planes = _planes(linear)
    height, width = planes.shape[1:]
    scale = min(1.0, side / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    finite = np.isfinite(planes)
    bad = ~(finite[0] & finite[1] & finite[2])
    planes[:, bad] = 0
    np.clip(planes, 0, 1, out=planes)
    small = [np.asarray(Image.fromarray(plane).resize(size, Image.Resampling.BOX)) for plane in planes]
    out = srgb(np.stack(small, axis=2))
    if bad.any():
        out[np.asarray(Image.fromarray(bad.astype(np.float32)).resize(size, Image.Resampling.BOX)) > 0] = MAGENTA
    return out


def picture_uri(pixels: np.ndarray) -> Markup:
    """PNG of RGB, or of indices into PALETTE. One that is too large for that (only noise is) becomes JPEG, in half the size
    if need be."""
    image = Image.fromarray(pixels)
    buffer, kind = io.BytesIO(), "png"
    if pixels.ndim == 2:
        image.putpalette(PALETTE.tobytes())
    image.save(buffer, "PNG", compress_type=zlib.Z_RLE)  # a smaller file costs twice the time
    image = image.convert("RGB") if buffer.tell() > PICTURE else image
    while buffer.tell() > PICTURE:
        if kind == "jpeg":
            image = image.reduce(2)
        buffer, kind = io.BytesIO(), "jpeg"
        image.save(buffer, "JPEG", quality=70)
    return Markup(f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}")


def _illustrated(result: Result, pictures: dict[str, Pictures], anchors: dict[str, str]) -> Illustrated:
    """First the pictures that need no script, then in the order of the data flow what viewers show, while there is room."""
    out = Illustrated()
    failed = [c for c in terminal.in_order(result, "failed", "error") if c.id in pictures]
    passed = [c for c in terminal.in_order(result, "passed") if c.id in pictures and pictures[c.id].layers is not None]
    scenes = _scenes([*failed, *passed], pictures)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        expected = dict(zip(
            dict.fromkeys(scenes[c.id] for c in failed),
            pool.map(lambda c: picture_uri(srgb(pictures[c.id].expected)), {scenes[c.id]: c for c in failed}.values()),
        ))  # fmt: skip
        drawn = pool.map(lambda c: _figures(c, pictures[c.id], anchors[c.id], expected[scenes[c.id]]), failed)
        out.figures = {c.id: figures for c, figures in zip(failed, drawn)}
        small = pool.map(lambda c: _thumbnail(c, pictures[c.id], anchors[c.id]), passed)
        out.thumbnails = {c.id: figure for c, figure in zip(passed, small)}
        room = PAGE - WORDS - sum(len(f.uri) for figures in out.figures.values() for f in figures)
        room -= sum(len(f.uri) for f in out.thumbnails.values())
        for check in failed:
            if pictures[check.id].layers is not None:
                height, width = pictures[check.id].expected.shape[:2]
                out.viewers[anchors[check.id]] = {
                    "width": width,
                    "height": height,
                    "pixel": _named_pixel(check, (height, width)),
                }

        # A scene's data stands once, for both languages: all of a scene that fails, else, or when room is short, the total.
        groups: dict[str, list[Check]] = {}
        for check in [*failed, *passed]:
            if pictures[check.id].layers is not None:
                groups.setdefault(scenes[check.id], []).append(check)
        fails = {scenes[c.id] for c in failed}
        for whole in (True, False):
            left = iter([key for key in groups if key not in out.scenes and (key in fails or not whole)])
            full = False
            waiting = sum(len(checks) for key, checks in groups.items() if key not in out.scenes) if whole else 0
            # Some ahead, so that no processor waits, and few, so that little is done in vain once the room is used up.
            while not full and (batch := list(islice(left, 4))):
                calls = [(key, groups[key], whole, pictures, anchors) for key in batch]
                for packed in pool.map(lambda call: _packed_scene(*call), calls):
                    size = sum(len(text) for text in packed.blobs.values())
                    waiting -= len(packed.viewers) if whole else 0
                    full = full or size > room - TOTAL * waiting
                    if not full:
                        room -= size
                        out.viewers |= packed.viewers
                        out.scenes |= packed.scenes
                        out.blobs |= packed.blobs
    return out


def _scenes(checks: list[Check], pictures: dict[str, Pictures]) -> dict[str, str]:
    """A key for each check; those that the same picture is expected of have the same."""
    keys: dict[str, str] = {}
    seen: dict[str, list[tuple[np.ndarray, str]]] = {}
    for check in checks:
        total = pictures[check.id].expected
        alike = seen.setdefault(terminal.label(check), [])
        key = next((key for other, key in alike if np.array_equal(other, total)), None)
        if key is None:
            key = f"scene-{len(set(keys.values()))}"
            alike.append((total, key))
        keys[check.id] = key
    return keys


def _figure(anchor: str, which: str, name: str, uri: Markup, shape: tuple, alt: str, caption: str, ring=None) -> Figure:
    return Figure(f"{anchor}-{which}", name, uri, shape[1], shape[0], alt, caption, ring)


def _figures(check: Check, pictures: Pictures, anchor: str, expected: Markup) -> list[Figure]:
    """Yours, expected, difference."""
    what = f"{terminal.label(check)} in {terminal.BACKENDS[check.backend]}"
    alt = f"The expected picture of {what}"
    shape = pictures.expected.shape
    if pictures.student is None:
        return [_figure(anchor, "expected", "Expected", expected, shape, alt, "Your code gave no picture.")]
    ratio = excess(pictures.student, pictures.expected, pictures.limit)
    bad = ~_every(np.isfinite(pictures.student))
    edge = pictures.truth.mask == EDGE
    place = _worst_place(check, np.where(edge, 0.0, ratio))
    mask = pictures.truth.mask
    parts = [(mask == INTERIOR, "interior pixels"), (edge, "edge pixels")]
    if ((ratio > 1) & (mask == BACKGROUND)).any():
        parts.append((mask == BACKGROUND, "background pixels"))
    counts = [_count((ratio > 1) & where, where, name) for where, name in parts if where.any()]
    worst = f"Beyond the tolerance: {', '.join(counts)}."
    ring = None
    if place is not None:
        x, y = place
        far = f"{ratio[y, x]:.3g} times the tolerance" if np.isfinite(ratio[y, x]) else "not finite"
        worst += f" The ringed one, x {x}, y {y}, is the worst: {far}."
        ring = (100 * (x + 0.5) / ratio.shape[1], 100 * (y + 0.5) / ratio.shape[0])
    magenta = f" {int(bad.sum())} pixels are not finite (magenta)." if bad.any() else ""
    yours = picture_uri(srgb(pictures.student))
    far_off = picture_uri(difference(ratio, edge, bad))
    return [
        _figure(anchor, "yours", "Yours", yours, shape, f"Your picture of {what}.{magenta}", magenta.strip(), ring),
        _figure(anchor, "expected", "Expected", expected, shape, alt, "", ring),
        _figure(anchor, "difference", "Difference", far_off, shape, f"The difference: {worst}", worst, ring),
    ]


def _count(chosen: np.ndarray, among: np.ndarray, name: str) -> str:
    few, total = int(chosen.sum()), int(among.sum())
    share = 100 * few / total
    return f"{few} of {total} {name}" + (f" ({share:.0f} %)" if share >= 1 else " (under 1 %)" if few else "")


def _named_pixel(check: Check, shape: tuple[int, ...]) -> tuple[int, int] | None:
    """(x, y) that the check names."""
    named = check.worst.inputs.get("pixel") if check.worst else None
    if not (isinstance(named, list) and len(named) == 2 and all(isinstance(n, int) for n in named)):
        return None
    return (named[0], named[1]) if 0 <= named[0] < shape[1] and 0 <= named[1] < shape[0] else None


def _worst_place(check: Check, judged: np.ndarray) -> tuple[int, int] | None:
    """(x, y): the pixel that the check names, or else the farthest that is judged strictly."""
    named = _named_pixel(check, judged.shape)
    if named or not (judged > 1).any():
        return named
    y, x = np.unravel_index(np.argmax(judged), judged.shape)
    return int(x), int(y)


def _thumbnail(check: Check, pictures: Pictures, anchor: str) -> Figure:
    """What the student's code drew in an image check that passes."""
    small = thumbnail(pictures.student)
    alt = f"Your picture of {terminal.label(check)} in {terminal.BACKENDS[check.backend]}; it passes"
    return _figure(anchor, "thumbnail", terminal.label(check), picture_uri(small), small.shape, alt, "")


# --- What the viewers show ---
#
# A blob holds planes of 16 bits. Colours are float16: three planes, of which the fourth digit is rounded. Positions and normals,
# where that would be coarse, are fractions of their range. What is far finer than float16, how a difference compares with the
# tolerance, is a plane of its own, in steps of 1/16 of a doubling. A plane is stored as differences, which are small where the
# picture is smooth: from the same plane of the scene where most pixels are equal, otherwise from left + above - above left. The
# differences as unsigned numbers (0, -1, 1, -2, ...), their high bytes before their low bytes, deflated, in base64.
# report.js reads this.


def _packed_scene(
    key: str, checks: list[Check], whole: bool, pictures: dict[str, Pictures], anchors: dict[str, str]
) -> Illustrated:
    """`whole`: with all terms and the geometry; otherwise with the total alone."""
    out = Illustrated()
    truth = pictures[checks[0].id].truth
    height, width = truth.mask.shape
    terms = TERMS if whole else TERMS[:1]
    expected = [_planes(truth.layers[name]) for name in terms]
    base = np.concatenate([_halves(layer) for layer in expected])
    planes = [base, truth.mask[None].astype(np.uint16)]
    channels: list[dict[str, Any]] = [{"name": name, "planes": 3, "coding": "half"} for name in terms]
    channels.append({"name": "mask", "planes": 1, "coding": "integer"})
    if whole:
        planes.append(_planes(truth.layers["id"]).astype(np.uint16))
        channels.append({"name": "id", "planes": 1, "coding": "integer"})
        for name in ("normal", "position"):
            fractions, low, high = _fractions(truth.layers[name])
            planes.append(fractions)
            channels.append({"name": name, "planes": 3, "coding": "fraction", "low": low, "high": high})
    out.blobs[key], _ = _packed(np.concatenate(planes))
    out.scenes[key] = {"channels": channels, "eye": _exact(truth.eye), "lights": _lights(truth)}
    for check in checks:
        shown, anchor = pictures[check.id], anchors[check.id]
        layers = _planes(shown.layers[..., : 3 * len(terms)]).reshape(len(terms), 3, height, width)
        limit = _planes(shown.limit)
        far = [_excess(yours, layer, limit) for yours, layer in zip(layers, expected)]
        planes = [*(_halves(yours) for yours in layers), np.stack([_steps(ratio) for ratio in far])]
        channels = [{"name": name, "planes": 3, "coding": "half"} for name in terms]
        channels += [{"name": f"{name} excess", "planes": 1, "coding": "excess"} for name in terms]
        out.blobs[anchor], against = _packed(np.concatenate(planes), base)
        viewer = {
            "width": width,
            "height": height,
            "scene": key,
            "channels": channels,
            "against": against,
            "whole": whole,
        }
        viewer["pixel"] = place = _named_pixel(check, truth.mask.shape)
        if place:
            x, y = place
            yours = {name: _exact(layers[k, :, y, x]) for k, name in enumerate(terms)}
            yours |= {f"{name} excess": _exact([far[k][y, x]]) for k, name in enumerate(terms)}
            right = {name: _exact(expected[k][:, y, x]) for k, name in enumerate(terms)}
            if whole:
                right |= {name: _exact(truth.layers[name][y, x]) for name in ("normal", "position")}
            viewer["exact"] = {"yours": yours, "expected": right}
        out.viewers[anchor] = viewer
    return out


def _planes(layer: np.ndarray) -> np.ndarray:
    """(H, W, n) -> (n, H, W), a copy"""
    return np.array(np.moveaxis(layer, 2, 0), np.float32, order="C")


def _halves(planes: np.ndarray) -> np.ndarray:
    """The bits of float16. What is finite stays finite. (numpy's own conversion takes three times as long.)"""
    finite = np.isfinite(planes)
    x = np.clip(planes, -65504, 65504)
    if not finite.all():
        x[~finite] = 0
    negative = x < 0
    np.abs(x, out=x)
    x *= np.float32(2.0**-112)  # moves the exponent to where float16 has it
    bits = x.view(np.uint32)
    bits += 1 << 12
    bits >>= 13
    halves = bits.astype(np.uint16)
    if negative.any():
        halves[negative] |= 0x8000
    if not finite.all():
        with np.errstate(invalid="ignore"):
            halves[~finite] = planes[~finite].astype(np.float16).view(np.uint16)
    return halves


def _excess(student: np.ndarray, expected: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Each pixel's largest |delta| / limit over the planes; infinite where the student's pixel is not finite."""
    with np.errstate(all="ignore"):
        ratio = student - expected
        np.abs(ratio, out=ratio)
        ratio /= np.maximum(limit, 1e-37)
        ratio = np.maximum(np.maximum(ratio[0], ratio[1]), ratio[2])  # NaN stays
    ratio[np.isnan(ratio)] = np.inf
    return ratio


def _steps(ratio: np.ndarray) -> np.ndarray:
    """1 at 1/4 of the tolerance, 16 steps a doubling; 0 below that, where all correct programs are; 65535: infinite."""
    out = np.zeros(ratio.shape, np.uint16)
    told = ratio >= 0.25
    with np.errstate(over="ignore"):
        steps = 33 + 16 * np.log2(np.minimum(ratio[told], 2.0**127))
    out[told] = np.where(np.isinf(ratio[told]), 65535, np.maximum(np.rint(steps), 1)).astype(np.uint16)
    return out


def _fractions(layer: np.ndarray) -> tuple[np.ndarray, list[float], list[float]]:
    """(H, W, n) -> (n, H, W): 0 to 65535 between each channel's smallest and largest value."""
    planes = np.nan_to_num(_planes(layer))
    low, high = planes.min(axis=(1, 2)), planes.max(axis=(1, 2))
    unit = (planes - low[:, None, None]) * (65535 / np.maximum(high - low, 1e-30))[:, None, None]
    return np.rint(unit).astype(np.uint16), _exact(low), _exact(high)


def _packed(planes: np.ndarray, base: np.ndarray | None = None) -> tuple[Markup, list[int]]:
    """The blob, and which planes are stored as differences from those of `base`."""
    against: list[int] = []
    squeeze = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    parts = []
    for k, plane in enumerate(planes):
        change = None if base is None or k >= len(base) else plane - base[k]
        if change is not None and np.count_nonzero(change) < change.size / 4:
            against.append(k)
        else:
            change = plane.copy()
            change[1:] -= plane[:-1]
            down = change.copy()
            change[:, 1:] -= down[:, :-1]
        change = (change << 1) ^ (change.view(np.int16) >> 15).view(np.uint16)
        parts += [squeeze.compress((change >> 8).astype(np.uint8)), squeeze.compress(change.astype(np.uint8))]
    return Markup(base64.b64encode(b"".join([*parts, squeeze.flush()])).decode()), against


def _exact(values: Iterable[Any]) -> list[float | str]:
    """For JSON, which has no NaN and no infinity: they travel as words."""
    numbers = [float(v) for v in values]
    return [
        float(f"{v:.7g}") if math.isfinite(v) else {"nan": "NaN", "inf": "Infinity"}.get(str(v), "-Infinity")
        for v in numbers
    ]


def _lights(truth: SceneTruth) -> list[dict[str, Any]]:
    out = []
    for light in getattr(truth, "lights", []):
        at = light["position"] if light["placed"] else light["direction"]
        called = {"spot": "spotlight"}.get(light["name"], f"{light['name']} light")
        out.append({"kind": called, "directional": not light["placed"], "at": _exact(at)})
    return out


# --- Error against run time ---


@dataclass
class Plot:
    """The renders of one scene."""

    name: str
    svg: Markup
    rows: list[tuple[str, str, str]]  # series, error, milliseconds


def _plots(result: Result) -> list[Plot]:
    scenes: dict[str, dict[str, list[Point]]] = {}
    for check in terminal.in_order(result, *terminal.STATUS):
        for point in check.runs:
            own = point.series == "yours"
            series = f"yours, {terminal.BACKENDS[check.backend]}" if own else plain(point.series)
            points = scenes.setdefault(terminal.label(check), {}).setdefault(series, [])
            if point not in points and point.seconds > 0 and math.isfinite(point.rmse):
                points.append(point)
    return [_plot(name, series) for name, series in scenes.items() if any(series.values())]


def _plot(name: str, series: dict[str, list[Point]]) -> Plot:
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
