"""Custom checks: instructors' pytest functions, run by the grader and by pytest alike."""

import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment
from shadelab.errors import UserError
from shadelab.grading import session
from shadelab.grading.grade import grade as run_grade
from shadelab.grading.planning import plan_checks

LIGHTS = ROOT / "solution" / "lights"
BOTH = ["cpp/custom/linearity", "glsl/custom/linearity"]
IRRADIANCE = "return light.e * max(dot(n, light.l), 0.0);"


@pytest.fixture
def with_checks(tmp_path):
    """A checkout of which nothing differs but the checks of lights."""

    def make(code):
        root = tmp_path / "checkout"
        shutil.copytree(ROOT / "solution", root / "solution", ignore=shutil.ignore_patterns("checks", "__pycache__"))
        for name in (".shadelab", "build", "framework", "scenes", "CMakeLists.txt"):
            (root / name).symlink_to(ROOT / name)
        (root / "solution" / "lights" / "checks").mkdir()
        (root / "solution" / "lights" / "checks" / "test_made_up.py").write_text("import pytest\n\n" + code)
        return root

    return make


@pytest.fixture
def custom(with_checks):
    """Grades a submission of lights by the given checks alone; the checks by their names."""

    def run(code, submission=LIGHTS, backend="cpp"):
        assignment = load_assignment(with_checks(code) / "solution" / "lights")
        result = run_grade(assignment, submission, only=f"{backend}/custom/*").result
        return {c.id.split("/")[-1]: c for c in result.checks if c.kind == "custom"}

    return run


# ------------------------------------------------------------------------------------------------------- linearity


def test_ids_and_points_are_known_beforehand():
    assignment = load_assignment(LIGHTS)
    assert [tuple(c) for c in assignment.custom] == [("linearity", 2.0)]
    assert assignment.points == 100
    plans = plan_checks(assignment)
    for backend in ("cpp", "glsl"):
        ids = [p.id for p in plans[backend]]
        assert ids[-1] == f"{backend}/custom/linearity"  # behind the images
        assert plans[backend][-1].points == 1
    assert [p.id for p in plan_checks(assignment, "glsl/custom/*")["glsl"]] == ["glsl/build", "glsl/custom/linearity"]


def test_the_solution_is_linear(grade):
    """By pictures that the grading has drawn; test_fixtures has them drawn by the check itself."""
    result = grade(LIGHTS, only="*/*/linearity*", assignment="lights")
    for id in BOTH:
        check = result["by_id"][id]
        assert check["status"] == "passed" and check["score"] == check["max_score"] == 1
        assert check["kind"] == "custom" and check["needs"] == [id.split("/")[0] + "/build"]


def test_a_relative_out_folder_does(shadelab, tmp_path):
    """As the command's default is: a check runs in a folder of its own, and finds the pictures all the same."""
    done = shadelab("grade", LIGHTS, "--only", "cpp/*/linearity*", "--out", "some/where", "--json", "-")
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    assert {c["status"] for c in result["checks"]} == {"passed"} and result["score"] == result["max_score"]
    assert any((tmp_path / "some/where/evidence").rglob("linearity-*.npy"))


def test_the_starter_is_not(grade):
    result = grade(ROOT / "starter" / "lights", only="*/custom/*", assignment="lights")
    for id in BOTH:
        assert result["by_id"][id]["status"] == "failed" and result["by_id"][id]["score"] == 0


def test_what_is_not_linear_fails_with_its_numbers(grade, submission):
    change = {IRRADIANCE: IRRADIANCE.replace("light.e *", "min(light.e, vec3(3.0)) *")}
    result = grade(submission("lights", cpp=change, glsl=change), only="*/custom/*", assignment="lights")
    for id in BOTH:
        check = result["by_id"][id]
        assert check["status"] == "failed" and check["score"] == 0 and check["max_score"] == 1
        assert check["message"].startswith("irradiance: with light.e = (")
        assert "/" not in check["message"] and "assert" not in check["message"] and len(check["message"]) < 400


def test_a_picture_that_does_not_add_up_fails(grade, submission):
    """Code that remembers what it did: each call by itself is right, three calls are not."""
    change = {
        "return kd * e;": "static std::atomic<int> calls{0};\n    return ++calls > 20000 ? 0.5 * kd * e : kd * e;",
        "#include <shadelab/shading.hpp>\n": "#include <atomic>\n#include <shadelab/shading.hpp>\n",
    }
    check = grade(submission("lights", cpp=change), only="cpp/custom/*", assignment="lights")["by_id"][BOTH[0]]
    assert check["status"] == "failed"
    assert "linearity-both is not the sum of linearity-left and linearity-right: at pixel (" in check["message"]


