"""Make the meshes that the scenes use.

The OBJ files are not kept in the repository: this script writes them into scenes/meshes/
at set-up, the same bytes each time, and on later runs skips what is there and up to date.

  generated   spheres, torus knots, the Utah teapot, a plane and a cube: computed in a second
  scan        bunny.obj, a laser-scanned rabbit that a Debian package ships: downloaded (24 MB),
              because no terms are stated that would let us hand it on
  benchmark   sphere and knot of a million triangles, and a small sphere: only with --bench

Without the scan everything else works; scenes that use it are skipped.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import math
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
TEAPOT_TABLE = HERE / "teapot_patches.txt"

SCAN_PACKAGE = "libcgal-demo"
SCAN_MEMBER = "bunny00.off"
SCAN_SHA256 = "ab651cb04955c161efaeb079035a1e5e1f0e0d1f816a2df67beaea68f393ff2b"
# Raise when `bunny` below changes: the scan does not depend on the rest of this file, so that an edit elsewhere does
# not download it again.
SCAN_RECIPE = 1
DOWNLOAD_SECONDS = 180

EXAMPLES = """\
examples:
  python scenes/make_meshes.py                    all meshes; a second run does nothing
  python scenes/make_meshes.py --no-scan          no network needed
  python scenes/make_meshes.py --only teapot      one mesh; repeat --only for more
  python scenes/make_meshes.py --only bunny       try the download again
  python scenes/make_meshes.py --bench            also the meshes of ./shadelab bench
  python scenes/make_meshes.py --force --out /tmp/meshes

meshes:
{meshes}

