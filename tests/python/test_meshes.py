"""scenes/make_meshes.py: the meshes are what their names promise, come out the same each time, and need no network."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tarfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scenes" / "make_meshes.py"

TRIANGLES = {
    "sphere": 5120,
    "sphere-coarse": 180,
    "sphere-70k": 69620,
    "knot": 20480,
    "knot-70k": 69600,
    "teapot": 6320,
    "plane": 8,
    "cube": 12,
}
# Of the scenes in scenes/stress: what is sound elsewhere is here not so on purpose.
HARD_TRIANGLES = {"needles": 4000, "strips": 110, "hourglass": 960, "turncoat": 16, "far-sphere": 2880}
MADE = TRIANGLES | HARD_TRIANGLES
# Vertices - edges + faces: 2 for a sphere, 0 for a tube that closes on itself.
EULER = {"sphere": 2, "sphere-coarse": 2, "sphere-70k": 2, "knot": 0, "knot-70k": 0, "cube": 2}


def run(*arguments: object, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ) if path is None else {**os.environ, "PATH": str(path)}
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=60)


@dataclass
class Obj:
    points: np.ndarray
    normals: np.ndarray
    faces: list[list[int]]

    @property
    def triangles(self) -> np.ndarray:
        return np.array([(f[0], f[k], f[k + 1]) for f in self.faces for k in range(1, len(f) - 1)])


def load(path: Path) -> Obj:
    """A reader of the test's own: v, vn and f lines; a face's vertex and normal must have one number."""
    points, normals, faces = [], [], []
    for line in path.read_text(encoding="ascii").splitlines():
        kind, *words = line.split()
        if kind == "v":
            points.append([float(w) for w in words])
        elif kind == "vn":
            normals.append([float(w) for w in words])
        elif kind == "f":
            corners = [w.split("//") for w in words]
            assert all(c[0] == c[-1] for c in corners)
            faces.append([int(c[0]) - 1 for c in corners])
        else:
            assert kind == "#", line
    return Obj(np.array(points), np.array(normals).reshape(-1, 3), faces)


def welded(mesh: Obj) -> Obj:
    """The same faces, with vertices at exactly the same place made one."""
    points, number = np.unique(mesh.points, axis=0, return_inverse=True)
    number = number.ravel()
    return Obj(points, mesh.normals, [[int(number[v]) for v in face] for face in mesh.faces])


def open_edges(mesh: Obj) -> list[tuple[int, int]]:
    """Directed edges whose reverse is missing; an edge used twice in one direction fails (a flipped or double face)."""
    edges = Counter((f[k - 1], f[k]) for f in mesh.faces for k in range(len(f)))
    assert max(edges.values()) == 1
    return [edge for edge in edges if edge[::-1] not in edges]


def loops(edges: list[tuple[int, int]]) -> list[list[int]]:
    following = dict(edges)
    assert len(following) == len(edges)
    found = []
    while following:
        loop = [next(iter(following))]
        while (after := following.pop(loop[-1])) != loop[0]:
            loop.append(after)
        found.append(loop)
    return found


def shells(mesh: Obj) -> list[Obj]:
    """The parts that share no vertex."""
    parent = list(range(len(mesh.points)))

    def root(v: int) -> int:
        while parent[v] != v:
            parent[v] = v = parent[parent[v]]
        return v

    for face in mesh.faces:
        for v in face[1:]:
            parent[root(v)] = root(face[0])
    parts: dict[int, list[list[int]]] = {}
    for face in mesh.faces:
        parts.setdefault(root(face[0]), []).append(face)
    return [Obj(mesh.points, mesh.normals, faces) for faces in parts.values()]


def volume(mesh: Obj) -> float:
    """Signed: positive when faces look outward. Holes are closed with a fan about the middle of their rim."""
    corners = mesh.points[mesh.triangles]
    for rim in loops(open_edges(mesh)):
        ring = mesh.points[rim]
        middle = np.broadcast_to(ring.mean(axis=0), ring.shape)
        corners = np.concatenate([corners, np.stack([np.roll(ring, -1, axis=0), ring, middle], axis=1)])
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    done = run("--no-scan", "--out", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[:3] for line in done.stdout.splitlines()] == [
        [f"{name}.obj", str(count), "triangles"] for name, count in MADE.items()
    ]
    return folder


@pytest.mark.parametrize("name", TRIANGLES)
def test_faces_are_sound(made: Path, name: str) -> None:
    mesh = load(made / f"{name}.obj")
    assert len(mesh.triangles) == TRIANGLES[name]
    assert set(mesh.triangles.ravel().tolist()) == set(range(len(mesh.points)))  # no vertex left over
    corners = mesh.points[mesh.triangles]
    edges = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    assert (2 * area / longest**2).min() > 0.05  # height over longest side: no degenerate triangle
    if name == "plane":
        assert (np.cross(edges[:, 0], edges[:, 1])[:, 1] > 0).all()
    else:
        # The cube's sides are flat and apart: only together do they have a volume.
        assert all(volume(shell) > 0 for shell in shells(welded(mesh) if name == "cube" else mesh))


def test_hard_cases_are_hard(made: Path) -> None:
    meshes = {name: load(made / f"{name}.obj") for name in HARD_TRIANGLES}
    for name, mesh in meshes.items():
        assert len(mesh.triangles) == HARD_TRIANGLES[name]
    corners = {name: mesh.points[mesh.triangles] for name, mesh in meshes.items()}
    cross = {name: np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) for name, c in corners.items()}
    longest = np.linalg.norm(corners["needles"] - np.roll(corners["needles"], 1, axis=1), axis=2).max(axis=1)
    assert (np.linalg.norm(cross["needles"], axis=1) / longest**2).max() < 0.002
    assert (cross["needles"][:, 1] > 0).all()  # seen from outside
    area = np.linalg.norm(cross["strips"], axis=1) / 2
    assert area.sum() == pytest.approx(4) and (cross["strips"][:, 1] >= 0).all() and (area == 0).sum() == 14
    at_tip = np.array([0 in t for t in meshes["hourglass"].triangles.tolist()])
    assert at_tip.sum() == 64 and np.abs(cross["hourglass"][at_tip].sum(axis=0)).max() < 1e-6
    outward = (cross["hourglass"] * corners["hourglass"].mean(axis=1) * [1, 0, 1]).sum(axis=1)
    assert (outward > 0).all()
    normals = meshes["turncoat"].normals.reshape(8, 4, 3)
    np.testing.assert_array_equal(normals[:, 0], -normals[:, 3])
    centre = meshes["far-sphere"].points - (1e8, -1e8, 5e7)
    assert np.linalg.norm(centre, axis=1) == pytest.approx(1, abs=2e-7)


@pytest.mark.parametrize("name", EULER)
def test_closed(made: Path, name: str) -> None:
    mesh = welded(load(made / f"{name}.obj"))
    assert open_edges(mesh) == []
    edges = sum(len(face) for face in mesh.faces) // 2
    assert len(mesh.points) - edges + len(mesh.faces) == EULER[name]


def test_sizes(made: Path) -> None:
    for name in ("sphere", "sphere-coarse", "sphere-70k"):
        assert np.linalg.norm(load(made / f"{name}.obj").points, axis=1) == pytest.approx(1, abs=2e-7)
    assert np.linalg.norm(load(made / "knot.obj").points, axis=1).max() == pytest.approx(1, abs=1e-6)
    for name, low, high in (("plane", (-1, 0, -1), (1, 0, 1)), ("cube", (-0.5,) * 3, (0.5,) * 3)):
        points = load(made / f"{name}.obj").points
        assert (tuple(points.min(axis=0)), tuple(points.max(axis=0))) == (low, high)
    teapot = load(made / "teapot.obj").points
    assert (teapot[:, 1].min(), teapot[:, 1].max()) == (0, 1)
    assert teapot[:, 2].min() == -teapot[:, 2].max()
    assert teapot[:, 0].max() > -teapot[:, 0].min()  # the spout reaches farther than the handle


@pytest.mark.parametrize("name", TRIANGLES)
def test_normals_are_written_where_promised(made: Path, name: str) -> None:
    mesh = load(made / f"{name}.obj")
    if name not in ("sphere", "knot"):
        assert len(mesh.normals) == 0
        return
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1, abs=2e-7)
    if name == "sphere":
        assert mesh.normals == pytest.approx(mesh.points, abs=0)
    corners = mesh.points[mesh.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    assert np.einsum("ij,ikj->ik", face, mesh.normals[mesh.triangles]).min() > 0.98


def test_teapot_is_whole(made: Path) -> None:
    """Four shells; welded, it is open only at the spout's mouth and where handle and spout end inside the body."""
    mesh = load(made / "teapot.obj")
    assert len(shells(mesh)) == 4
    whole = welded(mesh)
    rims = sorted(tuple(whole.points[rim].mean(axis=0) * 3.15) for rim in loops(open_edges(whole)))
    # In the units of the table, y up: both ends of the handle, then of the spout.
    ends = [(-1.95, 0.75, 0), (-1.55, 2.1375, 0), (1.7, 1.0125, 0), (3.0, 2.4, 0)]
    assert np.array(rims) == pytest.approx(np.array(ends), abs=1e-6)
    # The knob's top and the middle of the bottom, where patches shrink to a point, are one vertex each.
    for pole in ((0, 1, 0), (0, 0, 0)):
        assert (mesh.points == pole).all(axis=1).sum() == 1


