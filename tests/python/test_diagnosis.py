"""Which declared mistake a submission makes: by numbers alone, in whatever words it is written."""

import shlex

import numpy as np

from conftest import ROOT
from shadelab.course.assignment import Column, Domain, Function, load_assignment
from shadelab.course.mistakes import load_changes
from shadelab.judge.diagnosis import Patient, diagnose_by_search, diagnose_declared
from shadelab.judge.functions import FunctionJudgement
from shadelab.judge.relations import MARGIN, Candidate
from shadelab.result import Check, Error
from shadelab.truth.expected import Table
from shadelab.truth.measures import function_limit, scaled_error

PHONG = load_assignment(ROOT / "solution" / "phong")
ROWS = 1000
TRUTH = np.linspace(0.5, 1, ROWS)[:, None]
TABLE = Table(np.zeros((ROWS, 1), np.float32), TRUTH, np.zeros_like(TRUTH), ROWS)
MEMBERS = [slice(0, 1)]
LIMIT = function_limit(0.0, "cpp")


FUNCTION = Function("f", [], "Real", [], [Column("result", 0, 1, Domain())], points=1)


def off(kind, rows=slice(None)):
    """Off by a factor of each row's own, so that no relation explains it."""
    factors = np.random.default_rng(kind).uniform(kind, kind + 0.5, TRUTH.shape)
    out = TRUTH.copy()
    out[rows] *= factors[rows]
    return out


def candidate(id, output, function="f"):
    return Candidate(id, function, f"hint of {id}", output)


def found(actual, *known):
    wrong = scaled_error(actual, TABLE, MEMBERS).max(axis=1) > LIMIT
    check = Check(
        id="cpp/function/f",
        kind="function",
        backend="cpp",
        status="failed",
        score=0,
        max_score=1,
        message="wrong",
        error=Error(name="scaled", value=1, limit=LIMIT),
    )
    judgement = FunctionJudgement(check=check, table=TABLE, followed=False, wrong=wrong, error=wrong * 1.0)
    patient = Patient(FUNCTION, judgement, actual, list(known), [], {})
    return diagnose_declared(patient) or diagnose_by_search(patient)


def test_the_nearest_is_named_with_its_margin():
    rounded = off(2) * (1 + 2e-4)  # the same mistake in other words rounds differently
    diagnosis = found(rounded, candidate("thrice", off(3)), candidate("twice", off(2)))
    assert diagnosis.mistake.id == "twice" and diagnosis.mistake.hint == "hint of twice"
    assert diagnosis.mistake.margin == ROWS + 1 and diagnosis.mistake.alike == [] and not diagnosis.others


def test_the_margin_counts_what_the_next_best_leaves_unexplained():
    nearly = candidate("nearly", off(2, slice(0, ROWS - 20)))
    assert found(off(2), nearly, candidate("twice", off(2))).mistake.margin == 21
    # Two that differ by one row only: which of them it was remains open.
    nearer = candidate("nearer", off(2, slice(0, ROWS - 1)))
    assert found(off(2), nearer, candidate("twice", off(2))) is None


def test_equal_mistakes_are_told_together():
    diagnosis = found(off(2), candidate("one", off(2)), candidate("other", off(2)), candidate("thrice", off(3)))
    assert diagnosis.mistake.id == "one" and diagnosis.mistake.alike == ["other"]
    assert diagnosis.mistake.hint == "hint of one Or: hint of other"


def test_a_single_row_that_agrees_is_no_evidence():
    assert found(off(2, [7]), candidate("point", off(2, [7]))) is None
    two = found(off(2, [7, 8]), candidate("point", off(2, [7, 8])))
    assert two.mistake.id == "point" and two.mistake.margin >= MARGIN


def test_what_explains_only_most_of_it_is_not_named():
    most = candidate("most", off(2, slice(0, 850)))
    assert found(off(2), most) is None
    assert found(off(2, slice(0, 900)), most).mistake.id == "most"


def test_two_mistakes_on_inputs_of_their_own_are_both_named():
    gate, power = candidate("gate", off(2, slice(0, 200))), candidate("power", off(3, slice(500, 600)))
    both = off(2, slice(0, 200))
    both[500:600] = off(3)[500:600]
    diagnosis = found(both, gate, power, candidate("unlike", off(5)))
    assert {f"hint of {diagnosis.mistake.id}", *diagnosis.others} == {"hint of gate", "hint of power"}


