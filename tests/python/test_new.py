"""A new assignment: complete, and working before anything in it was replaced."""

import os
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT
from shadelab.publish.release import TEMPLATES


@pytest.fixture
def checkout(tmp_path):
    """A checkout in which an assignment can be made: its own folders, this one's build and meshes."""
    folder = tmp_path / "checkout"
    shutil.copytree(ROOT / "solution" / "lights", folder / "solution" / "lights")
    shutil.copytree(ROOT / "scenes" / "lights", folder / "scenes" / "lights")
    for name in ("framework", "grader", "build", "CMakeLists.txt", "scenes/meshes"):
        (folder / name).symlink_to(ROOT / name)

    def run(*arguments, timeout=60, module=True):
        environment = {**os.environ, "SHADELAB_ROOT": str(folder)}
        command = [sys.executable, "-I", *(["-m", "shadelab"] if module else []), *arguments]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, env=environment)

    return folder, run


def test_files(checkout):
    folder, run = checkout
    done = run("new", "soft_light", "--title", 'Soft "light" \\ ü')
    assert done.returncode == 0, done.stderr
    written = done.stdout.split()
    assert all((folder / name).is_file() for name in written)
    assert sorted(f.name for f in (folder / "solution/soft_light").iterdir()) == [
        "assignment.toml", "exact.py", "handout.md", "hidden.toml", "mistakes.toml", "shading.cpp", "shading.glsl",
    ]  # fmt: skip
    assert (folder / "scenes/soft_light/soft_light.toml").is_file()
    assert "TODO" in (folder / "starter/soft_light/shading.cpp").read_text()
    for name in written:
        text = (folder / name).read_text()
        assert "__" not in text.replace("__init__", ""), name
    assert "./shadelab check soft_light" in done.stderr and len(done.stderr.splitlines()) <= 10
    again = run("new", "soft_light")
    assert again.returncode == 2 and again.stderr == "solution/soft_light: is there already; choose another name\n"


@pytest.mark.parametrize("name", ["Phong", "two-lobes", "9lives", "a__b", "gl_light", "../x", "", "a" * 41, "ends_"])
def test_a_bad_name_is_one_line(checkout, name):
    folder, run = checkout
    before = sorted(folder.rglob("*"))
    done = run("new", name)
    assert done.returncode == 2 and done.stderr == (
        f"{name}: a name has small letters, digits and single underscores, such as soft_light\n"
    )
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["framework", "scenes", "expected", "out", "lights"])
def test_a_name_that_is_taken(checkout, name):
    _, run = checkout
    done = run("new", name)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "choose another" in done.stderr


def test_the_two_languages_of_the_template_agree():
    cpp, glsl = ((TEMPLATES / "assignment" / f"shading.{e}").read_text().splitlines() for e in ("cpp", "glsl"))
    assert cpp[cpp.index("") :] == glsl[glsl.index("") :]


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("def wrapped_cosine(", "def wrapped_cosin(", "has no function wrapped_cosine; every function of soft_light needs "
         "its twin there, in 50 digits: def wrapped_cosine(n, l, wrap)"),
        ("wrap), mpf(0))", "wrap), mpf(0)", "{line}: cannot be loaded: '(' was never closed"),
        ("wrap), mpf(0))", "wrap), mp(0))", "{line}: wrapped_cosine fails: NameError: name 'mp' is not defined"),
        ("(n, l, wrap):", "(n, l):", "wrapped_cosine fails: TypeError: "),
        ("return max((dot", "return vector(0, 0); max((dot", "wrapped_cosine gives 2 numbers; it must give result"),
        ("import mpf", "import mpfloat", "{line}: cannot be loaded: ImportError: "),
    ],
)  # fmt: skip
def test_what_is_wrong_with_exact_py_is_one_line(checkout, old, new, said):
    folder, run = checkout
    assert run("new", "soft_light").returncode == 0
    file = folder / "solution/soft_light/exact.py"
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))
    ask = (
        "import numpy, shadelab.truth.exact as e; from shadelab.course.assignment import load_assignment as load; "
        "from shadelab.paths import SOLUTION; a = load(SOLUTION / 'soft_light'); "
        "e.evaluate(a, a.function('wrapped_cosine'), numpy.array([[0, 0, 1, 0, 0, 1, 0.5]]))"
    )
    done = run("-c", ask, module=False)
    last = done.stderr.splitlines()[-1]
    line = next(k for k, content in enumerate(text.splitlines(), 1) if old in content)
    assert last.startswith("shadelab.errors.UserError: solution/soft_light/exact.py:")
    assert said.format(line=f"exact.py:{line}") in last


