"""What the search finds where no mistake is declared: relations of results, hypotheses, members one by one, several at once, and
conditions. On tables alone, with numbers made up here."""

import re

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment, named_arrays
from shadelab.judge.diagnosis import Patient, candidates, diagnose_by_search, diagnose_declared, hypotheses
from shadelab.judge.functions import judge_function
from shadelab.judge.places import place_of, quantities
from shadelab.truth.expected import Table
from shadelab.truth.making import load
from shadelab.truth.tables import make_table, renormalised
from shadelab.truth.transforms import transforms

PHONG = load_assignment(ROOT / "solution" / "phong")
LOBE, MODEL, MIRROR = (PHONG.function(name) for name in ("phong_lobe", "phong", "mirror_direction"))


def dot(a, b):
    return np.sum(a * b, axis=1)


def lobe(n, l, v, q):
    r = 2 * dot(n, l)[:, None] * n - l
    return np.where(dot(n, l) > 0, np.maximum(dot(v, r), 0) ** q, 0)[:, None]


def values(function, rows):
    return named_arrays(function.inputs, renormalised(function, rows))


def searched(function, truth, came, rows, changed=()):
    table = Table(rows, truth, np.zeros_like(truth), len(rows))
    judgement = judge_function(function, "cpp", 1.0, table, 0.0, came)
    assert judgement.check.status == "failed"
    return judgement, diagnose_by_search(Patient(function, judgement, came, [], list(changed), {}))


def told(change):
    """Of phong_lobe, with change(result, n, l, v, q) in its place."""
    rows = make_table(PHONG, LOBE, 5)
    arguments = values(LOBE, rows)
    truth = lobe(**arguments)
    judgement, found = searched(LOBE, truth, change(truth.copy(), **arguments), rows)
    return judgement.check.message, found.mistake.hint if found else "", found.others if found else []


@pytest.mark.parametrize(
    "change,sentence",
    [
        (lambda t, **_: t / np.pi, "Your values are 1/pi times what is expected."),
        (lambda t, **_: t * 1.0004, "Your values are 1.0004 times what is expected."),
        (lambda t, **_: np.sqrt(t), "Your values are the square root of what is expected."),
        (lambda t, q, **_: t * np.exp(-0.1 * q.reshape(t.shape)), "Your values are what is expected times exp(-0.1 q)."),
        (lambda t, **_: 1 - t, "Your values are 1 minus what is expected."),
        (lambda t, n, l, **_: t * np.maximum(dot(n, l), 0)[:, None], "Your values are what is expected times n.l."),
        (lambda t, q, **_: t * ((q + 2) / 6.2831853)[:, None], "Your values are what is expected times 1/(2 pi) (q + 2)."),
        (lambda t, q, **_: np.where((q > 80)[:, None], 0.5 * t, t), "q > 80"),
        (lambda t, n, v, **_: np.where((dot(n, v) <= 0)[:, None], 0, t), "Your values are 0 where n.v <"),
        (lambda t, **_: np.minimum(t, 0.25), "0.25"),
        (lambda t, **_: t * t * (3 - 2 * t), "on a curve of their own over what is expected"),
    ],
)  # fmt: skip
def test_what_happens_to_a_result(change, sentence):
    message, hint, others = told(change)
    assert sentence in f"{hint} {message}", (message, hint, others)


def test_two_of_them_are_told_one_by_one():
    def change(t, n, v, q, **_):
        t = np.where((dot(n, v) <= 0)[:, None], 0, t)
        return np.where((q > 80)[:, None], 0.5 * t, t)

    _, hint, others = told(change)
    assert len(others) == 1 and {"n.v" in hint, "q > 80" in hint} == {True, False} and "q > 80" in hint + others[0]


def test_noise_has_no_explanation():
    message, hint, _ = told(lambda t, **_: t + np.random.default_rng(1).uniform(0.1, 1, t.shape))
    assert hint == "" and "where" not in message


def test_a_vector_is_told_by_the_directions_that_it_is_made_of():
    rows = make_table(PHONG, MIRROR, 5)
    a = values(MIRROR, rows)
    cosine = dot(a["n"], a["l"])[:, None]
    truth = 2 * cosine * a["n"] - a["l"]
    _, found = searched(MIRROR, truth, cosine * a["n"] - 2 * a["l"], rows)
    assert found.mistake.hint == "Your values are (n.l) n - 2 l." or "n.l" in found.mistake.hint
    unit = a["n"] + a["l"]
    _, found = searched(MIRROR, truth, unit / np.linalg.norm(unit, axis=1, keepdims=True).clip(1e-9), rows)
    assert "parallel to" in found.mistake.hint and "of length 1" in found.mistake.hint


