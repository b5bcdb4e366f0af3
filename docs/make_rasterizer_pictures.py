"""Makes the two pictures of docs/rasterizer.md, from what the rasterizer itself sees. Takes a few seconds.

    .shadelab/venv/bin/python docs/make_rasterizer_pictures.py

The counts of invocations are simulated, and printed: triangles in the order in which the mesh lists them, coverage by the
integer rule at pixel centres, depth tested before shading, and every 2 x 2 quad shaded whole of which some pixel passes.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from shadelab.measure import visibility
from shadelab.measure.bench import make_missing_meshes
from shadelab.measure.visibility import Corners, Planes, Visible
from shadelab.paths import SCENES

PICTURES = Path(__file__).resolve().parent / "pictures"
MESH = "knot-70k"
SIZE, ZOOM, FROM = 512, 32, (272, 364)  # pixels of the film and of the enlarged part; its top left pixel (column, row)
BINS = [(0, "0", "#ffffff"), (1, "1", "#d3e5f5"), (2, "2", "#fdd095"), (4, "3-4", "#fca55d"), (8, "5-8", "#f16c3a"),
        (16, "9-16", "#c22a1d"), (10**9, "more", "#5a0000")]  # fmt: skip
# Pastels that differ in lightness as well, for print.
COLOURS = ["#f7d9c4", "#b9d7ea", "#cfe8c0", "#f3e79b", "#d9c7e8", "#a8d5cf", "#f2b8b5", "#dcdcdc"]


# Where triangles lie is all that is drawn: the material is there because a scene has one.
SCENE = """
film = {{ width = {size}, height = {size} }}
camera = {{ eye = {eye}, target = [0, 0, 0], fov_y = 45, near = 0.1, far = 20 }}
light = [{{ kind = "point", position = [1, 2, 3], intensity = [1, 1, 1] }}]
material.grey = {{ model = "phong", ka = [0, 0, 0], kd = [0.5, 0.5, 0.5], ks = [0, 0, 0], q = 1 }}
object = [{{ mesh = "{mesh}", material = "grey" }}]
"""


def mesh_file(name: str) -> Path:
    return SCENES / "meshes" / f"{name}.obj"


def view(mesh: str, size: int, eye: list[float]) -> tuple[Corners, Visible]:
    """The triangles of a mesh about the origin, and what the rasterizer sees of them with one sample a pixel."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = folder / "picture.toml"
        scene.write_text(SCENE.format(mesh=mesh_file(mesh), eye=eye, size=size))
        corners = visibility.corners_of(visibility.make_packet(scene, 1, folder))
        return corners, visibility.ours(scene, 1, folder)


# ---------------------------------------------------------------------------------- invocations, quads against visible


