"""check must notice when the grader misses something, in both directions."""

import dataclasses
import itertools
import re
import subprocess

import pytest
from typer.testing import CliRunner

from conftest import ROOT
from shadelab.cli.app import program
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.hidden import Hidden
from shadelab.course.mistakes import Change, Changes, Equivalent, load_changes, regions, with_bodies, write_submission
from shadelab.course.mutants import Mutant, mutants
from shadelab.errors import UserError
from shadelab.grading.grade import grade
from shadelab.machine.glue import glue_folder
from shadelab.prove import check as checking
from shadelab.prove import mutants as mutating
from shadelab.prove.check import _judge
from shadelab.truth.making import load

PHONG = load_assignment(ROOT / "solution" / "phong")
DECLARED = load_changes(PHONG)
SIGN = next(m for m in DECLARED.mistake if m.id == "mirror-sign")
VARIANT = DECLARED.variant[0]


def row_for(tmp_path, kind, function, body, id="made-up"):
    change = Change(id=id, function=function, hint="-", body=body)
    write_submission(PHONG, change, tmp_path / "made-up")
    only = f"*/function/{function}"
    return _judge(PHONG, "made-up", kind, change, grade(PHONG, tmp_path / "made-up", only=only), False)


def test_a_mistake_that_is_named_in_both_languages_is_well(tmp_path):
    row = row_for(tmp_path, "mistake", SIGN.function, "return reflect(l, n);", SIGN.id)
    assert row.faults == [] and set(row.named) == {"cpp", "glsl"} and min(row.named.values()) >= 3
    assert min(row.lost.values()) > 0 and row.rmse is None


