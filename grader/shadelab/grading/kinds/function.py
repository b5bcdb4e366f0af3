"""One function over its table."""

from dataclasses import replace

import numpy as np

from shadelab.course.assignment import Assignment, Function
from shadelab.course.mistakes import load_changes
from shadelab.evidence.tasks import Asking, Evaluate, Output, Program, T, Trace
from shadelab.grading.branches import Known, search, with_rows
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.grading.questions import finished, without_numbers
from shadelab.judge.credit import credit
from shadelab.judge.diagnosis import Patient, candidates, diagnose_by_search, diagnose_declared, hypotheses
from shadelab.judge.functions import OFF, Followed, FunctionJudgement, informative, judge_function, may_be_rounding
from shadelab.judge.relations import Candidate
from shadelab.judge.words import percent_of
from shadelab.machine.build import DOUBLE, FUNCTIONS
from shadelab.result import Check
from shadelab.truth.expected import Table
from shadelab.truth.follow import FollowedSolution
from shadelab.truth.tables import changing, exact_rows, jittered, one_by_one, renormalised
from shadelab.words import FILES, listed

AGAIN = 17  # of so many rows one is asked twice, the second time in the other order

NAME = "function"
STAGE = 1
TOGETHER = True
DRAWS = False
REPLAY = "eval"
BOTH = False


def items(assignment: Assignment) -> list[tuple]:
    return [(f.name, f.points, f) for f in assignment.functions if f.graded]


def judge(plan: Plan, ledger: Ledger) -> Asking[Check]:
    function: Function = plan.item
    rows = ledger.expected.table(function).rows
    again = np.arange(len(rows))[::-AGAIN]
    output = yield Evaluate(function, np.vstack([rows, rows[again]]), traced=ledger.backend == "cpp")
    if output.array is None:
        return without_numbers(plan, ledger, output)
    first, second = output.array[: len(rows)], output.array[len(rows) :]
    ledger.outputs[function.name] = first
    check = yield from _judge(plan, ledger, first)
    if check.status == "passed" and not ledger.judged[function.name].followed:
        check = yield from _ask_branches(plan, ledger, first, output.trace, check)
    other = ~((first[again] == second) | (np.isnan(first[again]) & np.isnan(second))).all(axis=1)
    if other.any():
        _unsteady(check, float(other.mean()))
    return finished(check, output)


def _ask_branches(plan: Plan, ledger: Ledger, actual: np.ndarray, trace: Trace | None, check: Check) -> Asking[Check]:
    """A function that is right on its table is asked what its own comparisons single out. A release has nothing to judge that
    by."""
    function, assignment, table = plan.item, ledger.assignment, ledger.expected.table(plan.item)
    if assignment.solution is None:
        return check
    program = None
    if ledger.backend == "glsl":  # where it is C++, too, its comparisons are known
        program = Program(FUNCTIONS, translated=True)
        trace = (yield Evaluate(function, table.rows, program=program, traced=True)).trace
    if trace is None:
        return check
    known = Known.of(table.rows, trace.first(len(table.rows)))
    found = yield from search(assignment, function, known, program)
    if found.one_way:
        lines = f"{'line' if len(found.one_way) == 1 else 'lines'} {listed([str(line) for line in found.one_way])}"
        said = f"{lines} of {FILES[ledger.backend]}: what is compared there comes out one way for all inputs that were tried"
        check.message = "; ".join(filter(None, [check.message, said + "; this costs nothing"]))
    rows = found.rows
    if not len(rows):
        return check
    longer = yield from with_rows(assignment, function, table, rows)
    rows = longer.rows[len(table.rows) :]
    if not len(rows):
        return check
    table, output = longer, (yield Evaluate(function, rows))
    if output.array is None:
        return without_numbers(plan, ledger, output)
    actual = np.vstack([actual, output.array])
    judgement = _by(plan, ledger, actual, table=table)
    if judgement.check.status == "failed":
        judgement = yield from _without_rounding(plan, ledger, actual, judgement)
    if judgement.check.status == "passed":
        return check
    ledger.judged[function.name] = judgement
    wrong = int(judgement.wrong.sum())
    judgement.check.score = plan.points * credit(0.0)  # no row of the table lies there, so that it is a small place
    judgement.check.message += f"; {wrong} of {len(rows)} inputs that a comparison of your own singles out"
    return judgement.check


