"""What students receive: all that they need, and nothing that gives the solution or the hidden scenes away."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
import tomli_w

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.mistakes import load_changes
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.publish.release import copy_scenes, given_assignments, marked_lines, write_release

pytestmark = pytest.mark.slow  # the expected data must be there, and a release is large
every_assignment = pytest.mark.parametrize("name", assignment_names())


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    """name -> (assignment, its release, the warnings); each is written once."""
    made = {}

    def release(name):
        if name not in made:
            assignment, out = load_assignment(ROOT / "solution" / name), tmp_path_factory.mktemp("release") / name
            made[name] = (assignment, out, write_release(assignment, out, force=False))
        return made[name]

    return release


def contents(folder):
    """(name, bytes) of every file. Arrays are compressed and hold numbers, or words of hypotheses: of them, names and words."""
    for file in sorted(f for f in folder.rglob("*") if f.is_file()):
        data, name = file.read_bytes(), str(file.relative_to(folder))
        if file.suffix == ".npz":
            arrays = np.load(file, allow_pickle=False)
            assert all(arrays[key].dtype.kind in "fiubU" for key in arrays), name
            words = [word for key in arrays if arrays[key].dtype.kind == "U" for word in arrays[key]]
            data = "\n".join([*arrays, *words]).encode()
        yield name, data


@every_assignment
def test_no_marked_line_is_anywhere(released, name):
    assignment, out, warnings = released(name)
    lines = marked_lines(assignment)
    assert len(lines) >= 10
    assert [(where, line) for where, data in contents(out) for line in lines if line.encode() in data] == []
    # The warnings say what `given` reveals, and nothing else.
    assert len(warnings) == len(given_assignments(assignment))
    assert all(g.name in w for g, w in zip(given_assignments(assignment), warnings))


@every_assignment
def test_nothing_hidden_is_anywhere(released, name):
    assignment, out, _ = released(name)
    names = {f.name for f in out.rglob("*") if not f.is_relative_to(out / "grader")}
    assert not names & {"hidden.toml", "mistakes.toml", "exact.py", "solution", "starter", "tests", "docs", ".git"}
    assert not [n for n in names if n.startswith("hidden-")]
    families = [f"hidden-{family.name}".encode() for family in assignment.hidden.family]
    assert families
    bodies = [body.strip().encode() for m in load_changes(assignment).mistake for body in m.bodies_for("cpp").values()]
    for where, data in contents(out):
        assert not [f for f in families if f in data], where
        assert not [b for b in bodies if len(b) > 40 and b in data], where
    # No packet: they repeat the meshes, and the scanned one is not ours to hand on.
    assert not list(out.rglob("*.packet")) and not list(out.rglob("*.obj"))


@every_assignment
def test_it_holds_what_its_assignment_needs_and_no_other(released, name):
    assignment, out, _ = released(name)
    given = [g.name for g in given_assignments(assignment)]
    assert sorted(f.name for f in (out / "assignments").iterdir()) == sorted([name, *given])
    files = {str(f.relative_to(out / "assignments" / name)) for f in (out / "assignments" / name).rglob("*.*")}
    assert files == {"assignment.toml", "stability.toml", *(f"checks/{f.name}" for f in assignment.check_files)} | {
        f"stubs/{file}" for file in assignment.files
    }
    for file in assignment.files:
        assert (out / "assignments" / name / "stubs" / file).read_bytes() == (out / name / file).read_bytes()
    assert [f.name for f in (out / "expected").iterdir()] == [name]
    for scene in assignment.public_scenes:
        assert (out / "scenes" / scene.file.relative_to(ROOT / "scenes")).is_file()
        assert (out / "expected" / name / f"{scene.name}.npz").is_file()
    for other in set(assignment_names()) - {name, *given}:
        assert not (out / "scenes" / other).exists() and not (out / other).exists()
    # A given assignment is code and no task: it cannot be graded here.
    for each in given:
        manifest = load_assignment(out / "assignments" / each)
        assert manifest.points == 0 and not manifest.public_scenes and manifest.functions
        code = (out / "assignments" / each / "shading.cpp").read_text()
        assert "STUDENT" not in code and "TODO" not in code
    own = load_assignment(out / "assignments" / name)
    assert own.points == 100 - sum(f.points * f.scenes for f in assignment.hidden.family)


@every_assignment
def test_what_people_read_speaks_of_this_folder(released, name):
    assignment, out, _ = released(name)
    readme, handout = (out / "README.md").read_text(), (out / name / "handout.md").read_text()
    assert f"./shadelab grade {name}\n" in readme and assignment.title in readme
    for text in (readme, handout, (out / ".github/workflows/grade.yml").read_text(), (out / "Dockerfile").read_text()):
        assert "__" not in text and "starter/" not in text and "solution/" not in text
        for scene in re.findall(r"scenes/[\w/-]+\.toml", text):
            assert (out / scene).is_file()
    for picture in re.findall(r"\]\((pictures/[^)]+)\)", handout):
        assert (out / name / picture).is_file()
    json.loads((out / ".devcontainer/devcontainer.json").read_text())
    workflow = (out / ".github/workflows/grade.yml").read_text()
    assert "persist-credentials: false" in workflow and "permissions:\n  contents: read\n" in workflow
    assert "secrets." not in workflow and "token" not in workflow.replace("no token in .git/config", "")


@every_assignment
def test_it_says_what_its_score_is_a_score_of(released, name):
    """How many points its checks can give, and that there is no follow-through: in the handout; for reports, in the record."""
    assignment, out, _ = released(name)
    hidden = sum(f.points * f.scenes for f in assignment.hidden.family)
    assert hidden > 0 and json.loads((out / "release.json").read_text())["hidden_points"] == hidden
    handout = " ".join((out / name / "handout.md").read_text().split())
    assert f"Its checks give up to {100 - hidden:g} of the 100 points, and it judges each function by itself" in handout
    assert f"the checks here give up to {100 - hidden:g}." in (out / "README.md").read_text()


def test_every_module_finds_what_it_imports(released):
    """Instructors' modules are left out; the commands that need them are, too."""
    _, out, _ = released("lights")
    modules = {".".join(f.relative_to(out / "grader").with_suffix("").parts) for f in (out / "grader").rglob("*.py")}
    modules |= {m.removesuffix(".__init__") for m in modules}
    for file in (out / "grader").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("shadelab"):
                submodules = {f"{node.module}.{alias.name}" for alias in node.names}
                assert node.module in modules, f"{file.name} imports {node.module}"
                left_out = {
                    m for m in submodules if (ROOT / "grader" / m.replace(".", "/")).with_suffix(".py").exists()
                }
                assert left_out <= modules, f"{file.name} imports {left_out}"