def test_same_bytes_again_and_second_run_does_nothing(made: Path, tmp_path: Path) -> None:
    files = sorted(made.iterdir())
    assert [f.name for f in files] == sorted([".stamp.json", *(f"{name}.obj" for name in MADE)])
    before = {f.name: (f.read_bytes(), f.stat().st_mtime_ns) for f in files}
    again = run("--no-scan", "--out", made)
    assert again.returncode == 0
    assert [line.endswith("up to date") for line in again.stdout.splitlines()] == [True] * len(MADE)
    assert {f.name: (f.read_bytes(), f.stat().st_mtime_ns) for f in sorted(made.iterdir())} == before

    assert run("--no-scan", "--out", tmp_path).returncode == 0
    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == {n: data for n, (data, _) in before.items()}


def test_only_what_is_missing_or_altered_is_made(tmp_path: Path) -> None:
    assert run("--only", "cube", "--only", "plane", "--out", tmp_path).returncode == 0
    assert sorted(f.name for f in tmp_path.glob("*.obj")) == ["cube.obj", "plane.obj"]
    good = (tmp_path / "cube.obj").read_bytes()
    (tmp_path / "cube.obj").write_bytes(good + b"v 0 0 0\n")
    done = run("--only", "cube", "--only", "plane", "--out", tmp_path)
    assert [line.split()[3] for line in done.stdout.splitlines()] == ["up", "made"]
    assert (tmp_path / "cube.obj").read_bytes() == good
    forced = run("--only", "plane", "--force", "--out", tmp_path)
    assert " made in " in forced.stdout
    (tmp_path / ".stamp.json").write_text("not json")
    assert " made in " in run("--only", "plane", "--out", tmp_path).stdout


