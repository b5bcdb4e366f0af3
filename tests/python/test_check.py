"""check must notice when the grader misses something, in both directions."""

import pytest

from conftest import ROOT
from shadelab.check import _judge, involved
from shadelab.errors import UserError
from shadelab.grade import grade
from shadelab.manifest import load_assignment
from shadelab.mistakes import Change, callers, load_changes, regions, with_bodies, write_submission

PHONG = load_assignment(ROOT / "solution" / "phong")


def row_for(tmp_path, kind, function, body):
    change = Change(id="made-up", function=function, hint="-", body=body)
    write_submission(PHONG, change, tmp_path / "made-up")
    return _judge(PHONG, "made-up", kind, change, grade(PHONG, tmp_path / "made-up", only="cpp/function/*").result)


def test_a_mistake_that_changes_nothing_is_missed(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return reflect(-l, n);")
    assert "cpp/function/mirror_direction does not see it" in row.faults


def test_a_variant_that_is_wrong_is_reported(tmp_path):
    row = row_for(tmp_path, "variant", "mirror_direction", "return reflect(l, n);")
    assert any("costs a correct variant" in fault for fault in row.faults)


def test_a_mistake_that_does_not_compile_is_reported(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return nonsense;")
    assert any("does not build" in fault for fault in row.faults)


def test_who_is_involved():
    assert callers(PHONG, {"half_vector"}) == {"half_vector", "blinn_lobe", "blinn_phong"}
    checks = involved(PHONG, {"half_vector"})
    assert "cpp/function/blinn_phong" in checks and "glsl/image/knot" in checks
    assert "cpp/function/phong" not in checks and "cpp/image/sphere" not in checks


def test_declarations():
    changes = load_changes(PHONG)
    assert len(changes.mistake) >= 5 and len(changes.variant) >= 2
    for language in ("cpp", "glsl"):
        source = PHONG.directory / f"shading.{language}"
        assert set(regions(source.read_text(), source)) == {f.name for f in PHONG.functions}
        solution = source.read_text()
        for change in [*changes.mistake, *changes.variant]:
            assert with_bodies(solution, source, change.bodies_for(language)) != solution


def test_unknown_function_is_one_clear_line():
    source = PHONG.directory / "shading.cpp"
    with pytest.raises(UserError, match="nothing has no STUDENT BEGIN"):
        with_bodies(source.read_text(), source, {"nothing": ""})
