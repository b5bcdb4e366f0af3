"""Stability: the solutions are stable in both languages; the textbook forms are not, exactly where the page says."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from conftest import ROOT
from shadelab.cli.app import program
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.mistakes import slide_formulas, write_submission
from shadelab.course.stability import Reciprocal, load_stability
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.grading.grade import grade
from shadelab.grading.planning import plan_checks
from shadelab.inspect import stability
from shadelab.judge.stability import FLOORS, judge
from shadelab.truth import extremes
from shadelab.truth.extremes import StableTable
from shadelab.truth.making import load

ASSIGNMENTS = [load_assignment(ROOT / "solution" / name) for name in assignment_names()]
PHONG = next(a for a in ASSIGNMENTS if a.name == "phong")
every_assignment = pytest.mark.parametrize("assignment", ASSIGNMENTS, ids=lambda a: a.name)


def quiet(*_):
    pass


# ----------------------------------------------------------------------------------------------------- submissions


@every_assignment
def test_the_solution_is_stable_in_both_languages(assignment):
    report = stability.measure(assignment, assignment.directory, quiet)
    assert [line.function.name for line in report.lines] == [f.name for f in assignment.functions]
    for line in report.lines:
        assert set(line.found) == {"cpp", "double", "glsl"}, line.failures
        for series, found in line.found.items():
            assert not found.faults, f"{line.function.name}, {series}: {stability.describe(found)}"
            assert found.worst <= FLOORS
        assert np.isfinite(line.found["cpp"].table.truth).any(axis=1).mean() > 0.9  # something is asked of most rows
    assert report.stable and not report.notes


# Function -> the cases in which the slide's form fails, at least; those without points fail because of what they call.
SLIDES_FAIL = {
    "lights": {
        "spot_attenuation": {"a cone of a hundredth of a degree", "a cone of a tenth of a degree"},
        "incident_light": {"r = 1e20", "no light of one colour, close by"},
    },
    "phong": {"phong_lobe": {"q = 1e6", "q = 1e4"}, "blinn_lobe": {"q = 1e6", "q = 1e4"}},
    "microfacet": {
        "fresnel_conductor": {"nearly transparent", "a perfect conductor"},
        "beckmann": {"m = 1e-4", "m = 1e-2", "h close to the horizon"},
        "geometry_term": {"l nearly -v"},
    },
}


@every_assignment
def test_the_slides_formulas_lose_the_points_for_stability_and_no_others(assignment, tmp_path):
    wanted = SLIDES_FAIL[assignment.name]
    write_submission(assignment, slide_formulas(assignment), tmp_path)
    # That no picture loses anything either is what `check` asks of every variant.
    only = {p.id for plans in plan_checks(assignment).values() for p in plans if p.kind in ("function", "stability")}
    result = grade(assignment, tmp_path, only=only, pictures=False).result
    failed = {c.id: c for c in result.checks if c.status == "failed"}
    assert set(failed) == {f"{backend}/stability/{name}" for backend in ("cpp", "glsl") for name in wanted}
    assert not [c.id for c in result.checks if c.status not in ("passed", "failed") and c.kind != "parity"]
    for check in failed.values():
        name = check.id.split("/")[-1]
        assert check.mistake.hint == assignment.stability[name].idea  # the better form
        assert check.score < check.max_score and check.worst.inputs
        assert ("right in double" in check.message) == (check.backend == "cpp")
    report = stability.measure(assignment, tmp_path, quiet)
    for line in report.lines:
        if line.function.name in wanted:
            for series in ("cpp", "glsl"):
                assert wanted[line.function.name] <= set(line.found[series].labels()), (line.function.name, series)
            assert not line.found["double"].faults  # bad algebra, and no wrong formula


def test_points_are_at_most_a_tenth():
    for assignment in ASSIGNMENTS:
        points = sum(s.points for s in assignment.stability.values())
        assert 0 < points <= 0.1 * assignment.points
        assert set(SLIDES_FAIL[assignment.name]) == {s.name for s in assignment.stability.values() if s.points}


def test_a_wrong_function_is_not_asked_for_stability(tmp_path):
    wrong = (PHONG.directory / "shading.cpp").read_text().replace("return normalize(sum);", "return sum;")
    (tmp_path / "shading.cpp").write_text(wrong)
    (tmp_path / "shading.glsl").write_text((PHONG.directory / "shading.glsl").read_text())
    only = {
        f"cpp/{kind}/{name}"
        for kind in ("function", "stability")
        for name in ("half_vector", "blinn_lobe", "phong_lobe")
    }
    checks = {c.id: c for c in grade(PHONG, tmp_path, only=only, pictures=False).result.checks}
    skipped = checks["cpp/stability/blinn_lobe"]
    assert skipped.status == "skipped" and "cpp/function/half_vector" in skipped.needs
    assert checks["cpp/stability/phong_lobe"].status == "passed"


# ------------------------------------------------------------------------------------------------------- the verdict


def table(truth, rising=(), swapped=(), rows=None):
    truth = np.array(truth, float).reshape(-1, 1)
    rows = np.zeros((len(truth), 8), np.float32) if rows is None else rows
    pairs = [np.array(p, int).reshape(-1, 2) for p in (rising, swapped)]
    return StableTable(rows, np.zeros(len(truth), int), *pairs, truth, np.full(truth.shape, 1e-3), ["made up"])


def verdict(made, actual, driver=0.0, reciprocal=None):
    lobe = PHONG.function("blinn_lobe")
    out = judge(lobe.inputs, lobe.outputs, made, np.array(actual)[:, None], driver, reciprocal)
    return [(fault.row, fault.kind) for fault in out.faults]


def test_what_is_not_finite_is_wrong_where_the_truth_is_finite():
    assert verdict(table([1.0, 1.0, 1.0]), [1.0, np.nan, np.inf]) == [(1, "not finite"), (2, "not finite")]


def test_an_overflow_may_be_infinite_and_must_not_be_nan():
    assert verdict(table([1e60, 1e60, np.nan]), [np.inf, np.nan, np.nan]) == [(1, "not finite")]


def test_errors_are_counted_in_floors():
    assert verdict(table([1.0, 1.0]), [1 + 3.9e-3, 1 + 4.1e-3]) == [(1, "inaccurate")]
    # The driver's own functions are excused: here by 1 % of the value, four times.
    assert verdict(table([1.0, 1.0]), [1 + 4.3e-2, 1 + 4.5e-2], driver=1e-2) == [(1, "inaccurate")]


def test_the_sign_counts_beyond_the_floor():
    assert verdict(table([1e-3, 1e-9]), [-1.5e-3, -1e-4]) == [(0, "wrong sign")]


def test_what_falls_where_the_truth_rises_is_not_monotone():
    rising = [(0, 1), (1, 2)]
    assert verdict(table([1.0, 1.001, 1.002], rising), [1.002, 0.9985, 1.0]) == [(1, "not monotone")]
    assert verdict(table([1.0, 1.001, 1.002], rising), [1.001, 1.0, 1.001]) == []  # within the floor


def test_what_is_promised_to_be_reciprocal_is_asked_where_the_truth_is():
    promise = Reciprocal(swap=("l", "v"))
    assert verdict(table([1.0, 1.0], swapped=[(0, 1)]), [1.0, 1.0], reciprocal=promise) == []
    off = [1 - 1.5e-3, 1 + 1.5e-3]  # each within its own limit
    assert verdict(table([1.0, 1.0], swapped=[(0, 1)]), off) == []
    assert verdict(table([1.0, 1.0], swapped=[(0, 1)]), off, reciprocal=promise) == [(1, "not reciprocal")]
    assert verdict(table([1.0, 2.0], swapped=[(0, 1)]), [1.0, 2.0], reciprocal=promise) == []  # nor is the truth
    # With a weight of 1/2 and 1 the two are asked to be 2 : 1.
    rows = np.zeros((2, 10), np.float32)
    rows[:, 2] = 1.0  # n
    rows[0, 5], rows[1, 5] = 0.5, 1.0  # l
    weighted = table([0.5, 1.0], swapped=[(0, 1)], rows=rows)
    per = Reciprocal(swap=("l", "v"), per="n.l")
    assert verdict(weighted, [0.5, 1.0], reciprocal=per) == []


@every_assignment
def test_tables_reach_the_ends_of_the_domains(assignment):
    expected = load(assignment)
    for function in assignment.functions:
        made = expected.stable_table(function)
        for k, column in enumerate(function.inputs):
            if column.domain.kind == "range" and column.domain.type != "int" and column.domain.range:
                low, high = column.domain.range
                values = made.rows[:, k].astype(float)
                assert values.max() >= 0.999 * high and values.min() <= max(
                    1.01 * low, 1e-2 * (column.domain.typical or (0, high))[1]
                )
        again = extremes.extreme_table(assignment, function, 6837).rows
        assert np.array_equal(again, made.rows)  # the same inputs for everyone


# ------------------------------------------------------------------------------------------------------- the command


@pytest.fixture
def naive(tmp_path):
    write_submission(PHONG, slide_formulas(PHONG), tmp_path / "phong")
    return tmp_path / "phong"


def test_the_command_shows_hints_and_replays_the_first_failing_input(naive, tmp_path):
    file = tmp_path / "s.json"
    command = ["stability", str(naive), "--out", str(tmp_path / "out"), "--json", str(file)]
    done = CliRunner().invoke(program(), command, env={"COLUMNS": "200"})
    assert done.exit_code == 0, done.output  # a result, and no error
    assert "log1p(-x)" in done.stdout and "not phong_lobe, blinn_lobe" in done.stdout
    assert "calls phong_lobe: begin there" in done.stdout  # what only calls them is told in a line
    assert done.stdout.count("right in double") == 2  # of the two, in C++; GLSL has no double
    data = json.loads(file.read_text())
    entry = next(f for f in data["functions"] if f["function"] == "blinn_lobe")
    assert data["schema"] == "shadelab/stability/1" and not data["stable"] and not entry["stable"]
    assert set(data["limit"]["driver"]) == {"exp", "log", "pow5", "sin", "inversesqrt"}
    first = entry["first"]
    replay = first["replay"].split()
    assert replay[:2] == ["./shadelab", "eval"]
    output = tmp_path / "o.npz"
    again = CliRunner().invoke(program(), [*replay[1:], "-o", str(output)])
    assert again.exit_code == 0, again.output
    assert np.load(output)["result"].ravel() == pytest.approx(first["actual"], rel=1e-6)


def test_members_have_their_names_as_in_grade(submission, tmp_path):
    """Of ten numbers those that are wrong, each by its name; in the JSON a struct by its members."""
    term = "m.ks * phong_lobe(n, l, v, m.q)"
    folder, file = submission(cpp={term: "2.0 * " + term}), tmp_path / "s.json"
    done = CliRunner().invoke(
        program(), ["stability", str(folder), "--assignment", "phong", "--json", str(file)], env={"COLUMNS": "400"}
    )
    assert done.exit_code == 0, done.output
    assert "result.specular.x: expected" in done.stdout and "result.ambient.x" not in done.stdout
    entry = next(f for f in json.loads(file.read_text())["functions"] if f["function"] == "phong")
    assert [set(values) for values in (entry["first"]["expected"][0], entry["first"]["actual"][0])] == [
        {"ambient", "diffuse", "specular"}
    ] * 2


def test_what_does_not_compile_is_the_students_line(naive):
    (naive / "shading.cpp").write_text("#include <shadelab/shading.hpp>\nvec3 nonsense;;\nReal x = y;\n")
    done = CliRunner().invoke(program(), ["stability", str(naive)])
    assert done.exit_code == 2 or isinstance(done.exception, UserError)


# ----------------------------------------------------------------------------------------------------- declarations


def declared(tmp_path, text):
    (tmp_path / "stability.toml").write_text(text)
    return load_stability(tmp_path, [f.name for f in PHONG.functions])


def test_mistakes_in_a_declaration_are_one_line(tmp_path):
    with pytest.raises(UserError, match="stability.toml.*nothing: the manifest declares no such function"):
        declared(tmp_path, '[[function]]\nname = "nothing"\n')
    with pytest.raises(UserError, match="needs an idea"):
        declared(tmp_path, '[[function]]\nname = "blinn_lobe"\npoints = 1\n')
    with pytest.raises(UserError, match="stability.toml"):
        declared(tmp_path, '[[function]]\nname = "blinn_lobe"\nhint = "x"\n')


def hazards():
    text = (ROOT / "docs" / "stability.md").read_text()
    for line in text.splitlines():
        if re.match(r"^\| *\d+ \|", line):
            number, _, _, held = (cell.strip() for cell in line.strip("|").split("|"))
            yield int(number), held


def test_every_hazard_is_held_by_what_the_page_says():
    cases = {
        number
        for assignment in ASSIGNMENTS
        for function in read_toml(assignment.directory / "stability.toml")["function"]
        for case in function.get("case", [])
        for number in case.get("hazards", [])
    }
    listed = dict(hazards())
    assert list(listed) == list(range(1, 53))
    for number, held in listed.items():
        kind, _, rest = held.partition(" ")
        if kind == "case":
            assert number in cases, f"{number}: no case in a stability.toml names it"
        elif kind == "test":
            file, _, name = rest.partition(": ")
            assert name in (ROOT / file).read_text(), held
        elif kind == "scene":
            assert (ROOT / rest).exists(), held
        else:
            assert kind == "absent:" and number not in cases, held
    assert cases <= set(listed)
