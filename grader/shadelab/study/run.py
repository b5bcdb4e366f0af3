"""Runs a study: dispatches on its kind, and puts together what comes out as JSON and as CSV."""

import csv
import io
from collections.abc import Callable
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

from shadelab.course.assignment import Assignment, Scene, assignment_names, load_assignment
from shadelab.machine.processor import processor_level
from shadelab.machine.sandbox import work_folder
from shadelab.measure.machine import describe_machine
from shadelab.measure.timing import Progress
from shadelab.paths import SOLUTION, shown
from shadelab.study.backends import measure_backends
from shadelab.study.declaration import Sampling, Study, declared_scene, studied, sub_model
from shadelab.study.interpolation import measure_interpolation
from shadelab.study.points import Part
from shadelab.study.sampling import measure_sampling, scene_name
from shadelab.study.timing import Workbench

SCHEMA = "shadelab/study/1"
AssignmentOf = Callable[[Path], Assignment]


def run_study(
    what: str, student: Path | None, assignment_of: AssignmentOf, progress: Progress
) -> tuple[dict[str, Any], list[Part]]:
    """`what`: a scene's file, a study's or an assignment's name. Returns the JSON, and the parts that figures are drawn of."""
    name, study, scene = studied(what, assignment_names())
    with work_folder("study") as folder:
        work = Workbench(folder, progress, student.resolve() if student else None)
        parts = measured(name, study, scene, assignment_of, work)
        for part in parts:
            part.mark_front()
        machine = {
            **describe_machine(),
            "threads": work.stand.threads,
            "level": processor_level(),
            "gl": sorted(work.drivers),
        }
    return as_json(name, study, parts, machine, student), parts


def measured(name: str, study: Study, scene: Path | None, assignment_of: AssignmentOf, work: Workbench) -> list[Part]:
    if scene is not None:  # the default study of a scene
        assignment = assignment_of(scene)
        spec = Sampling(scene=str(scene))
        # Of single frames, which are short, there are more.
        update = {"repeats": 2 * study.repeats + 1, "title": f"Backends and leaving out: {scene.stem}"}
        backends = study.model_copy(update=update)
        one = [(assignment, Scene(scene.stem, scene.resolve(), assignment.directory))]
        return [
            measure_sampling(study, spec, work, scene.resolve(), assignment),
            measure_backends(backends, work, one, "backends", scene_name(scene.resolve())),
        ]
    if study.kind == "sampling":
        file = declared_scene(study.sampling.scene, name)
        part = measure_sampling(study, study.sampling, work, file, assignment_of(file))
        part.name, part.title = name, study.title
        return [part]
    if study.kind == "interpolation":
        return [measure_interpolation(study, study.interpolation, work, name)]
    if study.kind == "backends":
        spec = study.backends
        declared = [load_assignment(SOLUTION / each) for each in spec.assignments]
        scenes = [(assignment, each) for assignment in declared for each in assignment.public_scenes]
        files = [declared_scene(each, name) for each in spec.scenes]
        scenes += [(own := assignment_of(file), Scene(file.stem, file, own.directory)) for file in files]
        return [measure_backends(study, work, scenes, name, ", ".join([*spec.assignments, *spec.scenes]))]
    from shadelab.study.forms import Forms, measure_forms

    return measure_forms(study, sub_model(Forms, study.forms, name, "forms"), work, name)


def as_json(
    name: str, study: Study, parts: list[Part], machine: dict[str, Any], student: Path | None
) -> dict[str, Any]:
    described = [part.as_json() for part in parts]
    return {
        "schema": SCHEMA, "name": name, "title": study.title, "kind": study.kind, "scene": parts[0].scene,
        "shading": shown(student) if student else "solution",
        "machine": machine, "date": date.today().isoformat(), "repeats": study.repeats, "seed": study.seed,
        "reference": described[0]["reference"], "noise": described[0]["noise"],
        "points": [{"part": part.name, **asdict(point)} for part in parts for point in part.points],
        "slopes": [{"part": part.name, **slope} for part, each in zip(parts, described) for slope in each["slopes"]],
        "leaving_out": [entry for part in parts for entry in part.leaving_out],
        "claims": [claim for part in parts for claim in part.claims],
        "skipped": [line for part in parts for line in part.skipped],
        "parts": described,
    }  # fmt: skip


def as_csv(result: dict[str, Any]) -> str:
    """A row for each point; a column for each member of a knob."""
    knobs = list(dict.fromkeys(key for point in result["points"] for key in point["knob"]))
    errors = list(dict.fromkeys(key for point in result["points"] for key in point["error"]))
    times = ["median", "min", "max", "runs"]
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(["part", "series", *knobs, *errors, *(f"seconds_{t}" for t in times[:3]), "runs", "front"])
    for point in result["points"]:
        seconds = point["seconds"] or {}
        values = [point["knob"].get(k, "") for k in knobs] + [point["error"].get(e, "") for e in errors]
        values += [seconds.get(t, "") for t in times]
        table.writerow([point["part"], point["series"], *values, int(point["front"])])
    return out.getvalue()