def test_a_mistake_that_changes_nothing_is_missed(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return reflect(-l, n);")
    for backend in ("cpp", "glsl"):
        assert f"{backend}/function/mirror_direction does not see it" in row.faults


def test_a_mistake_under_another_name_is_missed(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", SIGN.body)
    assert "cpp/function/mirror_direction calls it mirror-sign" in row.faults
    row = row_for(tmp_path / "2", "mistake", "mirror_direction", "return 3.0 * dot(n, l) * n - 1.5 * l;")
    assert any("mirror_direction does not name it" in fault for fault in row.faults)


def test_a_variant_that_is_wrong_is_reported(tmp_path):
    row = row_for(tmp_path, "variant", "mirror_direction", "return reflect(l, n);")
    assert any("costs a correct variant" in fault for fault in row.faults)


def test_a_mistake_that_does_not_compile_is_reported(tmp_path):
    row = row_for(tmp_path, "mistake", "mirror_direction", "return nonsense;")
    assert any("does not build" in fault for fault in row.faults)


def declare(monkeypatch, mistakes=(), variants=(), bred=None, equivalent=()):
    """Instead of what phong's mistakes.toml says."""
    changes = Changes(mistake=mistakes, variant=variants, equivalent=equivalent)
    for module in (checking, mutating):
        monkeypatch.setattr(module, "load_changes", lambda assignment: changes)
    if bred is not None:
        monkeypatch.setattr(mutating, "mutants", bred)


@pytest.fixture
def check(monkeypatch):
    """The command for phong with few declarations and mutants, all about the mirror direction: (exit code, what it prints)."""

    def run(**declared):
        declare(monkeypatch, **declared)
        narrow = {"only": "*/function/mirror_direction"}
        monkeypatch.setattr(checking, "grade", lambda *a, **k: grade(*a, **{**k, **narrow}))
        done = CliRunner().invoke(program(), ["check", "phong"], env={"COLUMNS": "200"})
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception  # which ./shadelab would tell in a line, and end with another code
        return done.exit_code, done.stdout

    return run


SAME = "mirror_direction: the same in other words"


def few(function, body, scope):
    """Of one function. Each kind of change once, but for the arguments of dot, whose order is nothing."""
    chosen = {re.sub(r"[\d.]+", "", m.id.split(" in ")[0]): m for m in mutants(function, body) if "swapped" not in m.id}
    return list(chosen.values()) if function == "mirror_direction" else []


def alive(function, body, scope):
    return [Mutant(SAME, function, "    return -reflect(l, n);\n")] if function == "mirror_direction" else []


def test_what_is_declared_is_checked_and_mutants_are_bred(check):
    code, printed = check(mistakes=[SIGN], variants=[VARIANT], bred=few)
    assert code == 0, printed
    for name in ("solution", "starter", "mirror-sign", VARIANT.id):
        assert re.search(rf"^\W*{name} .* ok\b", printed, re.MULTILINE), printed
    for language in ("C++", "GLSL"):
        found = re.search(rf"phong: (\d+) mutants in {re.escape(language)} found out, 0 survive", printed)
        assert found and int(found[1]) >= 3, printed
    assert "1 mistakes and 1 correct variants in 2 languages, 0 missed" in printed


def test_it_says_what_the_declarations_leave_open(check):
    """Said, and no reason to fail."""
    code, printed = check(mistakes=[SIGN], variants=[VARIANT], bred=few)
    assert code == 0 and "phong: note: phong_lobe: no mistake of it is declared in mistakes.toml" in printed
    assert "note: mirror_direction" not in printed and "no scene" not in printed and "add up" not in printed


def test_it_says_which_function_no_scene_calls_and_that_points_are_not_100():
    expected = load(PHONG)
    fewer = dataclasses.replace(PHONG, public_scenes=PHONG.public_scenes[:1], hidden=Hidden())
    fewer.public_scenes[0].described.calls[:] = ["phong"]
    remarks = checking._remarks(fewer, DECLARED, expected)
    assert "blinn_phong: no scene calls it, so no picture shows a mistake of it" in remarks
    assert not any(remark.startswith("phong_lobe: no ") for remark in remarks)
    assert any(remark.startswith("phong_lobe: not declared, though blinn_lobe has it: ") for remark in remarks)
    assert any("its points add up to " in remark and ", not to 100" in remark for remark in remarks)
    whole = checking._remarks(load_assignment(PHONG.directory), DECLARED, expected)
    assert all(": not declared, though " in remark for remark in whole)


def test_a_mistake_that_nobody_sees_gives_exit_1(check):
    unseen = Change(id="unseen", function="mirror_direction", hint="-", body="return reflect(-l, n);")
    code, printed = check(mistakes=[unseen], bred=few)
    assert code == 1 and "unseen: cpp/function/mirror_direction does not see it" in printed and "MISSED" in printed


def test_a_mutant_that_survives_gives_exit_1(check):
    code, printed = check(bred=alive)
    assert code == 1 and f"survives: {SAME}" in printed and "0 mutants in C++ found out, 1 survive" in printed


def mutations(folder):
    return mutating.mutate(PHONG, load(PHONG), folder, lambda what, done, total: None)


def test_a_mutant_that_is_listed_as_equivalent_may_survive(monkeypatch, tmp_path):
    listed = [Equivalent(id=SAME, reason="two signs cancel")]
    declare(monkeypatch, bred=alive, equivalent=listed)
    for mutation in mutations(tmp_path / "1"):
        assert mutation.survivors == [] and mutation.equivalent == [SAME]
    # One that is killed, or does not exist, is listed in vain.
    stale = [*listed, Equivalent(id="mirror_direction: gone", reason="was there once")]
    declare(monkeypatch, bred=alive, equivalent=stale)
    with pytest.raises(UserError, match="no surviving mutant is called mirror_direction: gone"):
        mutations(tmp_path / "2")


def test_every_graded_function_is_mutated(monkeypatch, tmp_path):
    bred = []

    def stillborn(function, body, scope):
        bred.append(function)
        return [Mutant(f"{function}: nonsense", function, "    return nonsense;\n")]

    declare(monkeypatch, bred=stillborn)
    graded = [f.name for f in PHONG.functions if f.graded]
    for mutation in mutations(tmp_path):
        assert (mutation.killed, mutation.stillborn, mutation.survivors) == (0, len(graded), [])
    assert bred == graded * 2


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


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n == "lights" else [pytest.mark.slow]) for n in assignment_names()]
)
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
