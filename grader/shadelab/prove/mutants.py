"""The solution with one operator, constant, call or argument changed (mutation testing). The grader's tables must tell each from
the solution. One that computes the same is listed in mistakes.toml as equivalent, with the reason why it is."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import load_changes, regions, with_bodies
from shadelab.course.mutants import Mutant, Scope, mutants
from shadelab.errors import UserError
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.judge.functions import judge_function
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import shown
from shadelab.truth.expected import Expected, with_callers
from shadelab.truth.many import ManyBodies
from shadelab.words import FILES

THREADS = 2


@dataclass
class Mutation:
    """What came of the mutants of one assignment, in one language."""

    backend: str
    killed: int
    stillborn: int  # they do not compile
    equivalent: list[str]
    survivors: list[str]


def mutate(assignment: Assignment, expected: Expected, folder: Path, progress) -> list[Mutation]:
    """Every graded function's."""
    changes = load_changes(assignment)
    out, stale = [], {e.id for e in changes.equivalent}
    for backend, name in FILES.items():
        source = assignment.directory / name
        text = source.read_text()
        marked = regions(text, source)
        bred = [
            mutant
            for function in assignment.functions
            if function.graded and function.name in marked
            for mutant in mutants(function.name, marked[function.name]["body"], Scope.of(assignment, function, text))
            if not mutant.slip
        ]
        if not bred:
            continue
        judge = _judge_cpp if backend == "cpp" else _judge_glsl
        verdicts = judge(assignment, expected, bred, folder / backend, progress)
        listed = {e.id for e in changes.equivalent}
        alive = [m.id for m, verdict in zip(bred, verdicts) if verdict == "alive"]
        stale -= set(alive)
        survivors = [id for id in alive if id not in listed]
        counts = Counter(verdicts)
        out.append(
            Mutation(backend, counts["killed"], counts["stillborn"], [i for i in alive if i in listed], survivors)
        )
    if stale:
        raise UserError(
            f"{shown(assignment.directory / 'mistakes.toml')}: no surviving mutant is called {sorted(stale)[0]}"
        )
    return out


def _affected(assignment: Assignment, expected: Expected, mutant: Mutant) -> list:
    """The function itself first: most mutants end there."""
    names = with_callers({mutant.function}, expected.facts.calls)
    found = [f for f in assignment.functions if f.name in names and f.graded]
    return sorted(found, key=lambda f: f.name != mutant.function)


def _killed(expected: Expected, function, backend: str, array: np.ndarray) -> bool:
    table, floor = expected.table(function), expected.floor(function, backend)
    return bool(judge_function(function, backend, 1.0, table, floor, array).wrong.any())


def _judge_cpp(assignment, expected, bred: list[Mutant], folder: Path, progress) -> list[str]:
    """A mutant's own function first, and those that call it only for the survivors."""
    what = f"{assignment.name}: mutants, C++"
    progress(what, 0, len(bred))
    many = ManyBodies(assignment, folder, {k: {m.function: m.body} for k, m in enumerate(bred)}, double=False)
    verdicts = dict.fromkeys(many.numbers, "killed")  # until it gives numbers, and right ones
    pending = [(k, 0) for k in many.numbers]
    while pending:
        asked: dict[str, list[int]] = {}
        for k, place in pending:
            asked.setdefault(_affected(assignment, expected, bred[k])[place].name, []).append(k)

        def survivors(name: str, asked=asked) -> list[int]:
            task = Evaluate(assignment.function(name), expected.table(assignment.function(name)).rows)
            outputs = many.evaluate(asked[name], task, name)
            return [k for k, output in outputs if not _killed(expected, task.function, "cpp", output)]

        with ThreadPoolExecutor(THREADS) as pool:
            alive = {k for found in pool.map(survivors, asked) for k in found}
        again = []
        for k, place in pending:
            last = place + 1 == len(_affected(assignment, expected, bred[k]))
            if k in alive and last:
                verdicts[k] = "alive"
            elif k in alive:
                again.append((k, place + 1))
        pending = again
        progress(what, len(bred) - len(pending), len(bred))
    return [verdicts.get(number, "stillborn") for number in range(len(bred))]


def _judge_glsl(assignment, expected, bred: list[Mutant], folder: Path, progress) -> list[str]:
    """In a few client processes; a mutant's own function first, and those that call it only for the survivors."""
    source = assignment.directory / FILES["glsl"]
    text = source.read_text()
    files = [folder / str(number) / FILES["glsl"] for number in range(len(bred))]
    for mutant, file in zip(bred, files):
        file.parent.mkdir(parents=True)
        file.write_text(with_bodies(text, source, {mutant.function: mutant.body}))
    verdicts = ["alive"] * len(bred)
    pending = [(k, 0) for k in range(len(bred))]
    while pending:
        functions = [_affected(assignment, expected, bred[k])[place] for k, place in pending]
        tasks = [Evaluate(f, expected.table(f).rows, files[k]) for f, (k, _) in zip(functions, pending)]
        outputs: list = [None] * len(tasks)

        def run(part: int, tasks=tasks, outputs=outputs) -> None:
            runner = GlslRunner(assignment, Sandbox(folder / "sandboxes" / f"glsl-{part}"))
            runner.take(files[0].parent)
            for index, (_, output) in zip(range(part, len(tasks), THREADS), runner.run(tasks[part::THREADS])):
                outputs[index] = output
                progress(f"{assignment.name}: mutants, GLSL", sum(o is not None for o in outputs), len(tasks))

        with ThreadPoolExecutor(THREADS) as pool:
            list(pool.map(run, range(min(THREADS, len(tasks)))))
        again = []
        for (k, place), function, output in zip(pending, functions, outputs):
            if output.array is None:
                verdicts[k] = "stillborn" if place == 0 else "killed"
            elif _killed(expected, function, "glsl", output.array):
                verdicts[k] = "killed"
            elif place + 1 < len(_affected(assignment, expected, bred[k])):
                again.append((k, place + 1))
        pending = again
    return verdicts
