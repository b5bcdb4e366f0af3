"""The rules that give marks, on made-up numbers: what passes, what fails and what is said."""

from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import Scene, load_assignment
from shadelab.judge.functions import judge_function
from shadelab.judge.images import EDGE_CAP, judge_image
from shadelab.truth.expected import BACKGROUND, CHANNELS, EDGE, INTERIOR, SceneTruth, Table
from shadelab.truth.measures import LEAST_PICTURE_FLOOR, function_limit
from shadelab.truth.tables import NEAREST_HORIZON, make_table, renormalised

PHONG = load_assignment(ROOT / "solution" / "phong")
SCENE = Scene("made-up", Path("made-up.toml"), ROOT, 10)


def made_up(size=64, radius=24):
    """A disc in front of nothing, brightness 0.2 to 1."""
    layers = np.zeros((size, size, 21), np.float32)
    y, x = np.mgrid[:size, :size] - size / 2
    disc = x**2 + y**2 < radius**2
    layers[disc, CHANNELS["id"]] = 1
    layers[disc, CHANNELS["normal"]] = [0, 0, 1]
    for name in ("total", "diffuse"):
        layers[..., CHANNELS[name]] = np.where(disc, 0.6 + 0.4 * x / max(radius, 1), 0)[..., None]
    layers[..., CHANNELS["position"]] = np.stack([x, y, np.zeros_like(x)], axis=2) / size
    eye = np.array([0.0, 0, 1])
    return SceneTruth.of(layers, eye, 1 / size)


def image_of(truth):
    return np.concatenate([truth.layers[name] for name in CHANNELS], axis=2)


def judge(truth, layers):
    return judge_image(SCENE, "cpp", 10.0, truth, layers)


def test_mask_rings_the_disc():
    truth = made_up()
    assert set(np.unique(truth.mask)) == {BACKGROUND, INTERIOR, EDGE}
    row = truth.mask[32]
    edges = np.flatnonzero(row == EDGE)
    # Object 9..55 in this row: the two pixels at each change of object, dilated by one.
    assert edges.tolist() == [7, 8, 9, 10, 54, 55, 56, 57]


def test_equal_images_have_full_marks():
    truth = made_up()
    check = judge(truth, image_of(truth))
    assert check.status == "passed" and check.score == 10 and check.error.value == 0


def test_rounding_passes_and_a_fifth_fails():
    truth = made_up()
    nearly = image_of(truth)
    nearly[..., :3] *= 1 + 2 * LEAST_PICTURE_FLOOR  # one limit for both languages
    assert judge(truth, nearly).status == "passed"
    off = image_of(truth)
    off[..., :3] *= 1.2
    off[..., CHANNELS["diffuse"]] *= 1.2
    check = judge(truth, off)
    assert check.status == "failed" and check.score == 0
    assert "all of the interior pixels are off" in check.message
    assert "diffuse is wrong, ambient and specular are right" in check.message
    assert check.worst.inputs["n"] == [0, 0, 1]


def test_where_half_a_pixel_matters_more_is_allowed():
    truth = made_up()
    off = image_of(truth)
    off[..., :3] *= 1.02
    truth.noise[...] = 0.02
    assert judge(truth, off).status == "passed"


def test_one_nan_costs_half():
    truth = made_up()
    layers = image_of(truth)
    layers[32, 32, 0] = np.nan
    check = judge(truth, layers)
    assert check.status == "failed" and check.score == 5.0
    assert "1 pixels are not finite, the first at (32, 32)" in check.message
    assert check.worst.inputs["pixel"] == [32, 32] and check.worst.actual[0] == "nan"


def test_edges_have_a_loose_cap():
    truth = made_up()
    ys, xs = np.nonzero(truth.mask == EDGE)
    for share, status in ((0.8 * EDGE_CAP, "passed"), (1.3 * EDGE_CAP, "failed")):
        layers = image_of(truth)
        count = int(share * len(ys))
        layers[ys[:count], xs[:count], :3] += 5
        assert judge(truth, layers).status == status


