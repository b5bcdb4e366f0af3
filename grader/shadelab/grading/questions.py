"""What checks ask beside Evaluate and Draw, and how a check takes over what is known of a run."""

from dataclasses import dataclass

from shadelab.evidence.tasks import Output
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.result import Check


@dataclass(frozen=True)
class Build:
    """Compile the submission. The answer is a Built."""


@dataclass(frozen=True)
class Built:
    failure: str = ""  # what is wrong with the student's code; empty: it compiles
    warnings: str = ""  # what the compiler says of code that compiles


def finished(check: Check, output: Output) -> Check:
    check.seconds = round(output.seconds, 4)
    check.printed = output.printed
    if output.first_not_finite:
        check.message += f"; {output.first_not_finite}"
    if output.unset and check.status == "failed":
        check.message = f"{output.unset}; {check.message}"  # what follows is a consequence
    return check


def without_numbers(plan: Plan, ledger: Ledger, output: Output) -> Check:
    """The check of a function that did not give any."""
    if output.hung:
        ledger.hung.add(plan.id)
    return finished(plan.check("failed", f"{plan.item.name} {output.failure}"), output)
