"""What a program has right in double is no mistake of the function, in either language; and what excuses nothing. Numbers that
change when they are asked again."""

import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment
from shadelab.course.mistakes import with_bodies
from shadelab.grading.grade import grade

PHONG = load_assignment(ROOT / "solution" / "phong")
# n.h of a sum of cosines: where l comes close to -v both are noise in float.
NOISY = """
if (dot(n, l) <= 0.0) return 0.0;
Real c = (dot(n, l) + dot(n, v)) / max(length(l + v), 1e-30);
return c > 0.0 ? pow(c, q) : q > 0.0 ? 0.0 : 1.0;
"""
RIGHT = "Real c = dot(v, mirror_direction(l, n));\nif (dot(n, l) <= 0.0) return 0.0;\nreturn c > 0.0 ? pow(c, q) : 0.0;"


def checked(folder, function, **bodies):
    """The check of one function, by language."""
    for backend in bodies:
        source = PHONG.directory / f"shading.{backend}"
        (folder / source.name).write_text(with_bodies(source.read_text(), source, {function: bodies[backend]}))
    only = {f"{backend}/function/{function}" for backend in bodies}
    checks = grade(PHONG, folder, only=only, pictures=False).result.checks
    return {check.backend: check for check in checks if check.kind == "function"}


def test_digits_that_an_algebra_loses_are_no_mistake(tmp_path):
    for check in checked(tmp_path, "blinn_lobe", cpp=NOISY, glsl=NOISY).values():
        assert check.status == "passed" and check.score == check.max_score, check
        assert "of the inputs are right in double arithmetic only" in check.message or check.message == ""
    assert "in double arithmetic only" in checked(tmp_path, "blinn_lobe", cpp=NOISY)["cpp"].message


def test_a_wrong_formula_is_wrong_in_double_too(tmp_path):
    small = NOISY.replace("1e-30);", "1e-30);\nif (q > 505.0) c = 0.999 * c;")
    for check in checked(tmp_path, "blinn_lobe", cpp=small, glsl=small).values():
        assert check.status == "failed" and check.score < check.max_score


@pytest.mark.parametrize(
    "garbage",
    [
        "if (sizeof(Real) == 4 && q < 4.0) return 0.5;",  # a tenth of the inputs
        "if (q > 510.0) return (q - q) / (q - q);",  # not finite
        "if (sizeof(Real) == 4 && dot(n, l) == 0.0) return 0.5;",  # on exact inputs there is no rounding
    ],
)
def test_what_double_does_not_excuse(garbage, tmp_path):
    check = checked(tmp_path, "phong_lobe", cpp=f"{garbage}\n{RIGHT}")["cpp"]
    assert check.status == "failed" and check.score < check.max_score, check.message


def test_a_state_between_calls_is_seen(tmp_path):
    counted = "static int calls = 0;\nif (++calls > 4500) return 0.5;"
    check = checked(tmp_path, "phong_lobe", cpp=f"{counted}\n{RIGHT}")["cpp"]
    assert check.status == "failed" and "when it is asked again in another order" in check.message
