"""editor: files with which editors check a submission while it is written."""

import json
import os
import shutil
import subprocess

import pytest

from conftest import ROOT


@pytest.mark.parametrize("name", ["phong", "lights", "microfacet"])
def test_the_compile_command_compiles_and_finds_errors(shadelab, tmp_path, name):
    folder = tmp_path / "mine"
    shutil.copytree(ROOT / "starter" / name, folder)
    done = shadelab("editor", folder, "--assignment", name)
    assert done.code == 0 and "compile_commands.json" in done.stdout, done.stderr
    [entry] = json.loads((folder / "compile_commands.json").read_text())
    command = [*entry["arguments"], "-fsyntax-only"]
    assert entry["file"] == "shading.cpp" and entry["directory"] == str(folder)
    good = subprocess.run(command, cwd=entry["directory"], capture_output=True, text=True)
    assert good.returncode == 0 and not good.stderr  # given code and the assignment's types are known
    with (folder / "shading.cpp").open("a") as file:
        file.write("Real wrong() { return vec9(1.0); }\n")
    assert "vec9" in subprocess.run(command, cwd=folder, capture_output=True, text=True).stderr


def test_glsl_is_checked_behind_the_prelude_with_the_students_lines(shadelab, tmp_path):
    """By whatever is called glslangValidator: this one says what it was given."""
    tools, folder = tmp_path / "tools", tmp_path / "mine"
    tools.mkdir()
    (tools / "glslangValidator").write_text(
        f"#!/bin/sh\ncat > {tmp_path}/given\necho \"ERROR: 0:7: 'x' : undeclared\"\nexit 2\n"
    )
    (tools / "glslangValidator").chmod(0o755)
    shutil.copytree(ROOT / "starter/phong", folder)
    path = f"{tools}:{os.environ['PATH']}"
    assert shadelab("editor", folder, PATH=path).code == 0
    done = subprocess.run([folder / ".vscode/glslang"], capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == "shading.glsl:7: 'x' : undeclared\n"
    given = (tmp_path / "given").read_text()
    before, student = given.split("\n#line 1\n")
    assert before.startswith("#version 330\n") and "struct Terms" in before
    assert student.startswith((folder / "shading.glsl").read_text())
    tasks = json.loads((folder / ".vscode/tasks.json").read_text())["tasks"]
    assert tasks[0]["command"] == str(folder / ".vscode/glslang")


def test_settings_of_ones_own_are_left_alone(shadelab, tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(ROOT / "starter/phong", folder)
    (folder / ".vscode").mkdir()
    (folder / ".vscode/settings.json").write_text("{} // mine\n")
    done = shadelab("editor", folder)
    assert done.code == 0 and "left alone" in done.stdout
    assert (folder / ".vscode/settings.json").read_text() == "{} // mine\n"
    done = shadelab("editor", tmp_path, "--assignment", "phong")
    assert done.code == 2 and "holds no shading.cpp" in done.stderr and len(done.stderr.splitlines()) == 1