def _unsteady(check: Check, share: float) -> None:
    check.status, check.score = "failed", min(check.score, check.max_score * credit(share))
    said = f"gives other numbers for {percent_of(share)} of the inputs when it is asked again in another order"
    check.message = f"{said}: does it keep a state between calls, or read a variable that nothing was stored in?"


def _judge(plan: Plan, ledger: Ledger, actual: np.ndarray) -> Asking[Check]:
    """By the truth; or else by the truth with what the student's own functions gave, of which some are wrong."""
    function = plan.item
    judgement = ledger.judged[function.name] = _by(plan, ledger, actual)
    if judgement.check.status == "failed":
        judgement = ledger.judged[function.name] = yield from _without_rounding(plan, ledger, actual, judgement)
    if judgement.check.status == "passed":
        return judgement.check
    wrong = [
        name
        for name in ledger.expected.facts.calls[function.name]
        if name in ledger.judged and ledger.judged[name].check.status == "failed"
    ]
    other = None  # by the truth with what these give
    for reference in _references(ledger, function) if wrong else []:
        followed = yield from _remembering(ledger, _follow(ledger, function, wrong, reference))
        if followed is None:
            break  # nothing to be right about, in any algebra
        by = _by(plan, ledger, actual, followed)
        if by.check.status == "passed":
            ledger.judged[function.name] = by
            by.check.message = f"right, given what your {listed(wrong)} gives"
            return by.check
        if other is None or by.check.score > other.check.score:
            other = by
    if other is not None and other.check.score > judgement.check.score:
        judgement = ledger.judged[function.name] = other
    right = frozenset(name for name, j in ledger.judged.items() if j.check.status == "passed")
    known = candidates(ledger.expected, function, ledger.backend)
    changed = [] if judgement.followed else hypotheses(ledger.expected, function)
    inner = {} if judgement.followed else ledger.expected.inner(function)
    patient = Patient(function, judgement, actual, known, changed, inner, right)
    found = diagnose_declared(patient)
    if found is None and other is not None and patient.written:
        own = yield from _remembering(ledger, _followed_mistakes(ledger, function, wrong))
        found = diagnose_declared(Patient(function, other, actual, own, [], {}, right))
    found = found or diagnose_by_search(patient)
    check, ignored = judgement.check, []
    if patient.written and (found is None or found.vague):
        ignored = yield from _ignored(ledger, function)
    if ignored:
        check.message += f"; your result does not change with {listed(ignored)}"
    if found is None:
        if patient.written and not ignored:
            check.message += "; not a mistake that the grader knows"
    else:
        ledger.diagnoses[function.name] = found
        check.mistake = found.mistake
        if found.function != function.name and found.function not in wrong:
            check.message += f"; as if {found.function} were wrong inside it"
        if found.said:
            check.message += f"; {found.said}"
        for number, other in enumerate(found.others, 2):
            check.message += f"; mistake {number}: {other.rstrip('.')}"
    return check


def _ignored(ledger: Ledger, function: Function) -> Asking[list[str]]:
    """The inputs that the reference's result changes with and the student's does not."""
    rows = one_by_one(function, ledger.expected.table(function).rows)
    output = yield Evaluate(function, np.concatenate(list(rows.values())))
    if output.array is None:
        return []
    changes = changing(rows, output.array)
    return [path for path in ledger.expected.facts.changes[function.name] if path not in changes]


def _by(
    plan: Plan,
    ledger: Ledger,
    actual: np.ndarray,
    followed: Followed | None = None,
    excused: np.ndarray | None = None,
    table: Table | None = None,
    strays: bool = False,
) -> FunctionJudgement:
    table, floor = table or ledger.expected.table(plan.item), ledger.expected.floor(plan.item, ledger.backend, strays)
    return judge_function(plan.item, ledger.backend, plan.points, table, floor, actual, followed, excused)


