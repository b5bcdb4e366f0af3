"""What becomes of a command whose output nobody takes."""

import json
import subprocess
import sys

import pytest

from conftest import ROOT

GRADE = ["grade", ROOT / "starter" / "phong", "--only", "cpp/function/half_vector", "--no-html", "--out", "graded"]


@pytest.fixture
def shell(tmp_path):
    """Runs a line of bash in which "$@" is ./shadelab with these words."""

    def run(line: str, *words):
        command = [
            "bash",
            "-o",
            "pipefail",
            "-c",
            line,
            "bash",
            sys.executable,
            "-I",
            "-m",
            "shadelab",
            *map(str, words),
        ]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)

    return run


@pytest.mark.parametrize("words", [["--help"], ["grade", "--help"], ["doctor"]], ids=" ".join)
@pytest.mark.parametrize(
    "line, code", [('"$@" | true', 0), ('"$@" >/dev/full', 3), ('"$@" >&-', 0)], ids=["read", "full", "closed"]
)
def test_output_that_nobody_takes(shell, words, line, code):
    done = shell(line, *words)
    assert done.returncode == code
    assert done.stderr.count("\n") <= 1 and "Traceback" not in done.stderr
    assert ("No space left" in done.stderr) == (code == 3)


@pytest.mark.parametrize(
    "line, code",
    [('"$@" | head -1', 0), ('"$@" >/dev/full', 3), ('"$@" >&-', 0), ('"$@" 2>&-', 0), ('"$@" >&- 2>&- <&-', 0)],
    ids=["head", "full", "closed", "stderr", "all"],
)
def test_a_result_is_written_all_the_same(shell, tmp_path, line, code):
    done = shell(line, *GRADE)
    assert done.returncode == code, done.stderr
    assert json.loads((tmp_path / "graded" / "result.json").read_text())["max_score"] > 0
    assert "Traceback" not in done.stdout + done.stderr


@pytest.mark.parametrize("line", ['"$@" | true', '"$@" >&-', '"$@" >/dev/full'], ids=["read", "closed", "full"])
def test_exit_codes_mean_what_they_mean(shell, line):
    assert shell(line, *GRADE, "--fail-under", 50).returncode == 1
    assert shell(line + " 2>/dev/full", "grade", "nonsense").returncode == 2


def test_json_for_a_closed_stdout_is_refused(shell):
    done = shell('"$@" >&-', *GRADE, "--json", "-")
    assert (done.returncode, done.stderr) == (2, "--json -: stdout is closed; give a file\n")
