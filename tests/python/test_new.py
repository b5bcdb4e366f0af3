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

    def run(*arguments, timeout=60):
        environment = {**os.environ, "SHADELAB_ROOT": str(folder)}
        command = [sys.executable, "-I", "-m", "shadelab", *arguments]
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
    assert "./shadelab check soft_light" in done.stderr and len(done.stderr.splitlines()) <= 9
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


@pytest.mark.slow
def test_it_passes_check_as_it_stands(checkout):
    _, run = checkout
    assert run("new", "soft_light").returncode == 0
    done = run("check", "soft_light", timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 mistakes and 2 correct variants in 2 languages, 0 missed" in done.stdout
    done = run("starter", "--verify", "soft_light")
    assert done.returncode == 0