def _without_rounding(
    plan: Plan, ledger: Ledger, actual: np.ndarray, judgement: FunctionJudgement
) -> Asking[FunctionJudgement]:
    """The judgement without the rows that the same text has right in double."""
    function, table = plan.item, judgement.table
    # On exact inputs nobody takes another branch by rounding; an exponential, or the driver's own, is a little off there, too.
    exact = exact_rows(function, table.drawn, table.rows) & (judgement.error > OFF)
    asked = may_be_rounding(judgement, exact)
    if asked is None:
        return judgement
    program = Program(DOUBLE, translated=ledger.backend == "glsl")
    output = yield Evaluate(function, renormalised(function, table.rows[asked]), program=program)
    if output.array is None:  # GLSL that is no C++ may stray on single rows as far as other correct programs do
        other = _by(plan, ledger, actual, table=table, strays=True)
        return other if other.check.status == "passed" else judgement
    in_double = actual.astype(np.float64)
    in_double[asked] = output.array
    right = ~_by(plan, ledger, in_double, table=table).wrong
    excused = asked & right
    if not excused.any():
        return judgement
    other = _by(plan, ledger, actual, excused=excused, table=table)
    if other.check.status == "passed":
        other.check.message = f"{percent_of(float(excused.mean()))} of the inputs are right in double arithmetic only"
    return other


# ------------------------------------------------------------------------------------------------- follow-through


def _solution(ledger: Ledger) -> FollowedSolution:
    """With all that is known to be right or wrong, compiled together once for all functions."""
    changes = load_changes(ledger.assignment)
    return FollowedSolution(ledger.assignment, [*changes.variant, *changes.mistake])


def _references(ledger: Ledger, function: Function) -> list[FollowedSolution]:
    """The solution, and the correct programs that compute this function another way: on top of a wrong callee these differ. A
    release has no solution, and no follow-through."""
    if ledger.assignment.solution is None or function.name in ledger.untouched:
        return []
    solution = _solution(ledger)
    variants = load_changes(ledger.assignment).variant
    return [solution, *(solution.as_if(v) for v in variants if function.name in v.bodies_for("cpp"))]


def _remembering(ledger: Ledger, asking: Asking[T]) -> Asking[T]:
    """Asks the student's functions for no inputs twice: one reference calls them much as another does."""
    answer = None
    while True:
        try:
            question = asking.send(answer)
        except StopIteration as end:
            return end.value
        if question.program is not None:
            answer = yield question
            continue
        known = ledger.answered.setdefault(question.function.name, {})
        keys = [row.tobytes() for row in np.ascontiguousarray(question.rows, np.float32)]
        new = np.array([key not in known for key in keys])
        answer = Output(array=np.empty((0, len(question.function.outputs)), np.float32))
        if new.any():
            answer = yield replace(question, rows=question.rows[new])
        if answer.array is not None:
            known.update(zip([key for key, asked in zip(keys, new) if asked], answer.array))
            answer = replace(answer, array=np.array([known[key] for key in keys]))


def _follow(
    ledger: Ledger, function: Function, wrong: list[str], reference: FollowedSolution
) -> Asking[Followed | None]:
    """The reference with the outputs of the student's functions that are wrong, and how far rounding of the inputs moves it: a
    wrong function may be wilder than the right one. None when this asks for nothing."""
    callees = [ledger.assignment.function(name) for name in wrong]
    table = ledger.expected.table(function)
    exact = renormalised(function, table.rows)
    # Wider than the truth's own: the arguments of the calls were rounded on their way, too.
    inputs = np.concatenate([exact, *jittered(function, exact, units=2.0)])
    results = yield from reference.with_recorded(function, inputs, callees)
    if results is None:
        return None
    followed, *moved = results.reshape(-1, *table.truth.shape)
    if not informative(followed):
        return None
    with np.errstate(invalid="ignore"):
        conditioning = np.nan_to_num(np.abs(np.array(moved) - followed), nan=np.inf).max(axis=0)
    not_finite = any(not np.isfinite(ledger.outputs[name]).all() for name in wrong)
    return Followed(followed, np.maximum(conditioning, table.conditioning), not_finite)


def _followed_mistakes(ledger: Ledger, function: Function, wrong: list[str]) -> Asking[list[Candidate]]:
    """The function's own mistakes, on top of those of the functions that it calls."""
    out, solution = [], _solution(ledger)
    callees = [ledger.assignment.function(name) for name in wrong]
    exact = renormalised(function, ledger.expected.table(function).rows)
    for change in load_changes(ledger.assignment).mistake:
        if change.function == function.name:
            results = yield from solution.as_if(change).with_recorded(function, exact, callees)
            if results is not None:
                out.append(Candidate(change.id, change.function, change.hint, results))
    return out
