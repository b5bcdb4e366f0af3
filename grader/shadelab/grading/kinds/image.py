"""One scene, drawn with the student's functions."""

import numpy as np

from shadelab.course.assignment import Assignment, Scene
from shadelab.evidence.tasks import Asking, Draw, Output
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.grading.questions import finished
from shadelab.judge.images import Sampled, is_followed, judge_image
from shadelab.result import FRAMES, Check, Render
from shadelab.truth.expected import TERM_CHANNELS, with_callees
from shadelab.truth.follow import FollowedSolution
from shadelab.truth.measures import render_of
from shadelab.words import listed

NAME = "image"
STAGE = 2  # functions first: a scene whose model never ends would only use up the time again
TOGETHER = True
DRAWS = True
REPLAY = "render"
BOTH = False


def items(assignment: Assignment) -> list[tuple]:
    return [(scene.name, scene.points, scene) for scene in assignment.scenes]


def judge(plan: Plan, ledger: Ledger) -> Asking[Check]:
    scene: Scene = plan.item
    if missing := scene.missing_meshes():
        message = f"the mesh {missing[0].name} is not on this machine (./shadelab doctor says how to get it)"
        check = plan.check("skipped", message)
        check.max_score = 0.0  # nobody loses points for a mesh that could not be fetched
        return check
    used = functions_used(scene, ledger)
    if waiting := ledger.hung_ids(used):
        return plan.check("skipped", f"{waiting[0].split('/')[-1]} did not end in its own check", waiting)
    frames = FRAMES if ledger.timed else 1
    output = yield Draw(scene, ledger.expected.packet(scene), frames=frames)
    check = _judge(plan, ledger, output)
    if check.status == "failed":
        followed = output.array is not None and (yield from _follow(check, ledger, scene, used, output.array))
        _blame(check, ledger, scene, used, followed)
    return finished(check, output)


def functions_used(scene: Scene, ledger: Ledger) -> set[str]:
    """The functions that a scene is drawn with: those of the assignment's that the framework calls, and what these call."""
    own = {f.name for f in ledger.assignment.functions}
    return with_callees(own & set(scene.described.calls), ledger.expected.facts.calls)


def _judge(plan: Plan, ledger: Ledger, output: Output) -> Check:
    scene = plan.item
    truth = ledger.expected.scene(scene)
    if ledger.pictures.keeps(scene):
        ledger.pictures.keep_truth(ledger.expected.folder, scene.name)
    layers, shape = output.array, (*truth.total.shape[:2], TERM_CHANNELS)
    if layers is None or layers.shape != shape:
        failure = output.failure or f"gave an image of another size: {layers.shape}"
        ledger.undrawn[scene.name] = failure
        if ledger.pictures.keeps(scene):
            ledger.pictures.keep(ledger.backend, scene.name, None, failed=True)
        return plan.check("failed", f"{scene.name}: the render {failure}")
    check = judge_image(scene, ledger.backend, plan.points, truth, layers)
    if ledger.assignment.custom and not scene.hidden:  # custom checks ask for pictures, too
        ledger.pictures.save(ledger.backend, scene.name, layers)
    elif ledger.pictures.keeps(scene):
        ledger.pictures.keep(ledger.backend, scene.name, layers, check.status == "failed")
    check.runs = [Render(**run) for run in truth.facts.runs]
    off = layers[..., :3].astype(np.float64) - truth.total
    if output.frames and np.isfinite(off).all():
        check.runs.insert(0, render_of("yours", off, output.frames))
    return check


# ------------------------------------------------------------------------------------------------- follow-through


def _follow(check: Check, ledger: Ledger, scene: Scene, used: set[str], layers: np.ndarray) -> Asking[bool]:
    """A picture that the student's wrong functions make of the reference loses the share of its points that these functions
    lost of theirs: a mistake costs its own share of each picture, and no more."""
    if not _wrong(ledger, used) or ledger.untouched & set(scene.described.calls):
        return False
    if ledger.followed is None:
        ledger.followed = yield from _all_followed(ledger)
    truth, total = ledger.expected.scene(scene), ledger.followed.get(scene.name)
    if total is None or layers.shape[:2] != truth.total.shape[:2]:
        return False
    if not is_followed(truth, layers, Sampled.of(scene), total):
        return False
    checks = [ledger.judged[name].check for name in used if name in ledger.judged]
    share = sum(c.score for c in checks) / max(sum(c.max_score for c in checks), 1e-9)
    finite = np.isfinite(layers[..., :3]).all()
    check.score = max(check.score, check.max_score * min(share, 1.0 if finite else 0.5))
    return True


def _all_followed(ledger: Ledger) -> Asking[dict[str, np.ndarray]]:
    """Of all scenes at once, since it takes about as long as of one. A release has no solution, and follows nothing."""
    wrong = [ledger.assignment.function(name) for name in _wrong(ledger, set(ledger.judged))]
    scenes = [plan.item for plan in ledger.plans if plan.kind == NAME and not plan.item.missing_meshes()]
    scenes = [scene for scene in scenes if not ledger.untouched & set(scene.described.calls)]
    scenes = [scene for scene in scenes if _wrong(ledger, functions_used(scene, ledger))]
    if ledger.assignment.solution is None or not scenes:
        return {}
    sampled = [Sampled.of(scene) for scene in scenes]
    followed = FollowedSolution(ledger.assignment, loops=ledger.expected.facts.loops)
    drawn = yield from followed.drawn(scenes, [s.size for s in sampled], [s.shift for s in sampled], wrong)
    return {name: image[..., :3] for name, image in (drawn or {}).items()}


def _wrong(ledger: Ledger, used: set[str]) -> list[str]:
    """In the order of the data flow."""
    judged = [f.name for f in ledger.assignment.functions if f.name in used and f.name in ledger.judged]
    return [name for name in judged if ledger.judged[name].check.status == "failed"]


# --------------------------------------------------------------------------------------------------- what is to blame


def _blame(check: Check, ledger: Ledger, scene: Scene, used: set[str], followed: bool) -> None:
    """Of the functions that the scene draws with, the first that is wrong on what the scene asks explains the picture."""
    wrong = _wrong(ledger, used)
    if scene.name in ledger.expected.facts.recorded:
        number = ledger.expected.facts.recorded.index(scene.name)
        here = [
            name for name in wrong if (ledger.judged[name].wrong & (ledger.judged[name].table.scenes == number)).any()
        ]
        wrong = here or wrong  # of a scene's fragments a table holds some
    named = [name for name in wrong if name in ledger.diagnoses]
    if named:
        check.mistake = ledger.diagnoses[named[0]].mistake
    check.because = [f"{ledger.backend}/function/{name}" for name in wrong]
    checked = {f.name for f in ledger.assignment.functions if f.graded} & used
    if not wrong and checked and checked <= set(ledger.judged):
        check.message += "; its functions are right by themselves: does one keep a state, or ask which pixel it is?"
    if check.because:
        names = [id.split("/")[-1] for id in check.because]
        check.message += f"; it is drawn with {listed(names)}, which {'is' if len(names) == 1 else 'are'} wrong"
        check.message += ", and right apart from that" if followed else ""
