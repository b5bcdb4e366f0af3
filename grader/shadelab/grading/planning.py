"""What is to be checked of a submission: every kind of check says it for itself."""

from collections.abc import Collection
from fnmatch import fnmatch
from types import ModuleType

from shadelab.course.assignment import Assignment
from shadelab.grading.kinds import KINDS, build
from shadelab.grading.plan import Plan
from shadelab.words import BACKENDS


def plan_checks(assignment: Assignment, only: str | Collection[str] = "*") -> dict[str, list[Plan]]:
    """Per backend, in the order of the data flow; under "both" what is asked of the two together. Points are halved between
    the languages.

    A backend of which a check is wanted is built; the build's own check stands first. only: ids, or shell patterns for them.
    """
    patterns = [only] if isinstance(only, str) else only

    def is_wanted(plan: Plan) -> bool:
        return any(fnmatch(plan.id, pattern) for pattern in patterns)

    def planned(kind: ModuleType, backend: str) -> list[Plan]:
        items = kind.items(assignment)
        plans = [
            Plan(f"{backend}/{kind.NAME}/{name}", kind.NAME, backend, points / 2, item) for name, points, item in items
        ]
        return [plan for plan in plans if is_wanted(plan)]

    plans: dict[str, list[Plan]] = {}
    for backend in BACKENDS:
        first = Plan(f"{backend}/{build.NAME}", build.NAME, backend, 0.0)
        wanted = [plan for kind in KINDS if not kind.BOTH for plan in planned(kind, backend)]
        plans[backend] = [first, *wanted] if wanted or is_wanted(first) else []
    if all(plans.values()):
        plans["both"] = [plan for kind in KINDS if kind.BOTH for plan in planned(kind, list(BACKENDS)[-1])]
    return plans
