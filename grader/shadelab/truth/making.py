"""Makes the expected data of an assignment from its solution: the truth in double, what correct programs differ by, and what the
declared mistakes give. No student's code takes part."""

import fcntl
import json
import os
import shutil
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.course.mistakes import load_changes
from shadelab.machine.build import Recipe
from shadelab.paths import SHIPPED, kept
from shadelab.truth.digest import digest
from shadelab.truth.driver import measure_driver
from shadelab.truth.expected import TABLE, Expected, Facts
from shadelab.truth.function_tables import make_tables, on_what
from shadelab.truth.hypotheses import make_hypotheses
from shadelab.truth.programs import Spread, correct_programs, record_mistakes, run_program
from shadelab.truth.scenes import finish_scene, make_packet, make_truth
from shadelab.truth.stable_tables import make_stable_tables
from shadelab.truth.workshop import Progress, Workshop

PUBLIC_SEED = 6837


def load(assignment: Assignment, progress: Progress = lambda *_: None) -> Expected:
    """The expected data: that of a release, or else made for the present solution and scenes unless it is there. Hidden
    scenes are drawn."""
    draw_hidden_scenes(assignment.hidden, assignment.directory, assignment.name)
    if (SHIPPED / assignment.name / "done").exists():
        return Expected(SHIPPED / assignment.name)
    name = digest(assignment)
    folder = kept("expected", assignment.name, name)
    if not (folder / "done").exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with open(folder.parent / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # whoever wants the same waits for it
            if not (folder / "done").exists():
                make(assignment, folder, name, progress)
    if os.access(folder, os.W_OK):
        os.utime(folder)  # its age counts from the last use
    return Expected(folder)


def make(assignment: Assignment, folder: Path, name: str, progress: Progress) -> None:
    # Its own: two runs may make the same data at once, where the file system knows no locks.
    scratch = Path(tempfile.mkdtemp(prefix="making-", dir=folder.parent))
    try:
        make_all(assignment, scratch, progress)
        shutil.rmtree(scratch / "work")
        scratch.chmod(0o755)  # whoever else uses this checkout may read it
        (scratch / "done").write_text(name + "\n")
        try:
            scratch.rename(folder)
        except OSError:  # another run was faster, or one was cut off before it was done
            if (folder / "done").exists():
                return
            shutil.rmtree(folder)
            scratch.rename(folder)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    # Older data of this assignment serves nobody for long: its digest will not come back. A run may still be reading it.
    for other in folder.parent.iterdir():
        try:
            unused = time.time() - other.stat().st_mtime
        except FileNotFoundError:
            continue
        if other.is_dir() and other != folder and unused > 3600:
            shutil.rmtree(other, ignore_errors=True)


def make_all(assignment: Assignment, folder: Path, progress: Progress) -> None:
    """All files of the expected data, but for `done`."""
    changes = load_changes(assignment)
    scenes = [scene for scene in assignment.scenes if not scene.missing_meshes()]
    workshop = Workshop(assignment, folder, 2 * len(changes.variant) + 9 + len(scenes), progress)
    for scene in scenes:
        make_packet(workshop, scene)
    loops = tuple(sorted({loop for scene in scenes for loop in scene.described.needs.loops}))
    in_double = Recipe(double=True, functions=False, loops=loops)
    double = workshop.solution(in_double)
    truths = {scene.name: make_truth(workshop, scene, double) for scene in scenes}
    tables, calls, recorded = make_tables(workshop, scenes, truths, PUBLIC_SEED)
    cases = make_stable_tables(workshop, PUBLIC_SEED)
    driver = measure_driver(workshop)
    # Function by function and scene by scene, what other correct programs and the mistakes give: two at a time.
    spread = Spread.of(assignment)
    with ThreadPoolExecutor(2) as pool:
        mistakes = pool.map(lambda backend: record_mistakes(workshop, changes, tables, calls, backend), ("cpp", "glsl"))
        programs = correct_programs(changes)
        drawn = list(pool.map(lambda program: run_program(workshop, program, tables, scenes, loops, spread), programs))
        mistaken = {key: array for arrays in mistakes for key, array in arrays.items()}
    np.savez_compressed(folder / "mistakes.npz", **mistaken)
    np.savez_compressed(folder / "hypotheses.npz", **make_hypotheses(workshop, tables, calls))
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda scene: finish_scene(workshop, scene, truths[scene.name], in_double, drawn), scenes))
    hints = [{"id": m.id, "function": m.function, "hint": m.hint} for m in changes.mistake]
    facts = Facts(
        calls,
        list(loops),
        spread.errors,
        spread.farthest,
        hints,
        spread.gl,
        on_what(workshop, tables),
        recorded,
        cases,
        driver,
    )
    (folder / "facts.json").write_text(json.dumps(asdict(facts), indent=1))
    arrays = {"drawn": np.array(next(iter(tables.values())).drawn)}
    for name, table in tables.items():
        for part in TABLE:
            arrays[f"{name}.{part}"] = getattr(table, part)
    np.savez(folder / "functions.npz", **arrays)
