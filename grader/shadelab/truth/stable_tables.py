"""Extreme inputs of every function, their truth from 50 digits, their conditioning from the solution in double."""

import numpy as np

from shadelab.errors import UserError
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import Recipe
from shadelab.paths import shown
from shadelab.truth.extremes import extreme_table
from shadelab.truth.tables import moved_one_by_one, renormalised
from shadelab.truth.workshop import Workshop


def make_stable_tables(workshop: Workshop, seed: int) -> dict[str, list[str]]:
    """Writes extremes.npz. Returns the names of each function's cases."""
    assignment = workshop.assignment
    file = assignment.directory / "exact.py"
    if not file.exists():
        if assignment.stability:
            raise UserError(
                f"{shown(file)}: is missing; it gives the functions in 50 digits, by which stability is judged"
            )
        return {}
    from shadelab.truth import exact  # mpmath takes a while to load

    double = workshop.solution(Recipe(double=True, loops=()))
    arrays: dict[str, np.ndarray] = {}
    cases: dict[str, list[str]] = {}
    with workshop.step("extreme inputs"):
        for function in assignment.functions:
            table = extreme_table(assignment, function, seed)
            rows, cases[function.name] = table.rows, table.cases
            table.truth = exact.evaluate(assignment, function, rows)
            inputs = renormalised(function, rows)
            moved = moved_one_by_one(function, inputs)
            every = np.concatenate([inputs, moved.reshape(-1, inputs.shape[1])])
            [output] = workshop.outputs(double, [Evaluate(function, every)])
            still, changed = output.array[: len(rows)], output.array[len(rows) :]
            with np.errstate(invalid="ignore"):
                away = np.abs(changed.reshape(*moved.shape[:3], still.shape[1]) - still)
            table.conditioning = away.max(axis=1).sum(axis=0)
            arrays |= {f"{function.name}.{part}": array for part, array in table.arrays().items()}
    np.savez(workshop.folder / "extremes.npz", **arrays)
    return cases