def test_a_scene_without_foreground_is_an_error():
    truth = made_up(radius=0)
    assert judge(truth, image_of(truth)).status == "error"


def test_painting_the_background_is_seen():
    truth = made_up()
    layers = image_of(truth)
    layers[truth.mask == BACKGROUND, :3] = 0.1
    assert judge(truth, layers).status == "failed"


def test_a_scene_of_edges_is_an_error_and_no_pass():
    truth = made_up()
    truth.mask[truth.mask == INTERIOR] = EDGE
    check = judge(truth, image_of(truth))
    assert check.status == "error" and check.score == 0


def judged(function, backend, change):
    rows = make_table(PHONG, function, 1)
    truth = np.abs(renormalised(function, rows)[:, :1])
    table = Table(rows, truth, np.zeros_like(truth), len(rows))
    judgement = judge_function(function, backend, 4.0, table, 0.0, change(truth.copy(), rows))
    return judgement.check, rows, truth


def test_function_limits_differ_by_backend():
    lobe = PHONG.function("phong_lobe")
    for backend, passes in (("cpp", False), ("glsl", True)):
        check, _, _ = judged(lobe, backend, lambda t, rows: t * (1 + 6e-5))
        assert (check.status == "passed") == passes
        assert check.score == (4.0 if passes else 3.0)  # off by little
        assert check.error.limit == function_limit(0.0, backend)


def test_function_messages():
    lobe = PHONG.function("phong_lobe")
    check, _, _ = judged(lobe, "cpp", lambda t, rows: 0 * t)
    assert "yours is always 0" in check.message

    def wrong_below(t, rows):
        below = np.sum(rows[:, 0:3] * rows[:, 3:6], axis=1) <= 0
        t[below] += 1
        return t

    check, rows, truth = judged(lobe, "cpp", wrong_below)
    assert "only where n.l <= 0" in check.message
    n, l = np.array(check.worst.inputs["n"]), np.array(check.worst.inputs["l"])
    assert n @ l <= 0 and check.worst.actual[0] == pytest.approx(check.worst.expected[0] + 1)


def test_not_finite_fails_where_the_truth_is_finite():
    def one_nan(t, rows):
        t[17] = np.nan
        return t

    check, _, _ = judged(PHONG.function("phong_lobe"), "glsl", one_nan)
    assert check.status == "failed" and check.error.value is None and "not finite for 1 of" in check.message


def test_tables():
    lobe = PHONG.function("phong_lobe")
    rows = make_table(PHONG, lobe, 1)
    assert rows.dtype == np.float32
    np.testing.assert_array_equal(rows, make_table(PHONG, lobe, 1))
    assert not np.array_equal(rows, make_table(PHONG, lobe, 2))
    n, l, v, q = rows[:, 0:3].astype(float), rows[:, 3:6].astype(float), rows[:, 6:9].astype(float), rows[:, 9]
    for directions in (n, l, v):
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=3e-7)
    assert 0.9 <= q.min() and q.max() <= 512 and (q < 1).mean() < 0.01  # some stand beside the edge case q = 1
    cosine = np.sum(n * l, axis=1)
    off_gate = cosine[cosine != 0]
    assert np.abs(off_gate).min() > 0.5 * NEAREST_HORIZON
    assert (np.abs(off_gate) < 1e-3).mean() > 0.05 and (cosine == 0).sum() >= 30 and (cosine < -0.01).mean() > 0.02
    mirror = 2 * cosine[:, None] * n - l
    assert (np.linalg.norm(v - mirror, axis=1) < 2 / np.sqrt(q)).mean() > 0.1  # the lobe is seen


def test_truth_renormalises_directions():
    lobe = PHONG.function("phong_lobe")
    rows = make_table(PHONG, lobe, 1)
    out = renormalised(lobe, rows)
    np.testing.assert_allclose(np.linalg.norm(out[:, 3:6], axis=1), 1, atol=4e-16)
    np.testing.assert_array_equal(out[:, 9], rows[:, 9])