def test_the_callees_mistake_comes_first_of_two():
    """Its own come first among the candidates, so that they win a tie; but what stands earlier in the data flow is mended
    first."""
    own, callees = candidate("own", off(2, slice(0, 200))), candidate("callee's", off(3, slice(500, 600)), "callee")
    both = off(2, slice(0, 200))
    both[500:600] = off(3)[500:600]
    diagnosis = found(both, own, callees)
    assert (diagnosis.mistake.id, diagnosis.others) == ("callee's", ["hint of own"])


def test_noise_is_nobodys_mistake():
    noise = TRUTH + np.random.default_rng(1).normal(size=TRUTH.shape)
    assert found(noise, candidate("twice", off(2)), candidate("gate", off(2, slice(0, 200)))) is None
    assert found(noise) is None


# ---------------------------------------------------------------------------------------------------- end to end

# blinn-lobe-exponent-times-four, phong-ambient-times-kd and mirror-sign in other words than mistakes.toml's.
SIGN = {"return 2.0 * dot(n, l) * n - l;": "vec3 along = dot(l, n) * n;\n    return (l - along) - along;"}
TIMES_FOUR = {
    "if (x >= 1.0 || dot(n, h) <= 0.0) return q == 0.0 ? 1.0 : 0.0;\n    return exp(q * log1p(-x));": (
        "Real c = dot(h, n);\n    if (c <= 0.0) return q > 0.0 ? 0.0 : 1.0;\n"
        "    Real square = pow(c, q + q);\n    return square * square;"
    )
}
TIMES_KD = {
    "return Terms(m.ka, m.kd * max(dot(n, l), 0.0), m.ks * phong_lobe(n, l, v, m.q));": (
        "Terms t = Terms(m.kd, m.kd, m.ks);\n    t.ambient *= m.ka;\n"
        "    t.diffuse *= clamp(dot(l, n), 0.0, 1.0);\n    t.specular *= phong_lobe(n, l, v, m.q);\n    return t;"
    )
}
UNDECLARED = {
    "if (x >= 1.0) return q == 0.0 ? 1.0 : 0.0;\n    return exp(q * log1p(-x));": (
        "if (x >= 1.0) return q == 0.0 ? 1.0 : 0.0;\n    return exp(0.7 * q * log1p(-x));"
    )
}


def test_declared_mistakes_are_named_in_whatever_words(grade, submission):
    change = SIGN | TIMES_FOUR | TIMES_KD
    result = grade(submission(cpp=change, glsl=change), only="*/function/*")
    declared = {m.id: m for m in load_changes(PHONG).mistake}
    for backend in ("cpp", "glsl"):
        for function, id in {
            "mirror_direction": "mirror-sign",
            "blinn_lobe": "blinn-lobe-exponent-times-four",
            "phong": "phong-ambient-times-kd",
        }.items():
            check = result["by_id"][f"{backend}/function/{function}"]
            assert check["mistake"], check
            assert check["mistake"]["id"] == id and check["mistake"]["margin"] >= MARGIN
            assert check["mistake"]["hint"] == declared[id].hint
            assert "not a mistake that the grader knows" not in check["message"]


def test_an_undeclared_mistake_is_told_by_a_relation_and_its_worst_input(grade, submission, shadelab):
    result = grade(submission(cpp=UNDECLARED, glsl=UNDECLARED), only="*/function/phong_lobe")
    for backend in ("cpp", "glsl"):
        check = result["by_id"][f"{backend}/function/phong_lobe"]
        assert check["status"] == "failed" and check["mistake"]["id"] == "undeclared"
        assert check["mistake"]["hint"] == "Your values are the power 0.7 of what is expected."
        worst = check["worst"]
        assert list(worst["inputs"]) == ["n", "l", "v", "q", "h"]
        l, v, h = (np.array(worst["inputs"][name]) for name in "lvh")
        np.testing.assert_allclose(h, (l + v) / np.linalg.norm(l + v), atol=1e-6)
        replay = shlex.split(worst["replay"])
        done = shadelab(*replay[1:])
        assert replay[0] == "./shadelab" and done.code == 0, done.stderr
        assert f"result = {worst['actual'][0]:.7g}" in done.stdout
        assert worst["actual"] != worst["expected"]


def test_what_is_not_written_yet_is_not_called_unknown(grade):
    result = grade(ROOT / "starter" / "phong", only="cpp/function/*_lobe")
    for check in result["checks"][1:]:
        assert check["status"] == "failed" and check["message"].startswith("not begun") and not check["begun"]
        assert check["mistake"] is None and "not a mistake" not in check["message"]
