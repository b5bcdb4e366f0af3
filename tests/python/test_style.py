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


def test_comments_fit_beside_one_another():
    """Two files side by side: no comment, in any language, is wider than 130 columns."""
    listed = run("git", "ls-files", "*.py", "*.[ch]pp", "*.glsl", "*.toml", "*.js", "*.css", "shadelab").stdout.split()
    marks = ("#", "//", "/*", '"""', "*")
    wide = [
        f"{name}:{k}"
        for name in listed
        for k, line in enumerate((ROOT / name).read_text().splitlines(), 1)
        if len(line) > 130 and line.lstrip().startswith(marks)
    ]
    assert listed and not wide, wide
