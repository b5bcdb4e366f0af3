"""What checks ask beside Evaluate and Draw, and how a check takes over what is known of a run."""

from dataclasses import dataclass

from shadelab.evidence.tasks import Output
from shadelab.result import Check


@dataclass(frozen=True)
class Build:
    """Compile the submission. The answer: None, or what is wrong."""


def finished(check: Check, output: Output) -> Check:
    check.seconds = round(output.seconds, 4)
    check.printed = output.printed
    if output.first_not_finite:
        check.message += f"; {output.first_not_finite}"
    return check