def fragments(corners: Corners) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(triangle, x, y) of all pixels whose centres a triangle covers, y upwards; triangles in their order."""
    triangle = np.arange(1, len(corners.rounded))
    at = visibility.on_grid(corners, triangle)
    low, high = -(-at.min(axis=1) // 256), at.max(axis=1) // 256 + 1
    low, high = np.maximum(low, 0), np.minimum(high, [corners.width, corners.height])
    across, down = np.maximum(high - low, 0).T
    pairs = np.repeat(np.arange(len(triangle)), across * down)
    rank = np.arange(len(pairs)) - np.repeat(np.cumsum(across * down) - across * down, across * down)
    x, y = low[pairs, 0] + rank % across[pairs], low[pairs, 1] + rank // across[pairs]
    kept = visibility.covers(corners, triangle[pairs], x + 0.5, y + 0.5)
    return triangle[pairs][kept], x[kept], y[kept]


def quad_invocations(corners: Corners, width: int = 2, height: int = 2) -> np.ndarray:
    """How often the fragment shader runs for each pixel, row 0 at the top; neighbours of a quad that only help included."""
    triangle, x, y = fragments(corners)
    depth = Planes(corners.window(corners.rounded)).depth(triangle, x + 0.5, y + 0.5)
    order = np.lexsort((triangle, y * corners.width + x))
    pixel = (y * corners.width + x)[order]
    # Of each pixel's fragments, in draw order, those that are nearer than all before them.
    start = np.r_[True, pixel[1:] != pixel[:-1]]
    passes, nearest = np.zeros(len(order), bool), np.inf
    for i, (first, z) in enumerate(zip(start, depth[order])):
        nearest = np.inf if first else nearest
        if z < nearest:
            passes[i], nearest = True, z
    shaded = order[passes]
    quads = np.unique(np.stack([triangle[shaded], x[shaded] // width, y[shaded] // height]), axis=1)
    counts = np.zeros((corners.height // height, corners.width // width), int)
    np.add.at(counts, (quads[2], quads[1]), 1)
    return counts.repeat(height, axis=0).repeat(width, axis=1)[::-1]


def painted(counts: np.ndarray) -> Image.Image:
    palette = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, _, c in BINS], np.uint8)
    return Image.fromarray(palette[np.searchsorted([most for most, _, _ in BINS], counts)])


def quads_picture(file: Path) -> None:
    corners, seen = view(MESH, SIZE, [0.4, 0.5, 2.7])
    maps = [quad_invocations(corners), (seen.triangle[0] != 0).astype(int)]
    titles = ["2 x 2 quads, in draw order", "once per visible pixel and triangle"]
    gap, top, bottom = 32, 66, 56
    sheet = Image.new("RGB", (2 * SIZE + 3 * gap, top + 2 * SIZE + gap + bottom), "white")
    draw = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(size=24), ImageFont.load_default(size=19)
    x0, y0 = FROM
    for k, (counts, title) in enumerate(zip(maps, titles)):
        left = gap + k * (SIZE + gap)
        draw.text((left, 8), title, "black", large)
        draw.text((left, 38), f"{counts.sum():,} invocations", "#444444", small)
        sheet.paste(painted(counts), (left, top))
        draw.rectangle([left - 1, top - 1, left + SIZE, top + SIZE], outline="#888888")
        draw.rectangle([left + x0 - 1, top + y0 - 1, left + x0 + ZOOM, top + y0 + ZOOM], outline="black", width=2)
        part = painted(counts[y0 : y0 + ZOOM, x0 : x0 + ZOOM]).resize((SIZE, SIZE), Image.Resampling.NEAREST)
        below = top + SIZE + gap
        sheet.paste(part, (left, below))
        draw.rectangle([left - 2, below - 2, left + SIZE + 1, below + SIZE + 1], outline="black", width=2)
    y = top + 2 * SIZE + gap + 18
    draw.text((gap, y), "invocations per pixel:", "black", small)
    x = gap + 215
    for _, label, colour in BINS:
        draw.rectangle([x, y, x + 26, y + 22], fill=colour, outline="#888888")
        draw.text((x + 34, y), label, "black", small)
        x += 52 + int(draw.textlength(label, small)) + 8
    sheet.save(file, optimize=True)


def print_counts() -> None:
    for size in (256, 512, 1024):
        corners, seen = view(MESH, size, [0.4, 0.5, 2.7])
        quads, eights = quad_invocations(corners).sum(), quad_invocations(corners, 4, 2).sum()
        visible = int((seen.triangle[0] != 0).sum())
        print(
            f"{MESH}, {size}: {visible} visible, {quads} in quads ({quads / visible:.2f}), {eights} in pairs of quads"
        )


# -------------------------------------------------------------------------------------------------- a part of a tile

PART, PIXEL, MARGIN = 16, 48, 30  # pixels shown each way; their size in the drawing
CORNER = (16, 40)  # column and row (from the bottom) of the part's bottom left pixel in the film
FILM = 64
FOLLOWED = 0.5, 0.4  # the triangle at this share of the part is the one whose groups are shown


def svg_line(a: np.ndarray, b: np.ndarray, style: str) -> str:
    return f'<line x1="{a[0]:.2f}" y1="{a[1]:.2f}" x2="{b[0]:.2f}" y2="{b[1]:.2f}" {style}/>'


def colouring(triangles: list[int], at: dict[int, np.ndarray]) -> dict[int, str]:
    """A colour each, so that triangles with a corner in common differ."""
    points = {t: {tuple(p) for p in at[t]} for t in triangles}
    out: dict[int, int] = {}
    for t in triangles:
        taken = [out[u] for u in out if points[t] & points[u]]
        # The least used of those that no neighbour has.
        used = list(out.values())
        out[t] = min(range(len(COLOURS)), key=lambda c: (taken.count(c), used.count(c)))
    return {t: COLOURS[c] for t, c in out.items()}


def tile_picture(file: Path) -> None:
    corners, seen = view("sphere-1k", FILM, [0.4, 0.5, 2.7])
    x0, y0 = CORNER
    part = seen.triangle[0][::-1][y0 : y0 + PART, x0 : x0 + PART]  # rows upwards
    numbers = [int(t) for t in np.unique(part) if t]
    at = dict(zip(numbers, visibility.on_grid(corners, np.array(numbers))))
    colour = colouring(numbers, at)
    followed = int(part[int(FOLLOWED[1] * PART), int(FOLLOWED[0] * PART)])

    def place(p: np.ndarray) -> np.ndarray:
        """A point of the grid (from the centre of the film's first pixel) in the drawing, y downwards."""
        x, y = (p[0] + 128) / 256 - x0, (p[1] + 128) / 256 - y0
        return np.array([MARGIN + x * PIXEL, MARGIN + (PART - y) * PIXEL])

    side = PART * PIXEL
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {side + 2 * MARGIN} {side + 2 * MARGIN + 150}" '
        'font-family="sans-serif" font-size="19">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<defs><clipPath id="part"><rect x="{MARGIN}" y="{MARGIN}" width="{side}" height="{side}"/></clipPath></defs>',
    ]
    for row in range(PART):
        for column in range(PART):
            fill = colour.get(int(part[row, column]), "white")
            x, y = MARGIN + column * PIXEL, MARGIN + (PART - 1 - row) * PIXEL
            out.append(
                f'<rect x="{x}" y="{y}" width="{PIXEL}" height="{PIXEL}" fill="{fill}" stroke="#fff" stroke-width="1"/>'
            )
    for row in range(PART + 1):
        y = MARGIN + row * PIXEL
        out.append(f'<line x1="{MARGIN}" y1="{y}" x2="{MARGIN + side}" y2="{y}" stroke="#8a8a8a" stroke-width="1"/>')
    for column in range(0, PART + 1, 8):
        x = MARGIN + column * PIXEL
        out.append(f'<line x1="{x}" y1="{MARGIN}" x2="{x}" y2="{MARGIN + side}" stroke="#8a8a8a" stroke-width="2.5"/>')
    # The groups that the followed triangle's rows touch.
    box = at[followed] / 256 - [x0, y0]
    rows = range(max(int(np.ceil(box[:, 1].min())), 0), min(int(np.floor(box[:, 1].max())), PART - 1) + 1)
    first, last = max(int(np.ceil(box[:, 0].min())), 0), min(int(np.floor(box[:, 0].max())), PART - 1)
    for row in rows:
        for group in range(first // 8, last // 8 + 1):
            x, y = MARGIN + group * 8 * PIXEL + 3, MARGIN + (PART - 1 - row) * PIXEL + 3
            out.append(
                f'<rect x="{x}" y="{y}" width="{8 * PIXEL - 6}" height="{PIXEL - 6}" fill="none" stroke="#1f4e9e" '
                'stroke-width="2.5" stroke-dasharray="9 5"/>'
            )
    out.append('<g clip-path="url(#part)" stroke-linecap="round">')
    for t in numbers:
        points = [place(p) for p in at[t]]
        for k in range(3):
            out.append(svg_line(points[k], points[(k + 1) % 3], 'stroke="#333" stroke-width="1.6"'))
    for t in numbers:
        grid = at[t]
        edges = np.roll(grid, -1, axis=0) - grid
        sign = np.sign(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
        points, centre = [place(p) for p in grid], sum(place(p) for p in grid) / 3
        for k in range(3):
            dx, dy = edges[k] * sign
            if not (dy < 0 or (dy == 0 and dx > 0)):
                continue
            a, b = points[k], points[(k + 1) % 3]
            across = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
            across *= np.sign(across @ (centre - a)) * 4.5
            along = (b - a) * min(0.12, 14 / np.linalg.norm(b - a))
            out.append(svg_line(a + across + along, b + across - along, 'stroke="#c22a1d" stroke-width="3"'))
    corner_list = " ".join(f"{x:.2f},{y:.2f}" for x, y in (place(p) for p in at[followed]))
    out.append(f'<polygon points="{corner_list}" fill="none" stroke="#1f4e9e" stroke-width="4"/>')
    out.append("</g>")
    for row in range(PART):
        for column in range(PART):
            x, y = MARGIN + (column + 0.5) * PIXEL, MARGIN + (PART - 0.5 - row) * PIXEL
            out.append(f'<circle cx="{x}" cy="{y}" r="3.2" fill="#111"/>')
    y = side + MARGIN + 34
    key = [
        '<circle cx="{x}" cy="{y}" r="3.2" fill="#111"/>',
        '<line x1="{a}" y1="{y}" x2="{b}" y2="{y}" stroke="#333" stroke-width="1.6"/>',
        '<line x1="{a}" y1="{y}" x2="{b}" y2="{y}" stroke="#c22a1d" stroke-width="3"/>',
        '<rect x="{a}" y="{t}" width="36" height="16" fill="none" stroke="#1f4e9e" stroke-width="2.5" stroke-dasharray="9 5"/>',
    ]
    texts = [
        "a sample; its pixel has the colour of the triangle that it sees",
        "triangles, their corners on the grid of 1/256 pixel",
        "inside of an edge: this triangle owns the samples on it (left and bottom edges)",
        "groups of eight pixels of a row that are looked at for the triangle outlined in blue",
    ]
    for k, (mark, text) in enumerate(zip(key, texts)):
        line = y + 30 * k
        out.append(mark.format(x=MARGIN + 18, a=MARGIN, b=MARGIN + 36, y=line, t=line - 8))
        out.append(f'<text x="{MARGIN + 52}" y="{line + 6}" fill="#111">{text}</text>')
    file.write_text("\n".join([*out, "</svg>"]) + "\n")


def main() -> None:
    make_missing_meshes({MESH, "sphere-1k"}, lambda *_: None)
    quads_picture(PICTURES / "quads.png")
    tile_picture(PICTURES / "tile.svg")
    if "--counts" in sys.argv:
        print_counts()


if __name__ == "__main__":
    main()
