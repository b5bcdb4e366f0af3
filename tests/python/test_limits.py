"""Limits that the grader was started with (ulimit, a container): a machine's fault is never a student's."""

import json
import subprocess
import sys

import pytest

from conftest import ROOT
from shadelab.errors import InfrastructureError
from shadelab.machine.command import Command
from shadelab.machine.sandbox import Limits, Sandbox

CHECKS = ["--only", "*/function/half_vector", "--only", "*/image/sphere"]


@pytest.fixture
def graded(tmp_path, grade):
    """Grades under a shell's limits. The expected data is made before, without them."""
    grade(ROOT / "solution" / "phong", only="cpp/build")

    def run(limit: str, folder=ROOT / "solution" / "phong"):
        out = tmp_path / "limited"
        words = [
            sys.executable,
            "-I",
            "-m",
            "shadelab",
            "grade",
            folder,
            "--assignment",
            "phong",
            *CHECKS,
            "--no-html",
            "--out",
            out,
        ]
        shell = ["bash", "-c", f'ulimit {limit} && exec "$@"', "bash"]
        done = subprocess.run([*shell, *map(str, words)], cwd=tmp_path, capture_output=True, text=True, timeout=600)
        return done, json.loads((out / "result.json").read_text())

    return run


@pytest.mark.parametrize("limit", ["-v 2000000", "-f 20000", "-n 64", "-t 600"])
def test_a_lower_limit_is_kept(graded, limit):
    done, result = graded(limit)
    assert done.returncode == 0, done.stderr + done.stdout
    assert result["score"] == result["max_score"] > 0


@pytest.mark.parametrize("limit", ["-v 400000", "-f 500"])
def test_what_a_limit_ends_is_our_fault(graded, limit):
    done, result = graded(limit)
    statuses = {check["status"] for check in result["checks"]}
    assert done.returncode == 3 and "error" in statuses and "failed" not in statuses
    assert "Traceback" not in done.stdout + done.stderr


def test_a_students_fault_stays_one(graded, submission):
    head = "vec3 half_vector(vec3 l, vec3 v) {"
    _, result = graded("-v 2500000", submission(cpp={head: head + " __builtin_trap();"}))
    statuses = {c["id"]: c["status"] for c in result["checks"]}
    assert statuses["cpp/function/half_vector"] == "failed" and "error" not in statuses.values()


def test_a_program_that_cannot_be_started_is_our_fault(tmp_path):
    with pytest.raises(InfrastructureError, match="could not start"):
        Sandbox(tmp_path / "box").run(Command(("no-such-compiler",)), Limits())
