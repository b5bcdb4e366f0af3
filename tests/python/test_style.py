"""Formatting is not discussed: the tools decide, and this says where they disagree with a file."""

import subprocess
import sys
from pathlib import Path

from conftest import ROOT

BIN = Path(sys.executable).parent
PYTHON = ["grader", "tests", "scenes", "docs", "solution", "studies"]


def run(*command):
    return subprocess.run(list(map(str, command)), cwd=ROOT, capture_output=True, text=True)


def test_python_is_formatted():
    done = run(BIN / "ruff", "format", "--check", *PYTHON)
    assert done.returncode == 0, done.stdout


def test_python_is_linted():
    done = run(BIN / "ruff", "check", *PYTHON)
    assert done.returncode == 0, done.stdout


def test_cpp_is_formatted():
    # The solutions stay as they are written: beside their GLSL twins, line by line.
    files = [f for folder in ("framework", "tests/cpp") for f in (ROOT / folder).rglob("*.[ch]pp")]
    assert len(files) > 20
    done = run(BIN / "clang-format", "--dry-run", "-Werror", *files)
    assert done.returncode == 0, done.stderr[:4000]


def test_the_project_speaks_of_itself_alone():
    """No path of the machine that it was written on."""
    done = run("git", "-C", ROOT, "grep", "-nIE", r"(^|[^.[:alnum:]_])/(work|root|home)/")
    assert done.returncode == 1, done.stdout