def test_a_folder_with_something_in_it_is_spared(tmp_path):
    assignment = load_assignment(ROOT / "solution" / "lights")
    out = tmp_path / "out"
    write_release(assignment, out, force=False)
    with pytest.raises(UserError, match="holds a former release; --force"):
        write_release(assignment, out, force=False)
    (out / "notes.md").write_text("mine")
    (out / ".git").mkdir()
    (out / ".git" / "HEAD").write_text("mine")
    for _ in range(2):
        write_release(assignment, out, force=True)
        assert (out / "notes.md").read_text() == (out / ".git" / "HEAD").read_text() == "mine"
    (out / "lights" / "shading.cpp").write_text("a student's work")
    with pytest.raises(UserError, match="was changed since the release"):
        write_release(assignment, out, force=True)
    assert (out / "lights" / "shading.cpp").read_text() == "a student's work"
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine")
    for force in (False, True):
        with pytest.raises(UserError, match="is not empty"):
            write_release(assignment, other, force)
    assert [f.name for f in other.iterdir()] == ["thesis.txt"]


def test_scenes_bring_the_files_that_they_name(tmp_path):
    """A texture, say; and what stands outside of scenes/ is refused."""
    folder = ROOT / "scenes" / "lights"
    scene = read_toml(folder / "cosine.toml")
    copy_scenes([folder / "cosine.toml"], tmp_path)
    assert [str(f.relative_to(tmp_path)) for f in tmp_path.rglob("*") if f.is_file()] == ["scenes/lights/cosine.toml"]
    scene["environment"] = {"image": str(tmp_path / "sky.png")}
    (tmp_path / "sky.png").touch()
    (tmp_path / "own.toml").write_text(tomli_w.dumps(scene))
    with pytest.raises(UserError, match="does not stand below scenes/"):
        copy_scenes([tmp_path / "own.toml"], tmp_path / "out")


def test_it_grades_alone(released, tmp_path):
    """With its own grader and data; the build and the meshes of this checkout spare the minutes of a set-up."""
    _, out, _ = released("lights")
    alone = tmp_path / "alone"
    shutil.copytree(out, alone)
    (alone / "build").symlink_to(ROOT / "build")
    shutil.rmtree(alone / "scenes" / "meshes", ignore_errors=True)
    (alone / "scenes" / "meshes").symlink_to(ROOT / "scenes" / "meshes")
    start = f"import sys; sys.path.insert(0, {str(alone / 'grader')!r}); from shadelab.cli.app import main; main()"

    def run(*arguments):
        environment = {**os.environ, "SHADELAB_ROOT": str(alone)}
        command = [sys.executable, "-I", "-c", start, *arguments]
        return subprocess.run(command, cwd=alone, capture_output=True, text=True, env=environment)

    done = run("grade", "lights", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["max_score"] == 92 and result["score"] <= 15
    assert {c["status"] for c in result["checks"]} <= {"passed", "failed", "skipped"}
    for name in ("shading.cpp", "shading.glsl"):
        shutil.copy(ROOT / "solution" / "lights" / name, alone / "lights" / name)
    done = run("grade", "lights", "--json", "-")
    assert json.loads(done.stdout)["score"] == 92
    assert run("doctor").returncode == 0
    for theirs in ("check", "release", "package", "new", "starter", "reference"):
        done = run(theirs, "lights")
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "No such command" in done.stderr
    # There is no solution to draw with: it is the student's folder.
    assert run("render", "scenes/lights/cosine.toml").returncode == 0
    assert (alone / "out" / "cosine.png").is_file()