Conventions: right-handed, y up, faces counter-clockwise seen from outside. The first
lines of each file state its size. Where each mesh comes from is in scenes/SOURCES.md.
Standard output gets one line a mesh; progress and problems go to standard error. An
absent scan is not an error: the exit code stays 0.
"""


# ------------------------------------------------------------------------------------------------ mesh


@dataclass(frozen=True)
class Mesh:
    """Vertices (n,3); faces as arrays of vertex numbers from 0, each (m,3) or (m,4); perhaps one normal a vertex."""

    vertices: np.ndarray
    faces: tuple[np.ndarray, ...]
    normals: np.ndarray | None = None

    @property
    def triangles(self) -> int:
        return sum(len(block) * (block.shape[1] - 2) for block in self.faces)


def decimals(values: np.ndarray) -> np.ndarray:
    """Seven decimals: just below float32's step at 1, and far above the last bits in which maths libraries differ.

    That difference is why the files come out the same on every machine. Adding 0 turns -0 into 0.
    """
    return np.round(values, 7) + 0.0


def rows(row: str, table: np.ndarray) -> str:
    """A line for each row, all formatted at once: a loop would take several times as long for a million of them."""
    return (row + "\n") * len(table) % tuple(table.ravel().tolist())


def obj_text(mesh: Mesh, about: str) -> str:
    """Wavefront OBJ. Files without normals leave them to the framework, which averages those of the faces."""
    parts = [f"# {line}\n" for line in about.splitlines()]
    parts.append(f"# {mesh.triangles} triangles. Made by scenes/make_meshes.py; sources: scenes/SOURCES.md.\n")
    parts.append(rows("v %.7f %.7f %.7f", decimals(mesh.vertices)))
    if mesh.normals is not None:
        parts.append(rows("vn %.7f %.7f %.7f", decimals(mesh.normals)))
    for block in mesh.faces:
        if mesh.normals is None:
            parts.append(rows("f" + " %d" * block.shape[1], block + 1))
        else:
            parts.append(rows("f" + " %d//%d" * block.shape[1], np.repeat(block + 1, 2, axis=1)))
    return "".join(parts)


class Vertices:
    """Vertices that faces share, each added when its key is first met."""

    def __init__(self) -> None:
        self.points: list[tuple[float, ...]] = []
        self.numbers: dict[tuple, int] = {}

    def number(self, key: tuple, point: tuple[float, ...]) -> int:
        if key not in self.numbers:
            self.numbers[key] = len(self.points)
            self.points.append(point)
        return self.numbers[key]


# ------------------------------------------------------------------------------------------------ generated meshes


def sphere(frequency: int, normals: bool = False) -> Mesh:
    """A geodesic sphere of radius 1: 20 frequency^2 nearly equal triangles, without the poles of a latitude grid.

    Each face of the icosahedron is cut into frequency^2 triangles, and their corners are pushed out to the sphere.
    """
    golden = (1 + math.sqrt(5)) / 2
    corners = [p for s in (1, -1) for g in (golden, -golden) for p in ((0, s, g), (s, g, 0), (g, 0, s))]
    vertices = Vertices()
    faces = []
    for a, b, c in itertools.combinations(range(12), 3):
        # The icosahedron's faces are the triples of neighbours: with these coordinates an edge is 2 long.
        if any(abs(math.dist(corners[i], corners[j]) - 2) > 1e-9 for i, j in ((a, b), (b, c), (c, a))):
            continue
        if np.linalg.det(np.array([corners[a], corners[b], corners[c]])) < 0:
            b, c = c, b  # now counter-clockwise seen from outside
        rows = []
        for i in range(frequency + 1):
            rows.append([])
            for j in range(frequency + 1 - i):
                # Whole-number weights of the icosahedron's corners name a point. Faces that share it arrive at the same
                # name, so the sphere closes exactly; comparing rounded coordinates could not promise that.
                name = tuple(sorted(w for w in ((a, frequency - i - j), (b, i), (c, j)) if w[1]))
                flat = [sum(weight * corners[corner][axis] for corner, weight in name) for axis in range(3)]
                length = math.dist(flat, (0, 0, 0))
                rows[i].append(vertices.number(name, tuple(x / length for x in flat)))
        for near, far in itertools.pairwise(rows):
            faces += [(near[j], far[j], near[j + 1]) for j in range(len(far))]
            faces += [(far[j], far[j + 1], near[j + 1]) for j in range(len(far) - 1)]

    points = np.array(vertices.points)
    return Mesh(points, (np.array(faces),), points if normals else None)


def knot(segments: int, sides: int, normals: bool = False) -> Mesh:
    """A tube round the (2,3) torus knot (the trefoil), which lies in the xy plane with one lobe up.

    The curve winds twice round the z axis and three times round a torus of radii `ring` and `winding`. A frame that is
    carried along a closed curve comes back twisted and leaves a seam. The torus gives a better one: its normal is a
    formula, is at a right angle to every curve on it, and has the curve's period, so the last ring of vertices meets
    the first. The tube's normals are exact: its sections stand at right angles to the curve, so a point's normal is
    its direction from the centre.
    """
    ring, winding, tube = 0.6, 0.25, 0.15  # their sum, 1, is the distance of the outermost point

    t = np.arange(segments) * (2 * math.pi / segments)
    zero = np.zeros_like(t)
    radial = np.stack([np.sin(2 * t), np.cos(2 * t), zero], axis=1)
    around = np.stack([np.cos(2 * t), -np.sin(2 * t), zero], axis=1)
    z = np.array([0.0, 0.0, 1.0])
    cos3, sin3 = np.cos(3 * t)[:, None], np.sin(3 * t)[:, None]

    distance = ring + winding * cos3
    centre = distance * radial + winding * sin3 * z
    tangent = 2 * distance * around + 3 * winding * (cos3 * z - sin3 * radial)  # d centre / dt
    torus_normal = cos3 * radial + sin3 * z
    side = np.cross(tangent, torus_normal)
    side /= np.sqrt((side * side).sum(axis=1, keepdims=True))

    phi = (np.arange(sides) * (2 * math.pi / sides))[None, :, None]
    outward = np.cos(phi) * torus_normal[:, None] + np.sin(phi) * side[:, None]
    vertices = centre[:, None] + tube * outward

    i, j = np.meshgrid(np.arange(segments), np.arange(sides), indexing="ij")
    i2, j2 = (i + 1) % segments, (j + 1) % sides
    quads = np.stack([i * sides + j, i * sides + j2, i2 * sides + j2, i2 * sides + j], axis=-1).reshape(-1, 4)
    return Mesh(vertices.reshape(-1, 3), (quads,), outward.reshape(-1, 3) if normals else None)


def plane() -> Mesh:
    """Four unit squares in y = 0, seen from above."""
    vertices = np.array([(x, 0.0, z) for z in (-1, 0, 1) for x in (-1, 0, 1)])
    quads = np.array([(k, k + 3, k + 4, k + 1) for k in (0, 1, 3, 4)])
    return Mesh(vertices, (quads,))


def cube() -> Mesh:
    """A cube of edge 1. No two sides share a vertex, so averaging normals leaves the sides flat."""
    vertices = []
    for axis, sign in itertools.product(range(3), (1, -1)):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]  # u x v = the axis
        out = sign * np.eye(3)[axis]
        vertices += [(out + a * u + sign * b * v) / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return Mesh(np.array(vertices), (np.arange(24).reshape(6, 4),))


# ------------------------------------------------------------------------------------------------ hard cases


def needles(count: int) -> Mesh:
    """A cone of height 1 on a circle of radius 1 in y = 0: each of its triangles runs from the tip to the rim."""
    angle = np.arange(count) * (2 * math.pi / count)
    rim = np.stack([np.cos(angle), np.zeros(count), -np.sin(angle)], axis=1)
    k = np.arange(count)
    return Mesh(np.vstack([rim, [[0.0, 1.0, 0.0]]]), (np.stack([k, (k + 1) % count, np.full(count, count)], axis=1),))


def strips() -> Mesh:
    """The square of `plane`, cut at x = 2^-k on either side of x = 0: each strip is half as wide as the one before.

    The file's seven decimals end the halving: the last strips have no width left, and their triangles no area.
    """
    half = [2.0**-k for k in range(28)]
    x = [-h for h in half] + half[::-1]
    vertices = np.array([(a, 0.0, z) for a in x for z in (-1, 1)])
    k = 2 * np.arange(len(x) - 1)
    return Mesh(vertices, (np.stack([k, k + 1, k + 3], axis=1), np.stack([k, k + 3, k + 2], axis=1)))


def hourglass() -> Mesh:
    """Two cones, tip to tip at the origin, their axis along y, 2 tall: at the tip the normals of the faces cancel."""
    sides, rings = 32, 8
    angle = np.arange(sides) * (2 * math.pi / sides)
    around = np.stack([np.cos(angle), np.zeros(sides), -np.sin(angle)], axis=1)
    heights = [k / rings for k in range(-rings, rings + 1) if k]
    vertices = np.vstack([[[0.0, 0.0, 0.0]], *(0.6 * abs(h) * around + [0, h, 0] for h in heights)])
    k = np.arange(sides)
    k2 = (k + 1) % sides
    first = [1 + ring * sides for ring in range(2 * rings)]
    quads = [
        np.stack([low + k, low + k2, high + k2, high + k], axis=1)
        for low, high in itertools.pairwise(first)
        if high != first[rings]
    ]
    below, above = first[rings - 1], first[rings]
    tips = [np.stack([below + k, below + k2, 0 * k], axis=1), np.stack([above + k2, above + k, 0 * k], axis=1)]
    return Mesh(vertices, (np.vstack(quads), np.vstack(tips)))


def turncoat() -> Mesh:
    """A square of 2 by 2 about the origin, facing z, whose normals at the top are the opposite of those below them: halfway,
    on y = 0, they cancel. In each of its eight columns they face another way; columns share no vertices."""
    columns = 8
    vertices, normals = [], []
    for k in range(columns):
        angle = k / columns * (math.pi / 2)
        for x, y in ((k, -1), (k + 1, -1), (k + 1, 1), (k, 1)):
            vertices.append((x / columns * 2 - 1, y, 0))
            normals.append((-y * math.sin(angle), 0, -y * math.cos(angle)))
    return Mesh(np.array(vertices, float), (np.arange(4 * columns).reshape(columns, 4),), np.array(normals))


FAR_PLACE = (1e8, -1e8, 5e7)


def far_sphere() -> Mesh:
    """A sphere of radius 1 whose file holds coordinates of a hundred million."""
    near = sphere(12)
    return Mesh(near.vertices + FAR_PLACE, near.faces)


# ------------------------------------------------------------------------------------------------ teapot

# Faces have vertices in common inside a shell and not between shells: handle and spout start inside the body, and lid
# and rim meet in a sharp groove, which averaged normals would smear.
TEAPOT_SHELLS = (("rim", "body", "bottom"), ("knob", "lid"), ("handle",), ("spout",))
TEAPOT_HEIGHT = 3.15  # of the knob's top, in the table's units
# Newell's lid is smaller than the opening (radius 1.3 in 1.4), and one sees inside through the gap. It is widened until
# the two edges, the same curve at two sizes, fall together.
LID_FIT = 1.4 / 1.3


def teapot_patches() -> dict[str, list[np.ndarray]]:
    """The control points of each part's patches, (4,4,3) each, from the table."""
    points: dict[int, tuple[float, ...]] = {}
    patches: dict[str, list[np.ndarray]] = {}
    for line in TEAPOT_TABLE.read_text(encoding="utf-8").splitlines():
        match line.split():
            case ["point", number, *xyz]:
                points[int(number)] = tuple(float(x) for x in xyz)
            case ["patch", part, *numbers]:
                grid = np.array([points[int(n)] for n in numbers]).reshape(4, 4, 3)
                patches.setdefault(part, []).append(grid)
    return patches


