"""What every assignment must have, so that a student can work from it alone."""

import importlib.util
import re

import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.publish.rubric import MARK

ASSIGNMENTS = [load_assignment(ROOT / "solution" / name) for name in assignment_names()]
every_assignment = pytest.mark.parametrize("assignment", ASSIGNMENTS, ids=lambda a: a.name)


def contract_blocks(assignment, language):
    """Function -> the comment that stands directly above it."""
    text = (assignment.directory / f"shading.{language}").read_text()
    found = re.finditer(r"((?:^//.*\n)+)^\w+ (\w+)\([^;{]*\) \{$", text, re.MULTILINE)
    return {m[2]: m[1] for m in found}


@every_assignment
def test_points(assignment):
    images = sum(s.points for s in assignment.scenes)
    assert assignment.points == 100 and images >= 40
    assert len(assignment.public_scenes) >= 6 and len(assignment.hidden.family) >= 2
    assert sum(not f.graded for f in assignment.functions) >= 1  # a worked example


@every_assignment
def test_every_function_carries_the_same_contract_in_both_languages(assignment):
    cpp, glsl = contract_blocks(assignment, "cpp"), contract_blocks(assignment, "glsl")
    assert [f.name for f in assignment.functions] == list(cpp) == list(glsl)  # and in the manifest's order
    for function in assignment.functions:
        block = cpp[function.name]
        assert block == glsl[function.name]
        for word in [v.name for v in function.values] + ["result"]:
            assert re.search(rf"\b{word}\b", block), f"{function.name}: the contract does not speak of {word}"
        if function.graded:
            assert function.summary and f'"{function.slide}"' in " ".join(block.replace("//", " ").split())
    assert any("worked example" in cpp[f.name].lower() for f in assignment.functions if not f.graded)


@every_assignment
def test_the_handout_tells_the_points(assignment):
    """Generated from the manifest, in the section on grading."""
    source = (assignment.directory / "handout.md").read_text()
    assert source.count(MARK) == 1 and MARK in source[source.index("How it is graded") :]
    handout = (ROOT / "starter" / assignment.name / "handout.md").read_text()
    table = handout[handout.index("| check | points |") :].split("\n\n")[0]
    told = {}
    for row in table.splitlines()[2:]:
        name, points = row.strip("|").rsplit("|", 1)
        found = re.search(r"`([\w-]+)`", name)
        stable = "stability of " if "stability of" in name else ""
        told[stable + found[1] if found else name.strip()] = float(re.search(r"[\d.]+", points)[0])
    wanted = {f.name: f.points for f in assignment.functions if f.graded}
    wanted |= {s.name: s.points for s in assignment.public_scenes}
    wanted |= {f"stability of {s.name}": s.points for s in assignment.stability.values() if s.points}
    assert {name: points for name, points in told.items() if name in wanted} == wanted
    assert told["scenes that you do not see"] == sum(s.points for s in assignment.scenes if s.hidden)
    [total] = [points for name, points in told.items() if name.startswith("**all**")]
    assert total == assignment.points == sum(told.values()) - total


@every_assignment
def test_the_handout_suffices(assignment):
    handout = (assignment.directory / "handout.md").read_text()
    for heading in (
        "How to run",
        "What to write",
        "Edge cases",
        "What it should look like",
        "Pitfalls",
        "How it is graded",
    ):
        assert re.search(rf"^#+ {heading}", handout, re.MULTILINE), heading
    for function in assignment.functions:
        if function.graded:
            assert re.search(rf"^\| `{function.name}\(.*\|", handout, re.MULTILINE), function.name
            assert function.slide in handout
    questions = handout[handout.index("## Questions to think about") :]
    assert len(re.findall(r"^\d\. ", questions, re.MULTILINE)) == 3
    pictures = re.findall(r"\]\((pictures/[^)]+)\)", handout)
    assert any(p.endswith(".svg") for p in pictures) and len(pictures) >= 5
    for picture in pictures:
        assert (assignment.directory / picture).is_file(), picture


def test_the_gallery_shows_every_scene():
    spec = importlib.util.spec_from_file_location("make_pictures", ROOT / "docs" / "make_pictures.py")
    make_pictures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_pictures)
    text = make_pictures.gallery_text()
    assert (ROOT / "docs" / "gallery.md").read_text() == text, "run docs/make_pictures.py"
    listed = re.findall(r"\]\((pictures/gallery/[^)]+)\)", text)
    assert len(listed) == sum(len(a.public_scenes) for a in ASSIGNMENTS)
    scenes = [s for s in (ROOT / "scenes").glob("*/*.toml") if s.parent.name not in ("stress", "bench")]
    assert len(scenes) == len(listed)  # no scene that nobody uses
    for picture in listed:
        assert (ROOT / "docs" / picture).is_file(), picture