# ------------------------------------------------------------------------------- the benchmark's, without making a million

BENCH_TRIANGLES = {"sphere-1k": 980, "sphere-1m": 1_003_520, "knot-1m": 1_003_200}


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_meshes", SCRIPT)
    loaded = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "make_meshes", loaded)  # where dataclasses look for it
    spec.loader.exec_module(loaded)
    return loaded


def test_figures_of_the_large_meshes(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """That spheres and knots have as many triangles is what test_faces_are_sound checks on smaller ones."""
    monkeypatch.setattr(module, "sphere", lambda frequency: 20 * frequency**2)
    monkeypatch.setattr(module, "knot", lambda segments, sides: 2 * segments * sides)
    assert {recipe.name: recipe.make() for recipe in module.RECIPES if recipe.bench} == BENCH_TRIANGLES


def test_large_meshes_are_made_only_when_asked_for(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = []
    monkeypatch.setattr(module, "make", lambda recipe, stamp, force: asked.append(recipe.name))
    for arguments, expected in (
        ([], [*MADE, "bunny"]),
        (["--bench"], [*MADE, "bunny", *BENCH_TRIANGLES]),
        (["--bench", "--no-scan"], [*MADE, *BENCH_TRIANGLES]),
        (["--only", "knot-1m"], ["knot-1m"]),
    ):
        asked.clear()
        assert module.main([*arguments, "--out", str(tmp_path)]) == 0
        assert asked == expected


def test_a_mesh_of_the_benchmark(tmp_path: Path) -> None:
    for state in ("made", "up"):
        done = run("--only", "sphere-1k", "--out", tmp_path)
        assert done.stdout.split()[:4] == ["sphere-1k.obj", "980", "triangles", state]
    mesh = load(tmp_path / "sphere-1k.obj")
    assert (len(mesh.points), len(mesh.triangles), len(mesh.normals)) == (492, 980, 0)
    assert open_edges(mesh) == []


# ---------------------------------------------------------------------------------------- the scan, without a network


def script(path: Path, text: str) -> None:
    path.write_text("#!/bin/sh\n" + text)
    path.chmod(0o755)


def scan_fails(tmp_path: Path, tools: Path, reason: str) -> subprocess.CompletedProcess[str]:
    out = tmp_path / "out"
    out.mkdir()
    (out / "bunny.obj").write_text("# of unknown origin\n")
    done = run("--only", "bunny", "--out", out, path=tools)
    assert (done.returncode, done.stdout) == (0, "")
    *progress, said = done.stderr.splitlines()
    assert len(progress) <= 1 and all("downloading" in line for line in progress)
    assert said.startswith("bunny.obj is absent: ")
    for part in (reason, "scenes that use it are skipped", "python scenes/make_meshes.py --only bunny"):
        assert part in said
    assert not list(out.iterdir())  # nor is a mesh left that this script did not make
    return done


def test_no_apt(tmp_path: Path) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    done = scan_fails(tmp_path, tools, "there is no apt-get here")
    assert len(done.stderr.splitlines()) == 1


def test_offline(tmp_path: Path) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    script(tools / "dpkg-deb", "exit 1\n")
    script(tools / "apt-get", "echo 'W: some warning' >&2; echo 'E: Could not resolve host' >&2; exit 100\n")
    scan_fails(tmp_path, tools, "E: Could not resolve host")


@pytest.mark.parametrize(
    ("member", "reason"),
    [("data/meshes/bunny00.off", "sha256 differs"), ("data/meshes/other.off", "holds no bunny00.off")],
)
def test_another_file_in_the_package(tmp_path: Path, member: str, reason: str) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    off = tmp_path / "any.off"
    off.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with tarfile.open(tmp_path / "data.tar.gz", "w:gz") as tar:
        tar.add(off, arcname=member)
    for tool in ("mkdir", "cp"):
        (tools / tool).symlink_to(shutil.which(tool))
    script(tools / "apt-get", ": > libcgal-demo_1_all.deb\n")
    script(tools / "dpkg-deb", f"mkdir tree && cp '{tmp_path}/data.tar.gz' tree/\n")
    scan_fails(tmp_path, tools, reason)


def test_damaged_archive(tmp_path: Path) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "mkdir").symlink_to(shutil.which("mkdir"))
    script(tools / "apt-get", ": > libcgal-demo_1_all.deb\n")
    script(tools / "dpkg-deb", "mkdir tree && echo nonsense > tree/data.tar.gz\n")
    scan_fails(tmp_path, tools, "the package cannot be unpacked: ")


def test_no_scan_contradicts_only_bunny(tmp_path: Path) -> None:
    done = run("--only", "bunny", "--no-scan", "--out", tmp_path)
    assert done.returncode == 2
    assert "--no-scan" in done.stderr
