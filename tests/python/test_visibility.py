"""Every sample of our rasterizer beside llvmpipe's: the same triangle, and depths beside the truth in double."""

from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_of_scene
from shadelab.gl.client import Client
from shadelab.machine import renderer
from shadelab.measure import visibility
from shadelab.measure.peer import DepthFrame
from shadelab.measure.visibility import LEAST_HEIGHT, MADE, OUR_DEPTH_ERROR, SAMPLES, UNIT, Comparison

QUICK = ["phong/teapot", "phong/interpolation", "phong/grazing", "microfacet/metals", "lights/cosine", "lights/studio"]
LLVMPIPE_DEPTH_ERROR = 8 * UNIT  # measured: 5.5 at most
FORGIVEN = 1e-4  # of the covered samples, where triangles are clipped


@pytest.fixture(scope="module")
def client():
    return Client("", "")


def scene_file(name: str) -> Path:
    if name in MADE:
        return visibility.made_scene(name)
    scene = ROOT / "scenes" / f"{name}.toml"
    if renderer.describe(scene, assignment_of_scene(scene).directory).missing_meshes():
        pytest.skip(f"{name}: its mesh is absent")
    return scene


def check(c: Comparison) -> None:
    assert c.covered > 1000
    # Where nothing is clipped, only two things may decide otherwise: a corner that lies half-way between two places of the
    # grid but for a float's last bit (ours divides by w, llvmpipe multiplies by 1/w), and depths that are equal within
    # both programs' errors.
    assert c.differing == c.ties, c
    assert c.differing_clipped <= FORGIVEN * c.covered, c
    assert c.off_edge <= 1, c  # rounding moves an edge by 0.71 steps of the grid at most
    assert c.ours_setup.max <= OUR_DEPTH_ERROR / UNIT, c
    assert c.peer_setup.max <= LLVMPIPE_DEPTH_ERROR / UNIT, c
    # The vertices' own float32 roundings come on top, of both programs the same.
    assert c.ours.p999 <= OUR_DEPTH_ERROR / UNIT, c


def compare(name: str, samples: int, client: Client, folder: Path) -> Comparison:
    return visibility.compare(scene_file(name), samples, client, folder)


@pytest.mark.parametrize("samples", SAMPLES)
@pytest.mark.parametrize("name", [*QUICK, *MADE])
def test_every_sample_sees_what_it_sees_in_llvmpipe(name, samples, client, tmp_path):
    check(compare(name, samples, client, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("samples", SAMPLES)
@pytest.mark.parametrize(
    "name", [n for s in visibility.public_scenes() if (n := f"{s.parent.name}/{s.stem}") not in QUICK]
)
def test_every_sample_of_every_scene(name, samples, client, tmp_path):
    check(compare(name, samples, client, tmp_path))


@pytest.mark.parametrize("name", [name for name in MADE if name != "odd-film"])
def test_the_scenes_made_for_clipping_are_clipped(name, client, tmp_path):
    c = compare(name, 1, client, tmp_path)
    assert c.clipped > 0.1 * c.covered


def test_samples_are_matched_by_their_place(client, tmp_path):
    """In any other order of llvmpipe's samples the images differ along every edge."""
    scene = scene_file("phong/interpolation")
    mine = visibility.ours(scene, 4, tmp_path)
    peer = visibility.llvmpipes(client, visibility.make_packet(scene, 4, tmp_path))
    differing = np.array([[(a != b).sum() for b in peer.triangle] for a in mine.triangle])
    assert differing.diagonal().max() <= 2
    assert differing[~np.eye(4, dtype=bool)].min() > 1000


def test_each_keeps_to_its_rule_of_coverage(client, tmp_path):
    """Every triangle that is seen covers its sample by the integer rule, worked out here again with integers of 64 bits."""
    scene = scene_file("phong/teapot")
    packet = visibility.make_packet(scene, 4, tmp_path)
    corners = visibility.corners_of(packet)
    for visible in (visibility.ours(scene, 4, tmp_path), visibility.llvmpipes(client, packet)):
        at = np.nonzero(visible.triangle)
        offset = np.array(SAMPLES[4])[at[0]]
        x, y = at[2] + 0.5 + offset[:, 0], corners.height - at[1] - 0.5 + offset[:, 1]
        assert visibility.covers(corners, visible.triangle[at], x, y).all()


@pytest.mark.parametrize("name", ["microfacet/metals", "inside-knot"])
def test_llvmpipe_draws_the_same_when_it_writes_numbers(name, client, tmp_path):
    """The benchmark's pass without a fragment shader has the same depth to the last bit."""
    packet = visibility.make_packet(scene_file(name), 1, tmp_path)
    numbered = visibility.llvmpipes(client, packet)
    for program in packet.header["programs"]:
        program["fragment"] = [{"text": "void main() {}\n", "line": 1}]
    alone = DepthFrame(client, packet)
    alone.draw()
    assert np.array_equal(numbered.depth[0], alone.image()[..., 0])


def test_the_plane_that_depths_are_held_against():
    window = np.array([[[0.0, 0.0, 0.5], [8.0, 0.0, 0.75], [0.0, 4.0, 1.0]]])
    planes = visibility.Planes(window)
    assert planes.depth(np.array([0]), np.array([4.0]), np.array([1.0])) == pytest.approx([0.75])
    assert planes.least_height[0] == pytest.approx(32 / np.sqrt(80)) and planes.least_height[0] > LEAST_HEIGHT


def test_the_table(tmp_path, monkeypatch):
    nothing, some = visibility.Errors.of(np.array([])), visibility.Errors.of(np.array([2.0, -4.0]) * UNIT)
    comparisons = [
        Comparison(name, 4, 12345, 10, 2, 2, 1, 0, 0.25, some, some, nothing, some, some) for name in ("phong/a", "b")
    ]
    *lines, _, below = visibility.markdown(comparisons).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert below.startswith("Of the 4 ties, ours is the truly nearer in 2. The samples")
    assert "at most 0.25/256 pixel" in below
    assert "| **all 2** | 4 | 24,690 | 20 | 4 | 4 | 0 |  | 4.00 / 4.00 |" in lines[3]
    (tmp_path / "docs").mkdir()
    document = tmp_path / "docs" / "rasterizer.md"
    document.write_text("before\n<!-- mismatches -->\nold\n<!-- /mismatches -->\nafter\n")
    monkeypatch.setattr(visibility, "ROOT", tmp_path)
    visibility.write_document("new")
    assert document.read_text() == "before\n<!-- mismatches -->\nnew\n<!-- /mismatches -->\nafter\n"
    document.write_text("before\n")
    with pytest.raises(visibility.UserError, match="mismatches"):
        visibility.write_document("new")