def test_starter_follows_the_solution_and_spares_what_is_not_its_own(checkout):
    """`new` says: starter after each change; nothing of the new assignment is committed then."""
    folder, run = checkout
    subprocess.run(["git", "init", "-q", folder], check=True)
    assert run("new", "soft_light").returncode == 0
    source, made = (folder / place / "soft_light/shading.cpp" for place in ("solution", "starter"))
    for round_ in ("once", "twice"):
        source.write_text(source.read_text() + f"// {round_}\n")
        done = run("starter", "soft_light")
        assert done.returncode == 0 and made.read_text().endswith(f"// {round_}\n"), done.stderr
    made.write_text(made.read_text() + "// by hand\n")
    done = run("starter", "soft_light")
    assert done.returncode == 2 and "holds changes that are not committed" in done.stderr
    assert made.read_text().endswith("// by hand\n")
    # What cannot be generated costs no starter.
    handout = folder / "solution/soft_light/handout.md"
    handout.write_text(handout.read_text() + "\n![none](pictures/none.png)\n")
    done = run("starter", "soft_light", "--force")
    assert done.returncode == 2 and "the picture pictures/none.png is not there" in done.stderr
    assert made.read_text().endswith("// by hand\n")


@pytest.mark.slow
def test_reference_names_the_function_without_a_twin(checkout):
    folder, run = checkout
    assert run("new", "soft_light").returncode == 0
    file = folder / "solution/soft_light/exact.py"
    file.write_text(file.read_text().replace("def wrapped_cosine(", "def wrapped_cosin("))
    done = run("reference", "soft_light", timeout=600)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "solution/soft_light/exact.py: has no function wrapped_cosine" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_it_passes_check_as_it_stands(checkout):
    folder, run = checkout
    assert run("new", "soft_light").returncode == 0
    for name in ("shadelab", "packages.apt", "CMakePresets.json", "pyproject.toml", "LICENSE", ".gitignore"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "scenes" / "meshes").unlink()  # a package refuses what stands outside of scenes/
    shutil.copytree(ROOT / "scenes" / "meshes", folder / "scenes" / "meshes")
    for file in ("make_meshes.py", "teapot_patches.txt", "SOURCES.md"):
        (folder / "scenes" / file).symlink_to(ROOT / "scenes" / file)
    package = ("package", "soft_light", "--for", "gradescope", "-o", "soft.zip")
    done = run(*package)  # not before it was checked
    assert done.returncode == 2 and done.stderr == (
        "soft_light: ./shadelab check soft_light has not passed for it as it is now; run that, or give --force\n"
    )
    assert not (folder / "soft.zip").exists() and run(*package, "--force").returncode == 0
    done = run("check", "soft_light", timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 mistakes and 2 correct variants in 2 languages, 0 missed" in done.stdout
    assert "note:" not in done.stdout
    done = run("starter", "--verify", "soft_light")
    assert done.returncode == 0
    assert run(*package).returncode == 0
    manifest = folder / "solution/soft_light/assignment.toml"
    manifest.write_text(manifest.read_text().replace("points = 40", "points = 39"))
    done = run(*package)  # nor after it was changed
    assert done.returncode == 2 and "./shadelab check soft_light has not passed" in done.stderr
