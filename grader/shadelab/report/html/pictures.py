"""Pictures of an image check that need no script: yours, expected and how far they differ."""

import base64
import io
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from PIL import Image

from shadelab.grading.pictures import Pictures
from shadelab.report.html.encoding import as_planes, excess_of_planes
from shadelab.report.wording import label
from shadelab.result import Check
from shadelab.truth.expected import BACKGROUND, EDGE, INTERIOR
from shadelab.words import BACKENDS

THUMBNAIL = 192
PICTURE = 120_000  # bytes of one picture at most; a noisier one loses detail
MAGENTA = (255, 0, 255)
# How far beyond the tolerance, a colour per doubling from 1x to 64x. OKLCH with even steps of lightness and no magenta.
RAMP = ("#411ca2", "#1652c8", "#1185b2", "#1daea8", "#21d980", "#bbec47", "#fffcc7")


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
    exact: bool = True  # each pixel as it was, with 8 bits


# --- Colours ---

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
    return excess_of_planes(as_planes(student), as_planes(expected), as_planes(limit))


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
    planes = as_planes(linear)
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


def picture_uri(pixels: np.ndarray, most: int = PICTURE) -> tuple[Markup, bool]:
    """WebP of RGB, or of indices into PALETTE, and whether it is exact. One that is too large for that (only noise is) loses
    detail, and stands in half the size if need be."""
    image = Image.fromarray(PALETTE[pixels] if pixels.ndim == 2 else pixels)
    buffer = io.BytesIO()
    # What takes longer makes it hardly smaller: less than a tenth.
    image.save(buffer, "WEBP", lossless=True, quality=25, method=2)
    exact = buffer.tell() <= most
    while buffer.tell() > most and min(image.size) > 8:
        buffer = io.BytesIO()
        image.save(buffer, "WEBP", quality=60, method=1)
        image = image.reduce(2)
    return Markup(f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode()}"), exact


# --- Figures ---


def _figure(
    anchor: str, which: str, name: str, uri: tuple[Markup, bool], shape: tuple, alt: str, caption: str, ring=None
) -> Figure:
    return Figure(f"{anchor}-{which}", name, uri[0], shape[1], shape[0], alt, caption, ring, uri[1])


def figures_of(
    check: Check, pictures: Pictures, anchor: str, expected: tuple[Markup, bool], most: int = PICTURE
) -> list[Figure]:
    """Yours, expected, difference."""
    what = f"{label(check)} in {BACKENDS[check.backend]}"
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
    yours = picture_uri(srgb(pictures.student), most)
    far_off = picture_uri(difference(ratio, edge, bad), most)
    return [
        _figure(anchor, "yours", "Yours", yours, shape, f"Your picture of {what}.{magenta}", magenta.strip(), ring),
        _figure(anchor, "expected", "Expected", expected, shape, alt, "", ring),
        _figure(anchor, "difference", "Difference", far_off, shape, f"The difference: {worst}", worst, ring),
    ]


def _count(chosen: np.ndarray, among: np.ndarray, name: str) -> str:
    few, total = int(chosen.sum()), int(among.sum())
    share = 100 * few / total
    return f"{few} of {total} {name}" + (f" ({share:.0f} %)" if share >= 1 else " (under 1 %)" if few else "")


def named_pixel(check: Check, shape: tuple[int, ...]) -> tuple[int, int] | None:
    """(x, y) that the check names."""
    named = check.worst.inputs.get("pixel") if check.worst else None
    if not (isinstance(named, list) and len(named) == 2 and all(isinstance(n, int) for n in named)):
        return None
    return (named[0], named[1]) if 0 <= named[0] < shape[1] and 0 <= named[1] < shape[0] else None


def _worst_place(check: Check, judged: np.ndarray) -> tuple[int, int] | None:
    """(x, y): the pixel that the check names, or else the farthest that is judged strictly."""
    named = named_pixel(check, judged.shape)
    if named or not (judged > 1).any():
        return named
    y, x = np.unravel_index(np.argmax(judged), judged.shape)
    return int(x), int(y)


def thumbnail_of(check: Check, pictures: Pictures, anchor: str) -> Figure:
    """What the student's code drew in an image check that passes."""
    small = thumbnail(pictures.student)
    alt = f"Your picture of {label(check)} in {BACKENDS[check.backend]}; it passes"
    return _figure(anchor, "thumbnail", label(check), picture_uri(small, 8_000), small.shape, alt, "")
