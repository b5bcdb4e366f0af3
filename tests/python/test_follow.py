"""Follow-through: a function that is right given what the student's other functions give it keeps its points."""

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment, named_arrays
from shadelab.course.mistakes import load_changes, with_bodies
from shadelab.evidence.programs import Programs
from shadelab.evidence.tasks import Evaluate, Output
from shadelab.grading.grade import grade
from shadelab.truth.follow import FollowedSolution, followed_text
from shadelab.truth.tables import make_table, renormalised

PHONG = load_assignment(ROOT / "solution" / "phong")
MISTAKES = {m.id: m for m in load_changes(PHONG).mistake}
HALF, FOUR = MISTAKES["half-vector-not-normalised"], MISTAKES["blinn-lobe-exponent-times-four"]
ZERO = "return 0.0;"


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """graded(cpp={function: body}, glsl=...): the checks by id, of the solution with these bodies. Each is graded once."""
    cache = {}

    def run(only="*/function/*", **bodies):
        key = repr((only, sorted(bodies.items())))
        if key not in cache:
            folder = tmp_path_factory.mktemp("submission")
            for backend in ("cpp", "glsl"):
                source = PHONG.directory / f"shading.{backend}"
                text = with_bodies(source.read_text(), source, bodies.get(backend, {}))
                (folder / f"shading.{backend}").write_text(text)
            cache[key] = {check.id: check for check in grade(PHONG, folder, only=only).result.checks}
        return cache[key]

    return run


def both(bodies):
    return {"cpp": bodies, "glsl": bodies}


def failed(checks):
    return {id for id, check in checks.items() if check.status == "failed"}


def test_a_wrong_function_costs_itself_alone(graded):
    """Each language by its own: here the two half vectors are wrong in different ways, of which only one is declared."""
    checks = graded(
        only="*/function/[bhm]*",
        cpp={"half_vector": HALF.body},
        glsl={"half_vector": "return normalize(2.0 * l + v);"},
    )
    functions = {id for id in checks if "/function/" in id}
    assert failed({id: checks[id] for id in functions}) == {"cpp/function/half_vector", "glsl/function/half_vector"}
    assert checks["cpp/function/half_vector"].mistake.id == HALF.id
    assert checks["glsl/function/half_vector"].mistake.id == "undeclared"
    for backend in ("cpp", "glsl"):
        for name in ("blinn_lobe", "blinn_phong"):
            check = checks[f"{backend}/function/{name}"]
            assert check.score == check.max_score > 0
            assert check.message == "right, given what your half_vector gives"
        assert checks[f"{backend}/function/mirror_direction"].message == ""  # has nothing to do with it


def test_pictures_are_told_which_function_explains_them(graded):
    image = graded(only="cpp/*/[hk][an]*", cpp={"half_vector": HALF.body})["cpp/image/knot"]
    assert image.status == "failed" and image.because == ["cpp/function/half_vector"]
    assert image.mistake.id == HALF.id and "it is drawn with half_vector, which is wrong" in image.message


def test_a_function_that_is_wrong_itself_is_still_wrong_and_named(graded):
    checks = graded(**both({"half_vector": HALF.body, "blinn_lobe": FOUR.body}))
    for backend in ("cpp", "glsl"):
        named = {id: c.mistake.id for id, c in checks.items() if c.backend == backend and c.status == "failed"}
        assert named == {f"{backend}/function/half_vector": HALF.id, f"{backend}/function/blinn_lobe": FOUR.id}
        lobe, model = checks[f"{backend}/function/blinn_lobe"], checks[f"{backend}/function/blinn_phong"]
        assert lobe.score < lobe.max_score
        assert (
            model.score == model.max_score
            and model.message == "right, given what your blinn_lobe and half_vector gives"
        )


@pytest.mark.parametrize("backend", ["cpp", "glsl"])
def test_what_is_not_written_yet_is_not_right(graded, backend):
    """Everything that such a half vector gives is 0, and so would be a lobe that is computed from it."""
    nothing = {"half_vector": "return vec3(0.0);", "blinn_lobe": ZERO}
    checks = graded(only=f"{backend}/function/[bh]*[er]", **{backend: nothing})
    assert failed(checks) == {f"{backend}/function/half_vector", f"{backend}/function/blinn_lobe"}
    lobe = checks[f"{backend}/function/blinn_lobe"]
    assert lobe.score < 0.5 * lobe.max_score and "given what your" not in lobe.message