def teapot(divisions: int) -> Mesh:
    """The Utah teapot, each patch evaluated on a grid of divisions^2 quads; 1 tall, standing on y = 0, spout to +x."""
    patches = teapot_patches()
    for part in ("knob", "lid"):
        patches[part] = [grid * (LID_FIT, LID_FIT, 1.0) for grid in patches[part]]

    # The cubic Bernstein polynomials. s is t read backwards, not 1 - t, so that a border gives the same numbers from
    # either of its two patches, in whichever direction they run along it.
    t = np.arange(divisions + 1) / divisions
    s = t[::-1]
    basis = np.stack([s * s * s, 3 * s * s * t, 3 * s * t * t, t * t * t], axis=1)

    vertices = Vertices()
    quads, triangles = [], []
    for shell, parts in enumerate(TEAPOT_SHELLS):
        for grid in (grid for part in parts for grid in patches[part]):
            # Nine decimals find the points that patches have in common. Control points have at most five and, at ten
            # divisions, a border's weights three: exact coordinates have eight, and rounding them is never a toss-up.
            # (Those of the widened lid have more; that it closes is tested.)
            surface = np.round(np.einsum("ia,jb,abk->ijk", basis, basis, grid), 9) + 0.0
            index = [[vertices.number((shell, *p), tuple(p)) for p in row] for row in surface.tolist()]
            for i, j in itertools.product(range(divisions), repeat=2):
                ring = [index[i][j], index[i][j + 1], index[i + 1][j + 1], index[i + 1][j]]
                face = [v for k, v in enumerate(ring) if v != ring[k - 1]]
                # In the middle of lid and bottom a patch's border shrinks to a point, and the quad to a triangle.
                (quads if len(face) == 4 else triangles).append(face)

    x, y, z = np.array(vertices.points).T / TEAPOT_HEIGHT
    return Mesh(np.stack([x, z, -y], axis=1), (np.array(quads), np.array(triangles)))  # the table has z up


