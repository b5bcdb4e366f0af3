"""The child in which an assignment's custom checks run: pytest, so that a check that crashes or hangs costs itself and
nothing else.

The checks are the instructor's, and trusted. Neither the grader nor this child ever loads the student's code: what a check
asks of it, the child asks of the grader, a line of JSON each way. shadelab/custom.py is what happens in the child.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from shadelab.course.assignment import Assignment
from shadelab.errors import InfrastructureError
from shadelab.paths import ROOT

LIMIT = 60.0  # seconds of one check, without those in which the student's code runs


@dataclass
class Job:
    """What the child is to do. Paths as text: it is told in JSON."""

    assignment: str
    backend: str
    expected: str
    folder: str  # for what checks write
    checks: list[str]  # names
    says: int = -1  # file descriptors: nameless, so that no code can replace them
    hears: int = -1


@dataclass
class Verdict:
    check: str
    status: str  # passed | failed | skipped | error
    message: str = ""
    needs: list[str] = field(default_factory=list)  # ids, of one that was skipped
    seconds: float = 0.0
    printed: str = ""


class Session:
    """Runs checks in their order. After one that ended the child, another child does the rest."""

    def __init__(
        self,
        assignment: Assignment,
        backend: str,
        expected: Path,
        folder: Path,
        stop: threading.Event,
        checks: list[str],
    ) -> None:
        self.assignment, self.stop, self.folder = assignment, stop, folder
        self.backend, self.expected = backend, expected
        self.child: subprocess.Popen | None = None
        self.checks = checks  # names, in the order in which they are asked for
        self.begun: str | None = None
        self.broken = ""  # why a file of checks could not be loaded

    def next_line(self, check: str) -> dict[str, Any] | Verdict:
        """What the child says next: a question, or the verdict of a check. Raises InfrastructureError when the user
        interrupts."""
        if self.child is None:
            self._start(self.checks[self.checks.index(check) :])
        idle = time.monotonic()  # since then nothing was said; the student's code runs between two calls
        while True:
            over = self.child.poll() is not None
            late = time.monotonic() - idle > LIMIT
            for entry in self._lines():
                if "begin" in entry:
                    self.begun, idle = entry["begin"], time.monotonic()
                elif "broken" in entry:
                    self.broken = entry["broken"]
                elif "ask" in entry:
                    return entry
                else:
                    self.begun = None
                    return Verdict(**entry)
            if self.stop.is_set():
                raise InfrastructureError("interrupted")
            if over or late:
                return self._lost(check, late)
            time.sleep(0.02)

    def reply(self, **answer: Any) -> None:
        try:
            os.write(self.to_child, json.dumps(answer).encode() + b"\n")
        except BrokenPipeError:
            pass  # it has ended; the next line says so

    def _lost(self, check: str, late: bool) -> Verdict:
        """The child has ended, or is ended: the check that it was at is lost; before any began, none can be run."""
        code = self.close()
        why = f"did not end within {LIMIT:g} s" if late else f"ended pytest (exit code {code})"
        return Verdict(self.begun or check, "error", self.broken or f"the check {why}")

    def close(self) -> int | None:
        if self.child is None:
            return None
        try:
            os.killpg(self.child.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        code = self.child.wait()
        self.child = None
        os.close(self.to_child)
        self.said.close()
        return code

    def _start(self, checks: list[str]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.said, self.at, self.begun, self.broken = tempfile.TemporaryFile(), 0, None, ""
        hears, self.to_child = os.pipe()
        job = Job(
            str(self.assignment.directory), self.backend, str(self.expected), str(self.folder), checks,
            says=self.said.fileno(), hears=hears,
        )  # fmt: skip
        file = self.folder / "job.json"
        file.write_text(json.dumps(asdict(job)))
        command = [
            "setpriv", "--pdeathsig", "KILL",  # whatever ends the grader ends this, too
            sys.executable, "-I", "-B", "-m", "pytest", "-p", "shadelab.custom", "--shadelab-job", file,
            "-p", "no:cacheprovider", "-o", "addopts=", "--import-mode=importlib", "--continue-on-collection-errors",
            "--rootdir", self.assignment.directory, *self.assignment.check_files,
        ]  # fmt: skip
        # Of the user's own pytest, if the grader runs inside of one, nothing is taken over.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
        environment |= {"SHADELAB_ROOT": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        self.child = subprocess.Popen(
            list(map(str, command)), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            cwd=self.folder, env=environment, start_new_session=True, pass_fds=[job.says, job.hears],
        )  # fmt: skip
        os.close(hears)

    def _lines(self) -> list[dict[str, Any]]:
        """Up to a question or a verdict, which the caller acts on before it reads more."""
        out = []
        data = os.pread(self.said.fileno(), 1 << 24, self.at)
        for line in data[: data.rfind(b"\n") + 1].splitlines(
            keepends=True
        ):  # the child may still be writing the last one
            self.at += len(line)
            out.append(json.loads(line))
            if not {"begin", "broken"} & set(out[-1]):
                break
        return out
