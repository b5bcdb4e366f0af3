"""Whatever a file holds: it is read, or refused with one line that names it. No crash, no silence."""

import subprocess
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import ROOT
from shadelab.course.assignment import flat_rows, load_assignment, named_arrays
from shadelab.paths import RENDER

PHONG = load_assignment(ROOT / "solution" / "phong")
SCENE = (ROOT / "scenes" / "phong" / "spots.toml").read_text()
CUBE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\ng side\nf 1//1 2//1 3//1 4//1\nf -5 -4 -1\nf 1 3 5\n"

words = st.sampled_from(
    [
        "nan",
        "inf",
        "-1",
        "1e40",
        "0",
        "[",
        "]",
        '"',
        "=",
        "#",
        "phong",
        "true",
        "[[light]]",
        "f",
        "v",
        "f 1 2",
        "-9",
        "\t",
    ]
)


@st.composite
def damaged(draw, text):
    """The text with some lines deleted, doubled or swapped, and some words replaced."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        k = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.sampled_from(["delete", "double", "swap", "word", "cut"]))
        if kind == "delete" and len(lines) > 1:
            del lines[k]
        elif kind == "double":
            lines.insert(k, lines[k])
        elif kind == "swap":
            other = draw(st.integers(0, len(lines) - 1))
            lines[k], lines[other] = lines[other], lines[k]
        elif kind == "word":
            parts = lines[k].split(" ")
            parts[draw(st.integers(0, len(parts) - 1))] = draw(words)
            lines[k] = " ".join(parts)
        else:
            lines[k] = lines[k][: draw(st.integers(0, len(lines[k])))]
    return "\n".join(lines) + "\n"


def read(scene: str, mesh: str | None = None) -> subprocess.CompletedProcess:
    with tempfile.TemporaryDirectory() as folder:
        if mesh is not None:
            (Path(folder) / "mesh.obj").write_text(mesh)
        file = Path(folder) / "scene.toml"
        file.write_text(scene.replace("../meshes", str(ROOT / "scenes" / "meshes")))
        command = [RENDER, "packet", file, "--assignment", PHONG.directory, "-o", Path(folder) / "frame.packet"]
        return subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=20)


def check(done: subprocess.CompletedProcess, name: str) -> None:
    assert done.returncode in (0, 2), (done.returncode, done.stderr)
    if done.returncode == 2:
        errors = [line for line in done.stderr.splitlines() if not line.startswith("note: ")]
        assert len(errors) == 1 and name in errors[0], done.stderr


@settings(max_examples=150, deadline=None)
@given(damaged(SCENE))
def test_a_damaged_scene_is_read_or_refused_in_one_line(text):
    check(read(text), "scene.toml")


@settings(max_examples=150, deadline=None)
@given(damaged(CUBE), st.sampled_from(["smooth", "flat", "file"]))
def test_a_damaged_mesh_is_read_or_refused_in_one_line(text, normals):
    scene = SCENE.split("[[object]]")[0] + f'[[object]]\nmesh = "mesh.obj"\nmaterial = "pot"\nnormals = "{normals}"\n'
    check(read(scene, text), "mesh.obj")


@given(st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_rows_and_named_arrays_are_each_others_inverse(count, seed):
    columns = PHONG.function("phong").inputs
    rows = np.random.default_rng(seed).normal(size=(count, len(columns))).astype(np.float32)
    named = named_arrays(columns, rows)
    assert named["m.kd"].shape == (count, 3) and named["m.q"].shape == (count,)
    np.testing.assert_array_equal(flat_rows(columns, named), rows)
