"""Runs an assignment's custom checks: pytest in a child process, so that a check that crashes or hangs costs itself and nothing else.

The checks are the instructor's, and trusted. Neither the grader nor this child ever loads the student's code: what the checks ask
of it runs in children of the child, behind the Sandbox. custom.py is what happens in the child.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.errors import InfrastructureError
from shadelab.machine.sandbox import stop_everything
from shadelab.paths import ROOT

LIMIT = 60.0  # seconds of one check, without those in which the student's code runs


@dataclass
class Job:
    """What the child is to do. Paths as text: it is told in JSON."""

    assignment: str
    backend: str
    submission: str
    expected: str
    folder: str  # for the sandbox, and for the scenes that checks write
    checks: list[str]  # names
    drawn: dict[str, str]  # scene -> the image that the grading drew, a .npy file
    undrawn: dict[str, str]  # scene -> why it gave none
    hung: list[str]  # functions that did not end in their own checks
    results: int = -1  # file descriptor: nameless, so that no code can replace it


@dataclass
class Verdict:
    check: str
    status: str  # passed | failed | skipped | error
    message: str = ""
    needs: list[str] = field(default_factory=list)  # ids, of one that was skipped
    seconds: float = 0.0
    printed: str = ""


def run_checks(assignment: Assignment, job: Job) -> Iterator[Verdict]:
    """One of each check, when it has ended. After one that ended the child, another child does the rest."""
    left = list(job.checks)
    Path(job.folder).mkdir(parents=True, exist_ok=True)
    while left:
        job.checks = left[:]
        with tempfile.TemporaryFile() as results:
            job.results = results.fileno()
            child = _start(assignment, job)
            try:
                watch = _Watch(results.fileno())
                over = False
                while not over:
                    over = child.poll() is not None or watch.idle > LIMIT
                    for verdict in watch.read():
                        if verdict.check in left:
                            left.remove(verdict.check)
                            yield verdict
                    if stop_everything.is_set():
                        raise InfrastructureError("interrupted")
                    time.sleep(0 if over else 0.02)
            finally:
                try:
                    os.killpg(child.pid, signal.SIGKILL)
                except ProcessLookupError:
                    pass
                code = child.wait()
        why = f"did not end within {LIMIT:g} s" if watch.idle > LIMIT else f"ended pytest (exit code {code})"
        lost = [watch.begun] if watch.begun in left else left[:]  # before any began: none can be run
        for name in lost:
            left.remove(name)
            yield Verdict(name, "error", watch.broken or f"the check {why}")


def _start(assignment: Assignment, job: Job) -> subprocess.Popen:
    file = Path(job.folder) / "job.json"
    file.write_text(json.dumps(asdict(job)))
    command = [
        "setpriv", "--pdeathsig", "KILL",  # whatever ends the grader ends this, too
        sys.executable, "-I", "-B", "-m", "pytest", "-p", "shadelab.custom", "--shadelab-job", file,
        "-p", "no:cacheprovider", "-o", "addopts=", "--import-mode=importlib", "--continue-on-collection-errors",
        "--rootdir", assignment.directory, *assignment.check_files,
    ]  # fmt: skip
    # Of the user's own pytest, if the grader runs inside of one, nothing is taken over.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment |= {"SHADELAB_ROOT": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    return subprocess.Popen(
        list(map(str, command)), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=job.folder, env=environment, start_new_session=True, pass_fds=[job.results],
    )  # fmt: skip


class _Watch:
    """Reads the child's lines: a check begins, the student's code runs or has ended, a check has its verdict."""

    def __init__(self, results: int) -> None:
        self.results, self.at = results, 0
        self.begun: str | None = None
        self.broken = ""  # why a file of checks could not be loaded
        self.idle = 0.0  # seconds since a check began or ended, without those of the student's code
        self._busy, self._last = False, time.monotonic()

    def read(self) -> Iterator[Verdict]:
        now = time.monotonic()
        self.idle += 0 if self._busy else now - self._last
        self._last = now
        data = os.pread(self.results, 1 << 24, self.at)
        lines = data[: data.rfind(b"\n") + 1]  # the child may still be writing the last one
        self.at += len(lines)
        for entry in map(json.loads, lines.splitlines()):
            if "busy" in entry:
                self._busy = entry["busy"]
                continue
            self.idle = 0.0
            if "begin" in entry:
                self.begun = entry["begin"]
            elif "broken" in entry:
                self.broken = entry["broken"]
            else:
                self.begun = None
                yield Verdict(**entry)
