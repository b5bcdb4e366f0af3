"""A function that is right where scenes need it, at the ends of its domain: where students have points for it. The command
`stability` shows every function."""

import numpy as np

from shadelab.course.assignment import Assignment, Function
from shadelab.evidence.tasks import Asking, Evaluate, Program
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.grading.questions import finished, without_numbers
from shadelab.judge.credit import MISTAKE
from shadelab.judge.stability import (
    FLOORS,
    Stability,
    describe,
    first_input,
    judge_extremes,
    stable_inputs,
)
from shadelab.machine.build import DOUBLE
from shadelab.result import Check, Error, Mistake, Worst
from shadelab.truth.expected import with_callees

NAME = "stability"
STAGE = 1
TOGETHER = True
DRAWS = False
REPLAY = "eval"
BOTH = False


def items(assignment: Assignment) -> list[tuple]:
    points = {name: declared.points for name, declared in assignment.stability.items()}
    return [(f.name, points[f.name], f) for f in assignment.functions if points.get(f.name)]


def judge(plan: Plan, ledger: Ledger) -> Asking[Check]:
    function: Function = plan.item
    output = yield Evaluate(function, ledger.expected.stable_table(function).rows)
    if output.array is None:
        return without_numbers(plan, ledger, output)
    return finished((yield from _judge(plan, ledger, output.array)), output)


def _judge(plan: Plan, ledger: Ledger, actual: np.ndarray) -> Asking[Check]:
    function = plan.item
    used = with_callees({function.name}, ledger.expected.facts.calls)
    wrong = [f"{ledger.backend}/function/{name}" for name in ledger.judged if name in used and not _right(ledger, name)]
    if wrong:
        return plan.check("skipped", "it is asked of functions that are right otherwise", wrong)
    found = judge_extremes(ledger.assignment, ledger.expected, function, ledger.backend, actual)
    check = plan.check("failed" if found.faults else "passed")
    check.score = plan.points * (found.right * (1 - MISTAKE) if found.faults else 1.0)
    worst = found.worst if np.isfinite(found.worst) else None
    check.error = Error(name="floors", value=worst, limit=FLOORS, floor=1.0)
    if found.faults:
        check.message = describe(found, (yield from _in_double(ledger, function)))
        first = first_input(function, found)
        check.worst = Worst(**{name: first[name] for name in ("inputs", "expected", "actual")})
        idea = ledger.assignment.stability[function.name].idea
        ratio = (worst or np.finfo(np.float32).max) / FLOORS
        check.mistake = Mistake(id="unstable-form", hint=idea, margin=max(1.0, float(ratio)))
    return check


def _right(ledger: Ledger, name: str) -> bool:
    judged = ledger.judged[name]
    return judged.check.status == "passed" and not judged.followed


def _in_double(ledger: Ledger, function: Function) -> Asking[Stability | None]:
    """The same C++ in double, which tells bad algebra from a wrong formula. GLSL 330 has no double."""
    if ledger.backend != "cpp":
        return None
    rows = stable_inputs(ledger.expected, function, "double")
    output = yield Evaluate(function, rows, program=Program(DOUBLE))
    if output.array is None:
        return None
    return judge_extremes(ledger.assignment, ledger.expected, function, "double", output.array)
