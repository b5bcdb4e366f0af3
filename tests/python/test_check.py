"""check must notice when the grader misses something, in both directions."""

import itertools
import re
import subprocess

import pytest

from conftest import ROOT
from shadelab.build import glue_folder
from shadelab.check import _judge, involved
from shadelab.errors import UserError
from shadelab.grade import grade
from shadelab.manifest import assignment_names, load_assignment
from shadelab.mistakes import Change, callers, load_changes, regions, with_bodies, write_submission

PHONG = load_assignment(ROOT / "solution" / "phong")


def row_for(tmp_path, kind, function, body):
    change = Change(id="made-up", function=function, hint="-", body=body)
    write_submission(PHONG, change, tmp_path / "made-up")
    return _judge(PHONG, "made-up", kind, change, grade(PHONG, tmp_path / "made-up", only="cpp/function/*"))


def test_a_mistake_that_changes_nothing_is_missed(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return reflect(-l, n);")
    assert "cpp/function/mirror_direction does not see it" in row.faults


def test_a_variant_that_is_wrong_is_reported(tmp_path):
    row = row_for(tmp_path, "variant", "mirror_direction", "return reflect(l, n);")
    assert any("costs a correct variant" in fault for fault in row.faults)


def test_a_mistake_that_does_not_compile_is_reported(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return nonsense;")
    assert any("does not build" in fault for fault in row.faults)


def test_who_is_involved():
    assert callers(PHONG, {"half_vector"}) == {"half_vector", "blinn_lobe", "blinn_phong", "blinn_phong_ngan"}
    checks = involved(PHONG, {"half_vector"})
    assert "cpp/function/blinn_phong" in checks and "glsl/image/knot" in checks
    assert "cpp/function/phong" not in checks and "cpp/image/sphere" not in checks
    # Through code that is already written, and through what the framework calls for every light.
    lights = load_assignment(ROOT / "solution" / "lights")
    assert "cpp/image/albedo" in involved(lights, {"diffuse"}) and "glsl/image/cosine" in involved(lights, {"diffuse"})
    assert involved(lights, {"distance_falloff"}) >= {"cpp/image/hidden-studio", "cpp/function/incident_light"}


@pytest.mark.parametrize("name", assignment_names())
def test_declarations(name):
    assignment = load_assignment(ROOT / "solution" / name)
    changes = load_changes(assignment)
    assert len(changes.mistake) >= 12 and len(changes.variant) >= 6
    assert sum(m.subtle for m in changes.mistake) >= 4  # check measures that they are
    for language in ("cpp", "glsl"):
        source = assignment.directory / f"shading.{language}"
        solution = source.read_text()
        assert set(regions(solution, source)) == {f.name for f in assignment.functions if f.graded}
        for change in [*changes.mistake, *changes.variant]:
            assert with_bodies(solution, source, change.bodies_for(language)) != solution


def object_code(assignment, text, folder):
    """Each function's machine code, without names: equal for two texts that say the same with the same operations."""
    glue = glue_folder(assignment.directory)
    (folder / "shading.cpp").write_text(text)
    lines = (glue / "glue.cpp").read_text().splitlines()
    head = lines[: lines.index('#include "shading.cpp"') + 1]  # the given code and the student's, without the loops
    (folder / "unit.cpp").write_text("\n".join(head))
    flags = ["-std=c++20", "-O1", "-fno-inline", "-fsingle-precision-constant", "-ffp-contract=off", "-w", "-S"]
    command = ["g++", *flags, f"-I{ROOT / 'framework/include'}", f"-I{glue}", "unit.cpp", "-o", "unit.s"]
    subprocess.run(command, cwd=folder, check=True)
    out, constants, name = {}, {}, None
    for line in (folder / "unit.s").read_text().splitlines():
        if found := re.match(r"_Z(\d+)(\w+):$", line):  # a mangled name: its length, itself, its arguments' types
            name = found[2][: int(found[1])]
        elif line.startswith("\t.size"):
            name = None
        elif found := re.match(r"(\.LC\d+):", line):
            constants[found[1]] = label = []
            continue
        elif line.startswith("\t.long") and constants:
            label.append(line.strip())
        if name and not line.lstrip().startswith("."):
            out.setdefault(name, []).append(line)
    code = {}
    for name, body in out.items():
        joined = "\n".join(body[1:] if body[0].endswith(":") else body)
        for constant in set(re.findall(r"\.LC\d+", joined)):
            joined = re.sub(re.escape(constant) + r"\b", str(constants.get(constant)), joined)
        joined = re.sub(r"\.L\w+", "label", joined)
        code[name] = joined
    return code


def test_other_names_are_no_other_code(tmp_path):
    solution = (PHONG.directory / "shading.cpp").read_text()
    assert object_code(PHONG, solution, tmp_path) == object_code(PHONG, re.sub(r"\bsum\b", "total", solution), tmp_path)


@pytest.mark.parametrize("name", assignment_names())
def test_no_two_variants_share_an_expression_tree(name, tmp_path):
    assignment = load_assignment(ROOT / "solution" / name)
    source = assignment.directory / "shading.cpp"
    solution = source.read_text()
    code = {"the solution": object_code(assignment, solution, tmp_path)}
    for variant in load_changes(assignment).variant:
        whole = object_code(assignment, with_bodies(solution, source, variant.bodies_for("cpp")), tmp_path)
        code[variant.id] = {function: whole[function] for function in variant.bodies_for("cpp")}
    for function in (f.name for f in assignment.functions if f.graded):
        written = [(id, bodies[function]) for id, bodies in code.items() if function in bodies]
        for (a, first), (b, second) in itertools.combinations(written, 2):
            assert first != second, f"{function}: {a} and {b} say the same"


def test_unknown_function_is_one_clear_line():
    source = PHONG.directory / "shading.cpp"
    with pytest.raises(UserError, match="nothing has no STUDENT BEGIN"):
        with_bodies(source.read_text(), source, {"nothing": ""})
