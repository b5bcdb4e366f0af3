"""Of each scene: its packet, its truth from the solution in double, and how far correct programs are from it."""

import numpy as np

from shadelab.course.assignment import Assignment, Scene, named_arrays
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Draw
from shadelab.machine import renderer
from shadelab.machine.build import Recipe
from shadelab.result import FRAMES
from shadelab.truth.expected import INTERIOR, SceneTruth, largest_nearby
from shadelab.truth.fragments import as_float
from shadelab.truth.measures import FULL_MARKS, image_limit, pixel_error, render_of, violating_share
from shadelab.truth.programs import ProgramImages
from shadelab.truth.workshop import PLAIN, Workshop

SHIFTS = [(1 / 16, 0.0), (0.0, 1 / 16)]  # pixels: as far as rasterizers may place a fragment differently


def packet_file(workshop: Workshop, scene: Scene):
    return workshop.folder / f"{scene.name}.packet"


def make_packet(workshop: Workshop, scene: Scene) -> None:
    with workshop.step(scene.name):
        renderer.packet(scene.file, scene.assignment, packet_file(workshop, scene), renderer.View("terms"))


def make_truth(workshop: Workshop, scene: Scene, double: CppRunner) -> SceneTruth:
    [drawn] = workshop.outputs(double, [Draw(scene, layers="all", frames=FRAMES)])
    described = scene.described
    truth = SceneTruth.of(drawn.array, as_float(described.eye), described.fov_y / described.height)
    truth.facts.runs.append(render_of(f"{PLAIN}, C++ double", np.zeros(1), drawn.frames).model_dump())
    truth.facts.lights = [_light(workshop.assignment, numbers) for numbers in described.lights]
    return truth


def _light(assignment: Assignment, numbers: np.ndarray) -> dict:
    """The members of a Light by name, its kind's name, and whether it has a position."""
    named = named_arrays(assignment.structs["Light"].columns, as_float(numbers)[None])
    kind = assignment.light_kinds[int(numbers[0])]
    return {name: value[0].tolist() for name, value in named.items()} | {
        "name": kind.name,
        "placed": "position" in kind.members,
    }


def finish_scene(
    workshop: Workshop, scene: Scene, truth: SceneTruth, recipe: Recipe, programs: list[ProgramImages]
) -> None:
    """Noise and spread of one scene, and where the solution stands in error against run time. recipe: of the truth."""
    moved = workshop.outputs(
        workshop.solution(recipe), [Draw(scene, layers="total", shift=shift) for shift in SHIFTS], "a shift"
    )
    for output in moved:
        truth.noise = np.maximum(truth.noise, np.abs(output.array[..., :3] - truth.total).max(axis=2))
    truth.noise = largest_nearby(truth.noise).astype(np.float32)
    interior = truth.mask == INTERIOR
    errors = {}
    for program in programs:
        total = program.total(scene)
        errors[program.name] = pixel_error(total, truth)[interior]
        if program.name.startswith(PLAIN) and "fused" not in program.name:
            off = total.astype(np.float64) - truth.total
            truth.facts.runs.append(render_of(program.name, off, program.frames[scene.name]).model_dump())
    if interior.any():
        truth.facts.spread = {name: float(np.quantile(e, 1 - FULL_MARKS)) for name, e in errors.items()}
        # Each by the limits that the others set.
        for program in programs:
            others = [floor for name, floor in truth.facts.spread.items() if name != program.name]
            limit = image_limit(truth, max(others, default=0.0))
            share = violating_share(program.total(scene), truth.total, limit, interior)
            truth.facts.share = max(truth.facts.share, share)
    truth.save(workshop.folder / f"{scene.name}.npz")