def test_members_are_explained_one_by_one():
    rows = make_table(PHONG, MODEL, 5)
    a = values(MODEL, rows)
    specular = a["m.ks"] * lobe(a["n"], a["l"], a["v"], a["m.q"])
    truth = np.hstack([a["m.ka"], a["m.kd"] * np.maximum(dot(a["n"], a["l"]), 0)[:, None], specular])
    came = truth.copy()
    came[:, 3:6] /= np.pi
    came[:, 6:9] *= a["m.kd"]
    judgement, found = searched(MODEL, truth, came, rows)
    assert "only in diffuse and specular (ambient is right)" in judgement.check.message
    assert found.mistake.hint == "Your diffuse is 1/pi times what is expected."
    assert found.others == ["Your specular is what is expected times m.kd."]


def test_arguments_are_changed_by_their_types():
    words = [t.words for t in transforms(LOBE)]
    assert len(set(words)) == len(words) > 60
    for wanted in ("with n and l exchanged", "with l pointing the other way", "with twice q in the place of q"):
        assert wanted in words
    rows = renormalised(LOBE, make_table(PHONG, LOBE, 3, 500))
    exchanged = next(t for t in transforms(LOBE) if t.words == "with n and l exchanged")
    np.testing.assert_array_equal(
        exchanged.rows(LOBE, named_arrays(LOBE.inputs, rows))[:, :6], rows[:, [3, 4, 5, 0, 1, 2]]
    )


def test_conditions_are_found_in_one_quantity():
    rows = make_table(PHONG, LOBE, 5)
    a = values(LOBE, rows)
    truth = np.ones((len(rows), 1))
    half = (a["l"] + a["v"]) / np.linalg.norm(a["l"] + a["v"], axis=1, keepdims=True).clip(1e-9)
    for wrong, words in (
        (dot(a["n"], a["l"]) < 0, "n.l < 0"),
        (a["q"] > 100, "q > 100"),
        (dot(a["n"], half) < 0.25, "n.h < 0.25"),
    ):
        assert str(place_of(LOBE, rows, truth, wrong)) == words
    assert place_of(LOBE, rows, truth, np.random.default_rng(1).random(len(rows)) < 0.3) is None
    assert place_of(LOBE, rows, truth, np.ones(len(rows), bool)) is None


def test_nothing_and_nothing_are_alike_for_any_reason():
    """A lobe around the half vector of n and l is next to nothing nearly everywhere, as what other mistakes give is."""
    expected, function = load(PHONG), PHONG.function("blinn_lobe")
    table = expected.table(function)
    a = values(function, table.rows)
    half = a["n"] + a["l"]
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
    came = np.where(dot(a["n"], a["l"]) > 0, np.maximum(dot(half, a["v"]), 0) ** a["q"].ravel(), 0)[:, None]
    judgement = judge_function(function, "cpp", 1.0, table, expected.floor(function, "cpp"), came.astype(np.float32))
    found = diagnose_by_search(Patient(function, judgement, came, [], hypotheses(expected, function), {}))
    assert found is None or "in the place of" not in " ".join([found.mistake.hint, *found.others])


# ------------------------------------------------------------------------- every sentence about a declared mistake


@pytest.mark.parametrize("name", assignment_names())
def test_every_sentence_about_a_declared_mistake_is_true(name):
    """Of each mistake the message is read again, and held against the table that it speaks of; and each keeps its name."""
    assignment = load_assignment(ROOT / "solution" / name)
    expected, conditions, constants = load(assignment), 0, 0
    for mistake in expected.facts.mistakes:
        function = assignment.function(mistake["function"])
        table, floor = expected.table(function), expected.floor(function, "cpp")
        came = expected.mistakes[f"{mistake['id']}/cpp/{function.name}"]
        judgement = judge_function(function, "cpp", 1.0, table, floor, came)
        known, changed = candidates(expected, function, "cpp"), hypotheses(expected, function)
        found = diagnose_declared(Patient(function, judgement, came, known, changed, {}))
        assert mistake["id"] in (found.mistake.id, *found.mistake.alike)
        message = judgement.check.message
        share = re.match(r"wrong for (nearly all|all|[\d.e+-]+ %) of the inputs", message)
        assert share, message
        if share[1].endswith("%"):
            assert float(share[1][:-2]) / 100 == pytest.approx(judgement.wrong.mean(), rel=0.06)
        if always := re.search(r"yours is always ([-\d.e+]+)", message):
            constants += 1
            assert np.allclose(came, float(always[1]), rtol=1e-3), message
        if condition := re.search(r"only where (.+) (<=|>=|<|>|=) ([-\d.e+]+)(?:;|$)", message):
            conditions += 1
            quantity = quantities(function, table.rows, table.truth)[condition[1]]
            value = float(condition[3])
            held = {"<": quantity < value, "<=": quantity <= value, ">": quantity > value, ">=": quantity >= value}
            inside = held.get(condition[2], np.isclose(quantity, value, rtol=1e-2))
            assert (judgement.wrong & inside).sum() > 0.999 * judgement.wrong.sum(), (mistake["id"], message)
    assert conditions >= 3
