"""Mistakes that nobody declared, from public threads, textbooks and classrooms (tests/undeclared), and correct programs in other
algebra. They were written before the search that is to explain them, and by somebody who had not seen the grader.

    right = "regex"     the part of what is told that a teacher would call the right explanation
    vague = true        what is told is true and leads nowhere, or nothing is
    misleading = true   what is told leads away from the fault
    small = true        differs by less than correct programs do, or where no check asks

As a program it grades all and prints the table of rates: .shadelab/venv/bin/python -I tests/python/test_undeclared.py
"""

import re
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from shadelab.course.assignment import load_assignment
from shadelab.course.mistakes import with_bodies
from shadelab.course.toml_files import read_toml
from shadelab.grading.grade import grade
from shadelab.paths import SOLUTION
from shadelab.words import BACKENDS

FOLDER = Path(__file__).resolve().parents[1] / "undeclared"
ASSIGNMENTS = ("lights", "phong", "microfacet")
EVERY = 24  # of so many mistakes one is among the quick tests


def mistakes(name):
    return read_toml(FOLDER / f"{name}.toml")["mistake"]


def correct_programs(name):
    return read_toml(FOLDER / f"correct_{name}.toml")["variant"]


def graded(name, bodies, only, folder):
    """bodies: by language and function. The checks by id."""
    assignment = load_assignment(SOLUTION / name)
    for backend in BACKENDS:
        source = assignment.directory / f"shading.{backend}"
        (folder / source.name).write_text(with_bodies(source.read_text(), source, bodies[backend]))
    return {check.id: check for check in grade(assignment, folder, only=only, pictures=False).result.checks}


def judged(name, mistake, folder):
    """By language the check of the mistaken function."""
    bodies = {b: {mistake["function"]: mistake.get(b) or mistake["body"]} for b in BACKENDS}
    checks = graded(name, bodies, f"*/function/{mistake['function']}", folder)
    return {b: checks[f"{b}/function/{mistake['function']}"] for b in BACKENDS if b in wrong_in(mistake)}


def wrong_in(mistake):
    """Some are right in one language."""
    what = mistake["what"]
    return (
        ["cpp"] if what.startswith("in C++ only") else ["glsl"] if what.startswith("in GLSL only") else list(BACKENDS)
    )


def told(check):
    return f"{check.message} {check.mistake.hint if check.mistake else ''}"


def verdict(mistake, check):
    """missed | unexplained | right | wrong"""
    if check.status != "failed":
        return "small" if mistake.get("small") else "missed"
    if mistake.get("right") and re.search(mistake["right"], told(check)):
        return "right"
    return "unexplained" if mistake.get("vague") else "wrong"


def sampled():
    """All of them; those that are not among the quick ones are marked slow."""
    for name in ASSIGNMENTS:
        for number, mistake in enumerate(mistakes(name)):
            marks = [] if number % EVERY == 0 else [pytest.mark.slow]
            yield pytest.param(name, mistake, id=mistake["id"], marks=marks)


@pytest.mark.parametrize("name,mistake", sampled())
def test_a_mistake_that_nobody_declared_is_seen_and_explained(name, mistake, tmp_path):
    for backend, check in judged(name, mistake, tmp_path).items():
        assert mistake.get("small") or check.status == "failed", backend
        if "right" in mistake and check.status == "failed":
            assert re.search(mistake["right"], told(check)), f"{backend}: {told(check)}"


@pytest.mark.parametrize(
    "name,program",
    [
        pytest.param(name, program, id=program["id"], marks=[] if number % 7 == 0 else [pytest.mark.slow])
        for name in ASSIGNMENTS
        for number, program in enumerate(correct_programs(name))
    ],
)
def test_a_correct_program_in_unusual_algebra_loses_nothing(name, program, tmp_path):
    bodies = {b: program.get("bodies") or program[b] for b in BACKENDS}
    checks = graded(name, bodies, "*/function/*", tmp_path)
    assert {id: check.message for id, check in checks.items() if check.status != "passed"} == {}


def test_the_set_is_as_large_as_it_says():
    every = [m for name in ASSIGNMENTS for m in mistakes(name)]
    assert len(every) >= 120 and sum(len(correct_programs(name)) for name in ASSIGNMENTS) >= 40
    asked = [m for m in every if not m.get("small")]
    assert all(("right" in m) + m.get("vague", False) + m.get("misleading", False) == 1 for m in asked)
    # Each is held to what it says (slow, but for one in EVERY).
    told_of = {kind: sum(len(wrong_in(m)) for m in asked if kind in m) for kind in ("right", "misleading")}
    total = sum(len(wrong_in(m)) for m in asked)
    assert told_of["right"] >= 0.9 * total and told_of["misleading"] <= 0.01 * total


def table():
    """Per assignment and language: how many, caught, explained rightly, wrongly."""
    print(f"{'':24}{'mistakes':>9}{'caught':>9}{'right':>9}{'wrong':>9}{'none':>9}{'small':>9}")
    for name in ASSIGNMENTS:
        counts = {backend: Counter() for backend in BACKENDS}

        def one(mistake, name=name):
            with tempfile.TemporaryDirectory() as folder:
                return mistake, judged(name, mistake, Path(folder))

        with ThreadPoolExecutor(2) as pool:
            for mistake, checks in pool.map(one, mistakes(name)):
                for backend, check in checks.items():
                    counts[backend][verdict(mistake, check)] += 1
                    if "--all" in sys.argv:
                        said = told(check).replace("\n", " ")
                        print(
                            f"{verdict(mistake, check):12}{backend:5}{mistake['id']}\n    is: {mistake['what']}\n    told: {said}"
                        )
        for backend, of in counts.items():
            every = of.total()
            caught = every - of["missed"] - of["small"]
            print(
                f"{name:14}{BACKENDS[backend]:10}{every:9}{caught:9}{of['right']:9}{of['wrong']:9}{of['unexplained']:9}{of['small']:9}"
            )


if __name__ == "__main__":
    table()
