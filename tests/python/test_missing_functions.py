"""A function that a submission lacks costs only what needs it, and the checks say so."""

import re

import pytest

from shadelab.course.assignment import load_assignment
from shadelab.grading.grade import grade
from shadelab.paths import SOLUTION
from shadelab.words import BACKENDS


def without(name, function, folder, only="*"):
    """The solution without one of its functions; the checks by id."""
    assignment = load_assignment(SOLUTION / name)
    for backend in BACKENDS:
        text = (assignment.directory / f"shading.{backend}").read_text()
        text, count = re.subn(rf"^\w+ {function}\([^;{{]*\) \{{.*?^\}}\n", "", text, flags=re.MULTILINE | re.DOTALL)
        assert count == 1
        (folder / f"shading.{backend}").write_text(text)
    return {check.id: check for check in grade(assignment, folder, only=only, pictures=False).result.checks}


def test_without_the_worked_example_everything_else_is_graded(tmp_path):
    checks = without("phong", "retro_lobe", tmp_path)
    asked = {id: check for id, check in checks.items() if check.status != "passed"}
    assert asked == {}, "no scene needs it"
    assert (
        "retro_lobe is missing; declare it as Real retro_lobe("
        in checks["cpp/build"].message + checks["cpp/build"].printed
    )


def test_without_a_graded_function_what_calls_it_says_so(tmp_path):
    checks = without("phong", "half_vector", tmp_path, ["*/build", "*/function/*", "*/image/sphere", "*/image/grazing"])
    for backend in BACKENDS:
        assert checks[f"{backend}/build"].status == "passed"
        for function in ("mirror_direction", "phong_lobe", "phong"):
            assert checks[f"{backend}/function/{function}"].status == "passed"
        for function in ("half_vector", "blinn_lobe", "blinn_phong"):
            check = checks[f"{backend}/function/{function}"]
            assert (check.status, check.score) == ("failed", 0.0)
            assert "half_vector is missing" in check.message, check.message
            assert "declare it as vec3 half_vector(vec3 l, vec3 v)" in check.message
        drawn = {name: checks[f"{backend}/image/{name}"] for name in ("sphere", "grazing")}
        assert drawn["sphere"].status == "passed" and "half_vector is missing" in drawn["grazing"].message


@pytest.mark.parametrize("spelt", ["half_Vector", "halfvector"])
def test_another_spelling_is_pointed_at(spelt, tmp_path):
    assignment = load_assignment(SOLUTION / "phong")
    for backend in BACKENDS:
        text = (assignment.directory / f"shading.{backend}").read_text()
        (tmp_path / f"shading.{backend}").write_text(text.replace("vec3 half_vector(", f"vec3 {spelt}("))
    result = grade(assignment, tmp_path, only="*/function/half_vector", pictures=False).result
    said = {check.id: check.message for check in result.checks}
    for backend in BACKENDS:
        assert f"{spelt} in line" in said[f"{backend}/function/half_vector"], said


def test_a_file_of_something_else_is_refused_as_a_whole(tmp_path):
    (tmp_path / "shading.cpp").write_text("#include <shadelab/shading.hpp>\nReal other(Real x) { return x; }\n")
    (tmp_path / "shading.glsl").write_text("float other(float x) { return x; }\n")
    result = grade(load_assignment(SOLUTION / "phong"), tmp_path, only="cpp/*", pictures=False).result
    assert result.checks[0].status == "failed" and "is missing" in result.checks[0].message
    assert result.score == 0
