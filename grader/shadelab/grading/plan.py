"""One check that is to be made."""

from dataclasses import dataclass

from shadelab.course.assignment import Function, Scene
from shadelab.course.checks import CustomCheck
from shadelab.result import Check


@dataclass(frozen=True)
class Plan:
    id: str
    kind: str  # the name of its module in grading/kinds
    backend: str
    points: float
    item: Function | Scene | CustomCheck | None = None  # None: the build

    def check(self, status: str, message: str = "", needs: list[str] | None = None) -> Check:
        """One without marks: a build, or a check that failed or was skipped before there were numbers to judge."""
        built = [] if self.item is None else [f"{self.backend}/build"]
        return Check(
            id=self.id, kind=self.kind, backend=self.backend, status=status, score=0.0, max_score=self.points,
            message=message, needs=[*built, *(needs or [])], hidden=isinstance(self.item, Scene) and self.item.hidden,
        )  # fmt: skip

    def our_fault(self, error: Exception) -> Check:
        return self.check("error", f"not the submission's fault: {error}")
