"""What functions and hidden scenes are judged on: rows near where things change, exact rows on the gates, drawn scenes."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment, named_arrays
from shadelab.course.hidden import Family, Hidden, Variation, draw_hidden_scenes, hidden_scene_files
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.truth.function_tables import FRAGMENTS
from shadelab.truth.making import load
from shadelab.truth.tables import ROWS, jittered, make_table, on_gate, renormalised

PHONG = load_assignment(ROOT / "solution" / "phong")
REAL = {"range": [0.0, 1.0], "typical": [0.1, 0.9]}


def table_of(**declared):
    """A function that is declared as those of an assignment are."""
    with tempfile.TemporaryDirectory() as folder:
        function = {"name": "made_up", "summary": "made up", "returns": "Real", **declared}
        manifest = {"name": "made-up", "title": "Made up", "files": ["shading.cpp"], "function": [function]}
        (Path(folder) / "assignment.toml").write_text(tomli_w.dumps(manifest))
        assignment = load_assignment(Path(folder))
    function = assignment.function("made_up")
    rows = make_table(assignment, function, 1)
    return function, rows, named_arrays(function.inputs, rows)


def test_directions_near_the_opposite_of_an_axis():
    _, _, drawn = table_of(arguments=[{"axis": "unit"}, {"to_light": "upper(-axis)"}])
    angle = np.arccos(np.clip(-np.sum(drawn["axis"] * drawn["to_light"], axis=1), -1, 1))
    assert ((angle > 0.01) & (angle < 0.3)).mean() > 0.05  # a uniform direction is there once in forty times
    assert 0.02 < (angle > np.pi / 2).mean() < 0.2


def test_gates_hold_their_constants_and_copies():
    arguments = [{"a": REAL}, {"b": REAL}, {"c": "rgb"}]
    function, rows, drawn = table_of(arguments=arguments, gates=[{"a": 0.25, "b": "a"}, {"c": [1, 0, 1]}])
    gate = on_gate(function, len(rows), len(rows) + 100)  # a hundred from scenes: none of them is on a gate by design
    assert not gate[len(rows) :].any()
    gate = gate[: len(rows)]
    assert gate.sum() == len(rows) // 8
    first, second = slice(0, None, 16), slice(1, None, 16)
    assert (drawn["a"][first] == 0.25).all() and (drawn["b"][first] == 0.25).all()
    assert (drawn["c"][second] == [1, 0, 1]).all()
    assert len(np.unique(drawn["a"][~gate])) > 3000


def test_a_gate_that_names_no_column_is_one_clear_line(tmp_path):
    text = (PHONG.directory / "assignment.toml").read_text()
    (tmp_path / "phong").mkdir()
    (tmp_path / "lights").symlink_to(PHONG.directory.parent / "lights")
    changed = text.replace('name = "half_vector"', 'name = "half_vector"\ngates = [{ m = 1 }]')
    (tmp_path / "phong" / "assignment.toml").write_text(changed)
    with pytest.raises(UserError, match=r"assignment.toml:\d+: function\[\d\].gates: m is no column; there is l, v"):
        load_assignment(tmp_path / "phong")


def test_rounding_leaves_the_horizon_alone():
    lobe = PHONG.function("phong_lobe")
    exact = renormalised(lobe, make_table(PHONG, lobe, 1))
    for near in jittered(lobe, exact):
        assert not np.array_equal(near, exact)
        assert np.allclose(near, exact, rtol=2.0**-23, atol=0)
        assert (np.sum(near[-216:, 0:3] * near[-216:, 3:6], axis=1)[np.sum(exact[-216:, 0:3] * exact[-216:, 3:6], axis=1) == 0] == 0).all()  # fmt: skip


def test_rounding_of_inputs_moves_little_where_nothing_is_divided_by_little():
    table = load(PHONG).table(PHONG.function("half_vector"))
    assert 0 < np.median(table.conditioning) < 1e-7


@pytest.mark.parametrize("name", assignment_names())
def test_tables_also_hold_what_scenes_ask(name):
    """Every model and incident_light is judged by fragments, too, and so is what they call: with each lamp's own numbers."""
    assignment = load_assignment(ROOT / "solution" / name)
    expected = load(assignment)
    recorded = {f.name: expected.table(f).rows[expected.table(f).drawn :] for f in assignment.functions}
    assert all(expected.table(f).drawn == ROWS for f in assignment.functions)
    assert all(len(rows) <= FRAGMENTS for rows in recorded.values())
    callees = {c for f, called in expected.facts.calls.items() if len(recorded[f]) for c in called}
    without = {f for f, rows in recorded.items() if not len(rows)}
    assert not without & callees
    assert sum(f.graded and f.name in without for f in assignment.functions) <= 1, without
    for function in assignment.functions:
        columns = named_arrays(function.inputs, recorded[function.name])
        for value in function.values:
            if value.domain.kind in ("unit", "upper") and len(recorded[function.name]):
                np.testing.assert_allclose(np.linalg.norm(columns[value.name], axis=1), 1, atol=1e-5)


# ------------------------------------------------------------------------------------------------- hidden scenes


def family(**changes):
    vary = [
        {"key": "light[0].position", "low": [1, 1, 1], "high": [2, 3, 4]},
        {"key": "material.metal.q", "low": 4, "high": 400, "scale": "log"},
    ]
    declared = {"name": "made-up", "base": "../../scenes/phong/knot.toml", "points": 4, "vary": vary, **changes}
    return Family.model_validate(declared)


def drawn(seed, *families):
    declared = Hidden(seed=seed, family=families)
    draw_hidden_scenes(declared, PHONG.directory, "phong")
    return [read_toml(file) for file, *_ in hidden_scene_files(declared, PHONG.directory, "phong")]


def test_hidden_scenes_differ_from_their_base_only_where_declared():
    [scene] = drawn("a", family())
    base = read_toml(ROOT / "scenes" / "phong" / "knot.toml")
    position, q = scene["light"][0].pop("position"), scene["material"]["metal"].pop("q")
    assert all(low <= x <= high for x, low, high in zip(position, [1, 1, 1], [2, 3, 4])) and 4 <= q <= 400
    base["light"][0].pop("position"), base["material"]["metal"].pop("q")
    assert scene.pop("object")[0]["mesh"].endswith("scenes/meshes/knot.obj") and base.pop("object")
    assert scene == base


def test_hidden_scenes_follow_from_the_seed():
    assert drawn("a", family(scenes=2)) == drawn("a", family(scenes=2))
    one, two = drawn("a", family(scenes=2))
    assert one != two
    assert drawn("b", family())[0] != one


def test_what_cannot_be_varied_is_one_clear_line():
    for key, value in (("light[7].position", [0, 0, 0]), ("material.metal.shine", 1), ("camera", 1)):
        with pytest.raises(UserError, match=r"hidden.toml: made-up: "):
            drawn("a", family(vary=[Variation(key=key, low=value, high=value)]))