# ------------------------------------------------------------------------------------------------ scan


class ScanUnavailable(Exception):
    """Why the scanned mesh cannot be had."""


def run_tool(command: list[str], folder: Path) -> None:
    name = command[0]
    try:
        done = subprocess.run(
            command,
            check=False,
            cwd=folder,
            env={**os.environ, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=DOWNLOAD_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise ScanUnavailable(f"{name} took more than {DOWNLOAD_SECONDS} s") from None
    if done.returncode != 0:
        said = done.stderr.splitlines() or ["it did not say why"]
        raise ScanUnavailable(f"{name} failed: {next((line for line in said if line.startswith('E:')), said[0])}")


def fetch_scan() -> bytes:
    """The package's OFF file, proved to be the one that the expected images were made with."""
    for tool in ("apt-get", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise ScanUnavailable(f"there is no {tool} here (the mesh comes in a Debian package)")
    progress(f"bunny.obj: downloading the package {SCAN_PACKAGE} (24 MB) ...")
    with tempfile.TemporaryDirectory(prefix="shadelab-scan-") as name:
        folder = Path(name)
        # `download` only fetches: it needs no root and installs nothing.
        patience = ["-o", "Acquire::Retries=1", "-o", "Acquire::http::Timeout=20"]
        run_tool(["apt-get", *patience, "download", SCAN_PACKAGE], folder)
        package = next(folder.glob("*.deb"), None)
        if package is None:
            raise ScanUnavailable(f"apt-get left no package {SCAN_PACKAGE}")
        run_tool(["dpkg-deb", "-x", package.name, "tree"], folder)
        for archive in sorted(folder.glob("tree/**/data.tar*")):
            with tarfile.open(archive) as tar:
                for member in tar:
                    if member.isfile() and Path(member.name).name == SCAN_MEMBER:
                        data = tar.extractfile(member).read()
                        if digest(data) != SCAN_SHA256:
                            raise ScanUnavailable(f"{SCAN_MEMBER} in {package.name} is another one (sha256 differs)")
                        return data
        raise ScanUnavailable(f"{package.name} holds no {SCAN_MEMBER}")


def bunny() -> Mesh:
    """The scan, 1 tall and standing on y = 0, the middle of its extent at x = z = 0."""
    try:
        tokens = fetch_scan().split()
    except (OSError, EOFError, tarfile.TarError, zlib.error) as error:  # disk full, damaged archive
        why = (str(error) or repr(error)).splitlines()[0]
        raise ScanUnavailable(f"the package cannot be unpacked: {why}") from None
    # OFF: the word, counts of vertices, faces and edges, coordinates, and "3 a b c" for each triangle
    n, m = int(tokens[1]), int(tokens[2])
    vertices = np.array(tokens[4 : 4 + 3 * n], dtype=np.float64).reshape(n, 3)
    faces = np.array(tokens[4 + 3 * n : 4 + 3 * n + 4 * m], dtype=np.int64).reshape(m, 4)[:, 1:]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    origin = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return Mesh((vertices - origin) / (high[1] - low[1]), (faces,))


# ------------------------------------------------------------------------------------------------ what is made when


@dataclass(frozen=True)
class Recipe:
    name: str
    make: Callable[[], Mesh]
    about: str  # the file's opening comment; its first line also stands in --help
    scan: bool = False
    bench: bool = False


SPHERE = "Sphere of radius 1 about the origin"
KNOT = "Torus knot (2,3) in the xy plane, about the origin, within a radius of 1"

RECIPES = (
    Recipe("sphere", lambda: sphere(16, normals=True), f"{SPHERE}, with exact normals. Closed."),
    Recipe("sphere-coarse", lambda: sphere(3), f"{SPHERE}, coarse, to tell flat, Gouraud and Phong apart. Closed."),
    Recipe("sphere-70k", lambda: sphere(59), f"{SPHERE}, in small triangles. Closed."),
    Recipe("knot", lambda: knot(320, 32, normals=True), f"{KNOT}, with exact normals. Closed."),
    Recipe("knot-70k", lambda: knot(600, 58), f"{KNOT}, in small triangles. Closed."),
    Recipe(
        "teapot",
        lambda: teapot(10),
        "Utah teapot (Martin Newell, 1975), 1 tall, standing on y = 0, axis at x = z = 0, spout to +x.\n"
        "Open at the spout's mouth, and where handle and spout end inside the body.",
    ),
    Recipe("plane", plane, "Square of 2 by 2 about the origin in y = 0, in four, facing +y. Open."),
    Recipe("cube", cube, "Cube of edge 1 about the origin; sides share no vertices. Closed."),
    Recipe("needles", lambda: needles(4000), "Cone 1 tall on a circle of radius 1 in y = 0, all of slivers. Open."),
    Recipe("strips", strips, "Square of 2 by 2 in y = 0 in ever narrower strips, some without area. Open."),
    Recipe("hourglass", hourglass, "Two cones 1 tall, tip to tip at the origin, where normals cancel. Open."),
    Recipe("turncoat", turncoat, "Square of 2 by 2, facing z, whose normals oppose each other top to bottom. Open."),
    Recipe("far-sphere", far_sphere, "Sphere of radius 1 about (1e8, -1e8, 5e7). Closed."),
    Recipe(
        "bunny",
        bunny,
        "Scanned rabbit, 1 tall, standing on y = 0, centred at x = z = 0. Closed.\n"
        "Not ours: test data, not to be handed on.",
        scan=True,
    ),
    Recipe("sphere-1k", lambda: sphere(7), f"{SPHERE}, in about a thousand triangles. Closed.", bench=True),
    Recipe("sphere-1m", lambda: sphere(224), f"{SPHERE}, in about a million triangles. Closed.", bench=True),
    Recipe("knot-1m", lambda: knot(2280, 220), f"{KNOT}, in about a million triangles. Closed.", bench=True),
)


def progress(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def replace(path: Path, data: bytes) -> None:
    """Write in one step, so that a stopped run never leaves half a mesh under its final name."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


class Stamp:
    """`.stamp.json`: for each mesh what it was made from, what came out, and its triangle count (for the report)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / ".stamp.json"
        self.script = digest(Path(__file__).read_bytes() + TEAPOT_TABLE.read_bytes())
        try:
            self.outputs = dict(json.loads(self.path.read_text(encoding="utf-8"))["outputs"])
        except (OSError, ValueError, KeyError, TypeError):
            self.outputs = {}  # missing or damaged: everything is made again

    def source(self, recipe: Recipe) -> str:
        return f"{SCAN_SHA256} recipe {SCAN_RECIPE}" if recipe.scan else self.script

    def up_to_date(self, recipe: Recipe) -> bool:
        entry = self.outputs.get(recipe.name, {})
        path = self.folder / f"{recipe.name}.obj"
        if entry.get("source") != self.source(recipe) or not path.is_file():
            return False
        return entry.get("sha256") == digest(path.read_bytes())

    def triangles(self, recipe: Recipe) -> int:
        return self.outputs[recipe.name]["triangles"]

    def record(self, recipe: Recipe, data: bytes, triangles: int) -> None:
        self.outputs[recipe.name] = {"source": self.source(recipe), "sha256": digest(data), "triangles": triangles}
        text = json.dumps({"script": self.script, "outputs": self.outputs}, indent=2, sort_keys=True)
        replace(self.path, (text + "\n").encode())


def parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    listing = "\n".join(f"  {r.name:<14}  {r.about.splitlines()[0]}{' (--bench)' * r.bench}" for r in RECIPES)
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog=EXAMPLES.format(meshes=listing),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=HERE / "meshes", help="folder to write into (default: scenes/meshes)"
    )
    parser.add_argument(
        "--only",
        metavar="NAME",
        action="append",
        choices=[r.name for r in RECIPES],
        help="make this mesh alone; may be repeated",
    )
    parser.add_argument(
        "--scan",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="fetch the scanned mesh, or leave it out (default: fetch)",
    )
    parser.add_argument(
        "--bench", action="store_true", help="also the large meshes of ./shadelab bench (about 70 MB, 10 s)"
    )
    parser.add_argument("--force", action="store_true", help="make again what is up to date")
    arguments = parser.parse_args(argv)
    if not arguments.scan and "bunny" in (arguments.only or ()):
        parser.error("--only bunny asks for the scan and --no-scan leaves it out")
    return arguments


def make(recipe: Recipe, stamp: Stamp, force: bool) -> None:
    path = stamp.folder / f"{recipe.name}.obj"
    current = stamp.up_to_date(recipe)
    if current and not force:
        print(f"{path.name:<18} {stamp.triangles(recipe):>7} triangles  up to date")
        return
    start = time.perf_counter()
    try:
        mesh = recipe.make()
    except ScanUnavailable as why:
        if not current:
            path.unlink(missing_ok=True)  # an old one would quietly give other images than expected
        state = "is kept as it was, since it cannot be fetched" if current else "is absent"
        effect = "" if current else "; scenes that use it are skipped"
        progress(f"{path.name} {state}: {why}{effect}. To retry: python scenes/make_meshes.py --only {recipe.name}")
        return
    data = obj_text(mesh, f"{path.name}: {recipe.about}").encode("ascii")
    replace(path, data)
    stamp.record(recipe, data, mesh.triangles)
    print(f"{path.name:<18} {mesh.triangles:>7} triangles  made in {time.perf_counter() - start:.2f} s")


def main(argv: list[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
        stamp = Stamp(arguments.out)
        for recipe in RECIPES:
            by_default = (arguments.scan or not recipe.scan) and (arguments.bench or not recipe.bench)
            if recipe.name in arguments.only if arguments.only else by_default:
                make(recipe, stamp, arguments.force)
    except OSError as error:
        progress(f"make_meshes: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
