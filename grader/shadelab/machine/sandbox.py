"""The seam behind which student code runs, its compilation included.

Everything that touches a student's file goes through `Sandbox`; nothing else starts processes on it. This sandbox sets limits
(time, memory, file size, no core dumps), a bare environment and a process group that dies as a whole. It does not yet hide the
file system or the network.
"""

import os
import re
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from shadelab.errors import InfrastructureError
from shadelab.machine.command import Command
from shadelab.paths import STATE

OUTPUT_KEPT = 4096  # bytes of what the code prints that a report shows
THREADS = 64
PASSED_ON = ("SHADELAB_LEVEL", "GLIBC_TUNABLES")  # which processor's code runs; the image is the same


@contextmanager
def work_folder(purpose: str) -> Iterator[Path]:
    """A folder for one run, gone afterwards. What killed runs left behind goes after a day."""
    parent = STATE / "work"
    parent.mkdir(parents=True, exist_ok=True)
    for stale in parent.iterdir():
        try:
            if time.time() - stale.stat().st_mtime > 86400:
                shutil.rmtree(stale, ignore_errors=True)
        except FileNotFoundError:
            pass  # another run was faster
    folder = Path(tempfile.mkdtemp(prefix=f"{purpose}-", dir=parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class Limits:
    seconds: float = 10.0
    memory: int = 2 << 30  # address space, bytes
    file_size: int = 256 << 20


@dataclass(frozen=True)
class _Inherited:
    """A limit that this process was started with, as `ulimit` sets it, and how a child shows that it met it."""

    number: int
    flag: str  # of ulimit
    what: str
    ample: int  # from this on it is no reason for anything that fails
    signals: tuple[int, ...] = ()
    says: str = "$^"

    @property
    def value(self) -> int | None:
        soft = resource.getrlimit(self.number)[0]
        return None if soft == resource.RLIM_INFINITY else soft

    def met_by(self, outcome: "Outcome", needed: int) -> bool:
        if self.value is None or self.value >= max(needed, self.ample):
            return False
        return -outcome.returncode in self.signals or re.search(self.says, outcome.stderr) is not None


_memory = _Inherited(
    resource.RLIMIT_AS, "-v", "memory", 0,
    (signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS, signal.SIGKILL, signal.SIGTRAP),
    r"(?i)out of memory|memory exhausted|cannot allocate|bad_alloc|MemoryError|failed to map",
)  # fmt: skip
_file_size = _Inherited(resource.RLIMIT_FSIZE, "-f", "the size of a file", 0, (signal.SIGXFSZ,), "File too large")
_processor = _Inherited(resource.RLIMIT_CPU, "-t", "seconds of processor time", 0, (signal.SIGXCPU, signal.SIGKILL))
_files = _Inherited(resource.RLIMIT_NOFILE, "-n", "the number of open files", 256, (), "Too many open files")
_threads = _Inherited(
    resource.RLIMIT_NPROC, "-u", "the number of processes", 4096, (),
    "Resource temporarily unavailable|Thread creation failed|can't start new thread|vfork|pthread_create",
)  # fmt: skip


@dataclass
class Outcome:
    """How a child process ended."""

    returncode: int  # negative: the signal that ended it
    timed_out: bool
    seconds: float
    stdout: bytes  # its beginning
    stderr: str

    @property
    def ok(self) -> bool:
        return self.returncode == 0 and not self.timed_out

    def explain(self, limits: Limits) -> str:
        """What happened, for a student."""
        if self.timed_out:
            return f"did not end within {limits.seconds:g} s (an endless loop?)"
        if self.returncode < 0:
            known = {s.value: s.name for s in signal.Signals}
            name = known.get(-self.returncode, f"signal {-self.returncode}")
            meanings = {
                "SIGSEGV": "it read or wrote memory that is not its own, or recursed without end",
                "SIGFPE": "an integer was divided by zero",
                "SIGABRT": "an exception or failed assertion",
                "SIGKILL": "the system ended it, perhaps for its use of memory",
                "SIGXFSZ": "it wrote too much",
                "SIGXCPU": "it used up its processor time",
            }
            return f"crashed with {name}" + (f": {meanings[name]}" if name in meanings else "")
        last = self.stderr.strip().splitlines()
        return f"ended with exit code {self.returncode}" + (f": {last[-1]}" if last else "")


class Sandbox:
    """Runs commands on behalf of one submission. `folder` is all that they need to write to."""

    name = "limits only (time, memory, file size, bare environment)"

    def __init__(self, folder: Path, output_kept: int = OUTPUT_KEPT, stop: threading.Event | None = None) -> None:
        """stop: set when the user interrupts; the threads that wait for children give up then."""
        self.folder, self.output_kept, self.stop = folder, output_kept, stop or threading.Event()
        self.prepare()
        if not (shutil.which("prlimit") and shutil.which("setpriv")):
            raise InfrastructureError("prlimit or setpriv is missing: install util-linux")

    def prepare(self) -> None:
        """The folders, also after code that ran here removed or replaced them."""
        for folder in (self.folder, self.folder / "tmp"):
            if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                folder.unlink()
            folder.mkdir(parents=True, exist_ok=True)

    def fresh(self, name: str) -> Path:
        """A path in the folder at which nothing is, whatever code that ran here has put there."""
        self.prepare()
        path = self.folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
        return path

    def environment(self, extra: dict[str, str]) -> dict[str, str]:
        tmp = str(self.folder / "tmp")
        return {
            "PATH": "/usr/bin:/bin", "HOME": tmp, "TMPDIR": tmp, "LANG": "C.UTF-8",
            "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
            # Every thread reserves address space: on a machine of many processors they would not fit under the limit.
            "OMP_NUM_THREADS": str(min(THREADS, len(os.sched_getaffinity(0)))),
            **{name: os.environ[name] for name in PASSED_ON if name in os.environ}, **extra,
        }  # fmt: skip

    def run(
        self,
        command: Command,
        limits: Limits = Limits(),
        environment: dict[str, str] | None = None,
        cwd: Path | None = None,
        watch: Callable[[], bool] | None = None,
    ) -> Outcome:
        """Runs to the end, to the time limit, or until `watch` (asked every 20 ms) says to stop."""
        wanted = {
            _memory: limits.memory, _file_size: limits.file_size,
            _processor: int(limits.seconds * (os.cpu_count() or 1)) + 1, _files: 0, _threads: 0,
        }  # fmt: skip
        # Of a limit that was inherited and ours the lower one: to raise one takes a privilege.
        memory, file_size, seconds = (
            wanted[each] if each.value is None else min(wanted[each], each.value)
            for each in (_memory, _file_size, _processor)
        )
        limited = [
            "setpriv", "--pdeathsig", "KILL",  # whatever ends the grader ends this, too
            "prlimit", f"--as={memory}", f"--fsize={file_size}", "--core=0", f"--cpu={seconds}", *command.words,
        ]  # fmt: skip
        self.prepare()
        # Files and not pipes: code that prints without end meets the file size limit, and nobody has to drain it. They have no
        # name that the code could remove or replace.
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            start = time.perf_counter()
            process = subprocess.Popen(
                limited, stdin=subprocess.DEVNULL, stdout=out, stderr=err, cwd=cwd or self.folder,
                env=self.environment(environment or {}), start_new_session=True,
            )  # fmt: skip
            stopped = False
            try:
                while True:
                    elapsed = time.perf_counter() - start
                    try:
                        # Short commands end within the first waits; the polling gets coarser with time.
                        process.wait(timeout=min(0.02, max(0.001, elapsed)))
                        break
                    except subprocess.TimeoutExpired:
                        stopped = time.perf_counter() - start > limits.seconds or (watch is not None and watch())
                        if stopped or self.stop.is_set():
                            break
            finally:
                try:
                    os.killpg(process.pid, signal.SIGKILL)  # whatever the command left running goes with it
                except ProcessLookupError:
                    pass
                process.wait()
            seconds = time.perf_counter() - start
            if self.stop.is_set():
                raise InfrastructureError("interrupted")
            out.seek(0)
            kept = out.read(self.output_kept)
            if len(kept) < (size := os.fstat(out.fileno()).st_size):
                kept = kept[: self.output_kept - 64] + f"\n... {size - self.output_kept + 64} more bytes".encode()
            err.seek(0)
            text = err.read(1 << 20).decode(errors="replace")
        outcome = Outcome(process.returncode, stopped, seconds, kept, text)
        if not outcome.ok:
            _blame_the_machine(outcome, wanted)
        return outcome


def _blame_the_machine(outcome: Outcome, wanted: dict[_Inherited, int]) -> None:
    """Raises InfrastructureError where the child could not be started, or failed as one does that met a limit lower than ours."""
    first = (outcome.stderr.splitlines() or [""])[0]
    if re.match("(prlimit|setpriv): ", first):
        raise InfrastructureError(f"the sandbox could not start a program: {first}")
    for each, needed in wanted.items():
        if each.met_by(outcome, needed):
            least = f"; {needed} are asked for" if needed else ""
            raise InfrastructureError(
                f"this machine limits {each.what} to {each.value} (ulimit {each.flag}), and a program met that{least}"
            )
