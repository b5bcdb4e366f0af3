"""What has been found so far in one language: later checks rest on earlier ones, and not on one another's insides."""

import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.grading.pictures import PictureFolder
from shadelab.grading.plan import Plan
from shadelab.judge.diagnosis import Diagnosis
from shadelab.judge.functions import FunctionJudgement
from shadelab.result import Check
from shadelab.truth.expected import Expected


@dataclass
class Ledger:
    backend: str
    assignment: Assignment
    expected: Expected
    pictures: PictureFolder  # what was drawn
    timed: bool  # whether the time of a frame is measured more than once
    submission: Path
    folder: Path  # for files of this language's checks
    stop: threading.Event  # set when the user interrupts
    plans: list[Plan]  # what is to be checked, the build first
    untouched: set[str] = field(default_factory=set)  # functions that are the starter's still
    checks: dict[str, Check] = field(default_factory=dict)  # those that have their verdict, by id
    outputs: dict[str, np.ndarray] = field(default_factory=dict)  # by function: what came on its table
    # By function: what came for arguments with which a reference calls it (their float32 bytes).
    answered: dict[str, dict[bytes, np.ndarray]] = field(default_factory=dict)
    judged: dict[str, FunctionJudgement] = field(default_factory=dict)
    diagnoses: dict[str, Diagnosis] = field(default_factory=dict)
    hung: set[str] = field(default_factory=set)  # ids of checks in which a function did not end
    followed: dict[str, np.ndarray] | None = (
        None  # by scene: what the wrong functions make of the reference (kinds/image.py)
    )
    undrawn: dict[str, str] = field(default_factory=dict)  # scene -> why it gave no picture
    session: object = None  # of custom checks: the child that runs them, between one check and the next

    def failed(self, id: str) -> bool:
        return id in self.checks and self.checks[id].status == "failed"

    def hung_ids(self, functions: set[str]) -> list[str]:
        """The checks of those among these functions that did not end."""
        return sorted(self.hung & {f"{self.backend}/function/{name}" for name in functions})
