"""Whether the code compiles. It has no points: it explains what is skipped."""

from collections.abc import Generator

from shadelab.course.assignment import Assignment
from shadelab.grading.plan import Plan
from shadelab.grading.questions import Build
from shadelab.result import Check

NAME = "build"
STAGE = 0
TOGETHER = True
DRAWS = False
REPLAY = ""
BOTH = False


def items(assignment: Assignment) -> list[tuple]:
    return []  # plan_checks puts it before the others of its language


def judge(plan: Plan, ledger: object) -> Generator[Build, str | None, Check]:
    failure = yield Build()
    return plan.check("failed", failure) if failure else plan.check("passed")
