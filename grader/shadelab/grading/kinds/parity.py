"""Where the two languages disagree. Without points."""

from shadelab.course.assignment import Assignment
from shadelab.evidence.tasks import Asking
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.judge.parity import judge_parity
from shadelab.result import Check

NAME = "parity"
STAGE = 4
TOGETHER = True
DRAWS = False
REPLAY = "eval"
BOTH = True


def items(assignment: Assignment) -> list[tuple]:
    return [(f.name, 0.0, f) for f in assignment.functions if f.graded]


def judge(plan: Plan, ledgers: dict[str, Ledger]) -> Asking[Check]:
    name = plan.item.name
    judged = {backend: ledger.judged.get(name) for backend, ledger in ledgers.items()}
    # What is right given something wrong differs with that, and says nothing of its own.
    plain = {backend: j for backend, j in judged.items() if j is not None and not j.followed}
    passed = [b for b, j in plain.items() if j.check.status == "passed"] if len(plain) == len(ledgers) else []
    if not passed or any(name not in ledger.outputs for ledger in ledgers.values()):
        needs = [f"{backend}/function/{name}" for backend in ledgers]
        return plan.check("skipped", "neither language has it right yet" if not passed else "", needs)
    expected = next(iter(ledgers.values())).expected
    floors = sum(expected.floor(plan.item, backend) for backend in ledgers)
    outputs = [ledger.outputs[name] for ledger in ledgers.values()]
    return judge_parity(plan.item, expected.table(plan.item), floors, *outputs, passed)
    yield  # it asks nothing: the numbers are there