def test_an_unwritten_lobe_gets_nothing_from_a_wrong_half_vector(graded):
    checks = graded(only="cpp/function/[bh]*[er]", cpp={"half_vector": HALF.body, "blinn_lobe": ZERO})
    assert failed(checks) == {"cpp/function/half_vector", "cpp/function/blinn_lobe"}


def test_a_callee_that_is_not_finite_spoils_itself(graded):
    """normalize of nothing: the opposite l and v, for which half-vector-opposite has no answer."""
    opposite = MISTAKES["half-vector-opposite"]
    checks = graded(only="cpp/function/[bh]*", cpp={"half_vector": opposite.body})
    assert failed(checks) == {"cpp/function/half_vector"}
    assert checks["cpp/function/half_vector"].mistake.id == opposite.id


# ------------------------------------------------------------------------------------------------ the mechanism


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return Reference(tmp_path_factory.mktemp("reference"))


class Reference:
    """The solution, answered: by its own program, or for the student's functions by what stands in for them."""

    def __init__(self, folder):
        self.solution = FollowedSolution(PHONG)
        self.programs = Programs(PHONG, folder)

    def calls(self, function, rows):
        return self.programs.answer_all(self.solution.calls(function, rows))

    def with_recorded(self, function, rows, callees, evaluate):
        asking, output = self.solution.with_recorded(function, rows, callees), None
        while True:
            try:
                task = asking.send(output)
            except StopIteration as end:
                return end.value
            if task.program == self.solution.program:
                output = self.programs.answer(task)
            else:
                output = Output(array=evaluate(task.function, task.rows))

    def alone(self, function, rows):
        return self.programs.answer(Evaluate(function, rows, program=self.solution.program)).array


def lobe_rows():
    lobe = PHONG.function("blinn_lobe")
    return lobe, renormalised(lobe, make_table(PHONG, lobe, 3, 1500))


def test_calls_are_found_with_their_arguments(reference):
    lobe, rows = lobe_rows()
    calls = reference.calls(lobe, rows)
    assert set(calls) == {"half_vector"} and calls["half_vector"].dtype == np.float32
    values = named_arrays(lobe.inputs, rows)
    above = np.sum(values["n"] * values["l"], axis=1) > 0  # the gate stands before the call
    asked = np.unique(np.hstack([values["l"], values["v"]])[above].astype(np.float32), axis=0)
    np.testing.assert_array_equal(np.unique(calls["half_vector"], axis=0), asked)
    assert len(calls["half_vector"]) == len(asked)  # each once


def test_numbers_stand_in_for_a_function(reference):
    """What the lobe gives with another half vector, worked out here again."""
    lobe, rows = lobe_rows()
    asked = []

    def half_as_long(function, arguments):
        asked.append((function.name, len(arguments)))
        return 0.5 * (arguments[:, 0:3] + arguments[:, 3:6])

    came = reference.with_recorded(lobe, rows, [PHONG.function("half_vector")], half_as_long)
    assert len(asked) == 1 and asked[0][0] == "half_vector"
    n, l, v, q = rows[:, 0:3], rows[:, 3:6], rows[:, 6:9], rows[:, 9]
    h = 0.5 * (l.astype(np.float32) + v.astype(np.float32)).astype(float)
    x = 0.5 * np.sum((n - h) ** 2, axis=1)
    nothing = (x >= 1) | (np.sum(n * h, axis=1) <= 0)
    with np.errstate(all="ignore"):
        wanted = np.where(nothing, q == 0, np.exp(q * np.log1p(-x)))
    wanted[np.sum(n * l, axis=1) <= 0] = 0
    np.testing.assert_allclose(came[:, 0], wanted, rtol=1e-4, atol=1e-12)
    # With no outputs there is nothing to follow; with the reference's own, everything is as it was.
    assert reference.with_recorded(lobe, rows, [PHONG.function("half_vector")], lambda *_: None) is None
    alone = reference.with_recorded(lobe, rows, [], half_as_long)
    assert not np.allclose(alone, came)


def test_a_function_is_not_answered_for_itself(reference):
    """Only calls among the functions are asked about: what is judged is computed."""
    half = PHONG.function("half_vector")
    rows = renormalised(half, make_table(PHONG, half, 3, 100))
    came = reference.with_recorded(half, rows, [half], lambda *_: pytest.fail("it was asked for"))
    np.testing.assert_array_equal(came, reference.alone(half, rows))


def test_definitions_keep_their_names():
    text = "Real f(Real x) {\n    return g(x) + f2(x);\n}\nReal g(Real x) {\n    return 1.0;\n}\n"
    assert followed_text(text, ["f", "g"]) == text.replace("return g(x)", "return g_followed(x)")
