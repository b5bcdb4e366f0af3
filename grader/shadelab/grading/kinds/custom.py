"""What no declaration can say: the assignment's pytest functions, in a child of their own (session.py)."""

from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Scene
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence.tasks import Asking, Draw, Evaluate, Output, Program
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.grading.session import Session, Verdict
from shadelab.machine import renderer
from shadelab.machine.build import Recipe
from shadelab.machine.sandbox import OUTPUT_KEPT
from shadelab.result import Check
from shadelab.truth.expected import TERM_CHANNELS, with_callees

NAME = "custom"
STAGE = 3
TOGETHER = False  # the child runs one after the other
DRAWS = False
REPLAY = ""
BOTH = False

STUDENT_SECONDS = 60.0  # of one check; each single run has its own limit besides


def items(assignment: Assignment) -> list[tuple]:
    return [(check.name, check.points, check) for check in assignment.custom]


def judge(plan: Plan, ledger: Ledger) -> Asking[Check]:
    if ledger.session is None:
        checks = [plan.item.name for plan in ledger.plans if plan.kind == NAME]
        ledger.session = Session(
            ledger.assignment, ledger.backend, ledger.expected.folder, ledger.folder / "custom", ledger.stop, checks
        )  # fmt: skip
    session, used = ledger.session, _Used()
    while True:
        said = session.next_line(plan.item.name)
        if isinstance(said, Verdict):
            return _of_verdict(plan, said, used)
        if used.seconds > STUDENT_SECONDS:
            session.reply(wrong=f"your code took more than {STUDENT_SECONDS:g} s in this check")
            continue
        try:
            answer = yield from (_evaluated if said["ask"] == "evaluate" else _drawn)(said, ledger, used)
        except (UserError, InfrastructureError) as error:  # of the check: it asks for what is not there
            answer = {"fault": str(error), "user": isinstance(error, UserError)}
        session.reply(**answer)


class _Used:
    """What the student's code has used in one check."""

    def __init__(self) -> None:
        self.seconds, self.printed = 0.0, ""

    def add(self, output: Output) -> Output:
        self.seconds += output.seconds
        self.printed = (self.printed + output.printed)[:OUTPUT_KEPT]
        return output


def _evaluated(said: dict[str, Any], ledger: Ledger, used: _Used) -> Asking[dict[str, Any]]:
    function = ledger.assignment.function(said["function"])
    if waits := _waits(ledger, {function.name}):
        return {"waits": waits}
    rows = np.load(said["rows"], allow_pickle=False)
    output = used.add((yield Evaluate(function, rows)))
    return _array(output.array, f"{function.name} {output.failure}", Path(said["rows"]))


def _drawn(said: dict[str, Any], ledger: Ledger, used: _Used) -> Asking[dict[str, Any]]:
    """One of the assignment's scenes, which the grading may have drawn, or another file."""
    name = said.get("scene")
    if name is not None and ledger.pictures.file(ledger.backend, name).exists():
        return {"array": str(ledger.pictures.file(ledger.backend, name))}
    if name is not None and name in ledger.undrawn:
        return {"wrong": f"{name}: the render {ledger.undrawn[name]}"}
    if name is not None:
        scene = next(s for s in ledger.assignment.public_scenes if s.name == name)
    else:
        scene = Scene(Path(said["file"]).stem, Path(said["file"]), ledger.assignment.directory)
    if missing := scene.missing_meshes():
        raise InfrastructureError(f"the mesh {missing[0].name} is not on this machine")
    facts, described = ledger.expected.facts, scene.described
    if waits := _waits(ledger, with_callees(set(described.calls), facts.calls)):
        return {"waits": waits}
    packet = None
    if ledger.backend == "glsl" and name is not None:
        packet = ledger.expected.packet(scene)
    elif ledger.backend == "glsl":
        packet = Path(said["file"]).with_suffix(".packet")
        renderer.packet(scene.file, scene.assignment, packet, renderer.View("terms"))
    # As the grading has compiled the loops, if these suffice.
    loops = tuple(sorted({*facts.loops, *described.needs.loops}))
    program = Program(Recipe(functions=False, loops=loops))
    output = used.add((yield Draw(scene, packet, program=program)))
    array, failure = output.array, output.failure
    if array is not None and array.shape != (described.height, described.width, TERM_CHANNELS):
        array, failure = None, f"gave an image of another size: {array.shape}"
    return _array(array, f"{scene.name}: the render {failure}", ledger.folder / "custom" / f"{scene.name}-drawn.npy")


def _array(array: np.ndarray | None, failure: str, file: Path) -> dict[str, Any]:
    if array is None:
        return {"wrong": failure}
    np.save(file, array)
    return {"array": str(file)}


def _waits(ledger: Ledger, functions: set[str]) -> list[str]:
    """The checks of these functions that did not end: the check waits for them."""
    hung = [id.split("/")[-1] for id in ledger.hung]
    return [f"{ledger.backend}/function/{name}" for name in hung if name in functions]


def _of_verdict(plan: Plan, verdict: Verdict, used: _Used) -> Check:
    if verdict.status == "error":
        return plan.our_fault(InfrastructureError(verdict.message))
    check = plan.check(verdict.status, verdict.message, verdict.needs)
    check.score = plan.points if verdict.status == "passed" else 0.0
    check.seconds, check.printed = round(verdict.seconds, 4), used.printed
    return check