def test_without_a_build_it_is_skipped(grade, submission):
    change = {IRRADIANCE: "return nonsense;"}
    result = grade(submission("lights", cpp=change), only="cpp/custom/*", assignment="lights")
    check = result["by_id"][BOTH[0]]
    assert check["status"] == "skipped" and check["score"] == 0 and check["needs"] == ["cpp/build"]


# --------------------------------------------------------------------------------------------- students' code in it


@pytest.mark.parametrize(
    "code, words",
    [
        ("std::_Exit(0);", "without giving its results"),
        (
            'std::cout << "{\\"check\\": \\"linearity\\", \\"status\\": \\"passed\\"}\\n"; std::exit(0);',
            "without giving",
        ),
        ("raise(SIGKILL);", "SIGKILL"),
    ],
    ids=["exit", "prints", "kills-itself"],
)
def test_code_that_misbehaves_fails_and_does_no_harm(grade, submission, code, words):
    includes = "#include <csignal>\n#include <cstdlib>\n#include <iostream>\n#include <shadelab/shading.hpp>\n"
    change = {IRRADIANCE: f"{code}\n    {IRRADIANCE}", "#include <shadelab/shading.hpp>\n": includes}
    check = grade(submission("lights", cpp=change), only="cpp/custom/*", assignment="lights")["by_id"][BOTH[0]]
    assert check["status"] == "failed" and check["score"] == 0
    assert check["message"].startswith("irradiance ") and words in check["message"]
    assert ("passed" in check["printed"]) == ("cout" in code)


def test_what_hung_in_its_own_check_is_not_asked_again(grade, submission):
    change = {IRRADIANCE: f"while (true);\n    {IRRADIANCE}"}
    only = "cpp/[fc]*/[il][ri][rn]*"  # irradiance and linearity
    result = grade(submission("lights", cpp=change), only=only, assignment="lights")
    check = result["by_id"][BOTH[0]]
    assert check["status"] == "skipped" and check["needs"] == ["cpp/build", "cpp/function/irradiance"]
    assert check["message"] == "irradiance did not end in its own check"


# ------------------------------------------------------------------------------------------------- checks by themselves


def test_what_students_read(custom):
    """An assert's words, or else what it asks; never a traceback or a path."""
    checks = custom(
        """
import numpy as np

def test_says(evaluate):
    assert False, f"0.5 is too much in {np.__file__}"

def test_asks():
    value = np.float64(0.25)
    assert value < 0.125

def test_compares():
    np.testing.assert_allclose([1.0, 2.0], [1.0, 3.0])

def test_calls():
    pytest.fail("not like this")

def test_waits():
    pytest.skip("for better times")
"""
    )
    assert {n: c.status for n, c in checks.items()} == dict.fromkeys(
        ("says", "asks", "compares", "calls"), "failed"
    ) | {"waits": "skipped"}
    assert checks["says"].message == "0.5 is too much in __init__.py"
    assert checks["asks"].message == "does not hold: value < 0.125 (0.25 < 0.125)"
    assert "Mismatched elements: 1 / 2" in checks["compares"].message
    assert checks["calls"].message == "not like this" and checks["waits"].message == "for better times"
    assert all(c.max_score == 0 for c in checks.values())  # none declares points


def test_fixtures(custom):
    checks = custom(
        """
import numpy as np

@pytest.mark.points(0.5)
def test_all(evaluate, render, expected, scene, backend):
    e = evaluate("diffuse", {"kd": np.full((2, 3), 0.5), "e": np.array([[1, 2, 3], [4, 5, 6]])})
    assert e.dtype == np.float32 and np.allclose(e, [[0.5, 1, 1.5], [2, 2.5, 3]])
    assert np.array_equal(evaluate("diffuse", np.full((1, 6), 2.0)), [[4, 4, 4]])
    incident = evaluate("incident_light", expected.inputs("incident_light"))
    assert set(incident) == {"l", "e"} == set(expected.outputs("incident_light"))
    picture = render("linearity-left")
    assert np.allclose(picture, expected.image("linearity-left"), atol=1e-2)
    assert np.array_equal(render("linearity-left", layer="diffuse"), picture)
    brighter = scene("linearity-left")
    brighter["light"][0]["intensity"] = [2 * i for i in brighter["light"][0]["intensity"]]
    assert np.allclose(render(brighter), 2 * picture, rtol=1e-5) and picture.max() > 0
    assert backend in ("cpp", "glsl")
""",
        backend="*",
    )
    assert checks["all"].status == "passed", checks["all"].message
    assert checks["all"].max_score == 0.25


