"""The table that each function is judged by: inputs from the domains and from the scenes, their truth, and how far rounding
moves it."""

import numpy as np

from shadelab.course.assignment import Function, Scene
from shadelab.course.mistakes import slide_formulas
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.programs import Programs
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import Recipe
from shadelab.truth.expected import SceneTruth, Table
from shadelab.truth.follow import FollowedSolution
from shadelab.truth.fragments import recorded_rows
from shadelab.truth.tables import changing, jittered, make_table, on_gate, one_by_one, renormalised
from shadelab.truth.workshop import Workshop

FRAGMENTS = 1024  # rows of a function's table that are recorded from scenes, at most
DOUBLE = Recipe(double=True, loops=())


def make_tables(
    workshop: Workshop, scenes: list[Scene], truths: dict[str, SceneTruth], seed: int
) -> tuple[dict[str, Table], dict[str, list[str]], list[str]]:
    """By function its table, and which functions it calls; the scenes of which tables hold rows."""
    assignment = workshop.assignment
    with workshop.step("tables"):
        solution = FollowedSolution(assignment)
        programs = Programs(assignment, workshop.work / "followed")
        forms = [workshop.solution(DOUBLE)]
        if slides := slide_formulas(assignment):
            forms.append(workshop.cpp(workshop.changed(slides), DOUBLE, slides.id))
        drawn = {f.name: make_table(assignment, f, seed) for f in assignment.functions}
        recorded = recorded_rows(assignment, scenes, truths, seed)
        tables, calls = {}, {}
        # Callees are defined before their callers: from the last function on, what a scene asks of one reaches those it calls.
        for function in reversed(assignment.functions):
            calls[function.name] = sorted(
                programs.answer_all(solution.calls(function, renormalised(function, drawn[function.name])))
            )
            asked = {}
            for scene, of_scene in recorded.items():
                if function.name in of_scene:
                    asked[scene] = of_scene[function.name]
                    called = solution.calls(function, renormalised(function, asked[scene]))
                    for name, arguments in programs.answer_all(called).items():
                        of_scene[name] = np.vstack([of_scene[name], arguments]) if name in of_scene else arguments
            rows, origin = _some(asked, list(recorded), len(function.inputs), seed)
            tables[function.name] = _judged(workshop, function, drawn[function.name], rows, forms)
            tables[function.name].scenes = np.concatenate([np.full(len(drawn[function.name]), -1), origin])
        return {f.name: tables[f.name] for f in assignment.functions}, calls, list(recorded)


def _judged(
    workshop: Workshop, function: Function, drawn: np.ndarray, recorded: np.ndarray, forms: list[CppRunner]
) -> Table:
    """The forms are equal on exact unit vectors; how much rounding of the inputs moves them depends on the form, and nobody
    has to know a better one than the slides'."""
    rows = np.vstack([drawn, recorded])
    inputs = moved_rows(function, rows)
    truth, conditioning = truth_of(
        [workshop.outputs(form, [Evaluate(function, inputs)])[0].array for form in forms], len(rows)
    )
    conditioning[on_gate(function, len(drawn), len(rows))] = 0.0
    return Table(rows, truth, conditioning, len(drawn))


def moved_rows(function: Function, rows: np.ndarray) -> np.ndarray:
    """(K N, columns) float64: the rows exactly, and then as rounding of the inputs moves them."""
    exact = renormalised(function, rows)
    return np.concatenate([exact, *jittered(function, exact)])


def truth_of(results: list[np.ndarray], rows: int) -> tuple[np.ndarray, np.ndarray]:
    """The truth and its conditioning, (rows, results) each, from what several forms give for moved_rows; the first is the
    solution."""
    parts = [result.reshape(-1, rows, result.shape[1]) for result in results]
    truth = parts[0][0]
    with np.errstate(invalid="ignore"):
        return truth, np.nan_to_num(np.abs(np.concatenate(parts)[1:] - truth)).max(axis=0)


def on_what(workshop: Workshop, tables: dict[str, Table]) -> dict[str, list[str]]:
    """By function, the inputs that its result changes with."""
    runner, out = workshop.solution(DOUBLE), {}
    for function in workshop.assignment.functions:
        rows = one_by_one(function, renormalised(function, tables[function.name].rows))
        [output] = workshop.outputs(runner, [Evaluate(function, np.concatenate(list(rows.values())))])
        out[function.name] = changing(rows, output.array)
    return out


def _some(asked: dict[str, np.ndarray], scenes: list[str], columns: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """At most FRAGMENTS rows, as many of each scene; and the number of the scene that each is of."""
    if not asked:
        return np.empty((0, columns), np.float32), np.empty(0, int)
    each = max(1, FRAGMENTS // len(asked))
    rng = np.random.default_rng(seed)
    chosen = {scene: rows[rng.permutation(len(rows))[:each]] for scene, rows in asked.items()}
    origin = np.concatenate([np.full(len(rows), scenes.index(scene)) for scene, rows in chosen.items()])
    return np.vstack(list(chosen.values()))[:FRAGMENTS], origin[:FRAGMENTS]
