"""Whether the code compiles, and what the compiler says of it. It has no points: it explains what is skipped, and a warning
costs nothing by itself."""

from collections.abc import Generator

from shadelab.course.assignment import Assignment
from shadelab.grading.plan import Plan
from shadelab.grading.questions import Build, Built
from shadelab.result import Check

NAME = "build"
STAGE = 0
TOGETHER = True
DRAWS = False
REPLAY = ""
BOTH = False


def items(assignment: Assignment) -> list[tuple]:
    return []  # plan_checks puts it before the others of its language


def judge(plan: Plan, ledger: object) -> Generator[Build, Built, Check]:
    built = yield Build()
    return plan.check("failed", built.failure) if built.failure else plan.check("passed", built.warnings)