def test_a_fault_of_the_check_is_ours(custom):
    checks = custom(
        """
import os

@pytest.mark.points(1)
def test_divides():
    return 1 / 0

def test_asks_for_what_is_not_there(evaluate):
    evaluate("no_such_function", {})

def test_draws_what_is_not_there(render, scene):
    wrong = scene("cosine")
    wrong["film"]["width"] = -1
    render(wrong)

@pytest.mark.points(1)
def test_ends_pytest():
    os._exit(0)

@pytest.mark.points(1)
def test_goes_on():
    pass
"""
    )
    assert {c.status for n, c in checks.items() if n != "goes_on"} == {"error"}
    assert checks["goes_on"].status == "passed" and checks["goes_on"].score == 0.5
    message = checks["divides"].message
    assert message == "not the submission's fault: test_made_up.py:8: ZeroDivisionError: division by zero"
    assert "no_such_function: lights has no such function" in checks["asks_for_what_is_not_there"].message
    assert "width" in checks["draws_what_is_not_there"].message
    assert "ended pytest (exit code 0)" in checks["ends_pytest"].message


def test_a_check_that_hangs_is_ended(custom, monkeypatch):
    monkeypatch.setattr(session, "LIMIT", 4.0)
    checks = custom("def test_hangs():\n    while True:\n        pass\n\n\ndef test_goes_on():\n    pass\n")
    assert checks["hangs"].status == "error" and "did not end within 4 s" in checks["hangs"].message
    assert checks["goes_on"].status == "passed"


def test_a_file_that_cannot_be_loaded_is_ours(custom):
    checks = custom("import no_such_module\n\n\ndef test_never():\n    pass\n")
    assert checks["never"].status == "error" and "no_such_module" in checks["never"].message


@pytest.mark.slow  # a root of its own makes its expected data
def test_an_error_is_exit_code_3(with_checks, shadelab):
    root = with_checks("def test_divides():\n    1 / 0\n")
    arguments = ["grade", LIGHTS, "--only", "cpp/custom/*", "--json", "-"]
    done = shadelab(*arguments, SHADELAB_ROOT=str(root))
    assert done.code == 3
    assert [c["status"] for c in json.loads(done.stdout)["checks"]] == ["passed", "error"]


@pytest.mark.parametrize(
    "code, words",
    [
        ("@pytest.mark.points()\ndef test_a(): ...", "test_made_up.py:3: test_a: points takes a number"),
        ("@pytest.mark.points(x)\ndef test_a(): ...", "points takes a number"),
        ("@pytest.mark.parametrize('x', [1])\ndef test_a(x): ...", "loop inside of it instead of parametrize"),
        ("def test_a(): ...\n\ndef test_a(): ...", "two functions are called test_a"),
        ("def test_a(:", "test_made_up.py:3: "),
    ],
)
def test_a_wrong_declaration_is_one_line(with_checks, code, words):
    assignment = load_assignment(with_checks(code) / "solution" / "lights")
    with pytest.raises(UserError, match="checks") as error:
        assignment.points  # noqa: B018
    assert words in str(error.value) and "\n" not in str(error.value)


# ---------------------------------------------------------------------------------------------------- pytest directly


def run_pytest(tmp_path, *arguments):
    command = [sys.executable, "-I", "-B", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "shadelab.custom"]
    command += ["--junit-xml", tmp_path / "junit.xml", *arguments]
    done = subprocess.run(list(map(str, command)), cwd=ROOT, capture_output=True, text=True, env=dict(os.environ))
    cases = ElementTree.parse(tmp_path / "junit.xml").iter("testcase")
    return done, {case.get("name"): case for case in cases}


def test_pytest_lists_what_grade_checks(tmp_path):
    done, _ = run_pytest(tmp_path, LIGHTS, "--collect-only")
    plans = [p.id for plans in plan_checks(load_assignment(LIGHTS)).values() for p in plans]
    assert [line.split("::")[1] for line in done.stdout.splitlines() if "::" in line] == plans


@pytest.mark.slow
def test_pytest_and_grade_agree(tmp_path, grade, submission):
    """The same ids, statuses and points."""
    folder = submission("lights", cpp={IRRADIANCE: "return light.e;"}, glsl={IRRADIANCE: "return nonsense;"})
    done, cases = run_pytest(tmp_path, LIGHTS, "--submission", folder)
    assert done.returncode == 1, done.stdout
    result = grade(folder, assignment="lights")
    assert set(cases) == set(result["by_id"])
    kinds = {"passed": None, "failed": "failure", "skipped": "skipped"}
    for id, check in result["by_id"].items():
        tags = {child.tag for child in cases[id]} - {"properties"}
        assert tags == ({kinds[check["status"]]} - {None}), id
        points = {p.get("name"): float(p.get("value")) for p in cases[id].iter("property")}
        assert points == {"score": check["score"], "max_score": check["max_score"]}
    assert f"lights: {result['score']:.10g} of {result['max_score']:.10g} points" in done.stdout
    assert "Traceback" not in done.stdout and ".py:" not in done.stdout
