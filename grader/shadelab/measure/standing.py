"""Programs that stand by with a frame and draw it on request: our rasterizer, and OpenGL.

Only the solution's code runs here, so no sandbox stands round it.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.errors import InfrastructureError
from shadelab.gl.environment import ENVIRONMENT
from shadelab.machine import renderer
from shadelab.machine.processor import LEVELS
from shadelab.paths import ROOT

WITHOUT_AVX2 = LEVELS[:2]


def last_line(text: str) -> str:
    return text.strip().splitlines()[-1] if text.strip() else ""


class Resident:
    """A program that has a frame ready and draws it on request: one line in, one line of JSON out."""

    def __init__(self, name: str, command: list[str], environment: dict[str, str]) -> None:
        self.name = name
        self.messages = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.messages, text=True, env=environment
        )
        self.ready: dict[str, Any] = {}

    def wait_until_ready(self) -> None:
        self.ready = self._answer()

    def ask(self, request: str) -> dict[str, Any]:
        try:
            self.process.stdin.write(request + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended; the answer, which does not come, says why
        return self._answer()

    def draw(self) -> float:
        """Milliseconds of one frame."""
        return self.ask("draw")["ms"]

    def image(self, file: Path) -> np.ndarray:
        """The last frame, by way of `file`: (H, W, channels) float32, row 0 at the top."""
        self.ask(f"write {file}")
        image = np.load(file)
        file.unlink()
        return image

    def peak_bytes(self) -> int:
        """The most memory that it has held so far."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status).group(1))

    def close(self) -> None:
        """The end of its input ends it."""
        try:
            self.process.stdin.close()
            self.process.wait(timeout=5)
        except (BrokenPipeError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.messages.close()

    def _answer(self) -> dict[str, Any]:
        line = self.process.stdout.readline()
        try:
            answer = json.loads(line)
        except ValueError:
            if not line:
                self.process.wait()
            self.messages.seek(0)
            why = last_line(self.messages.read().decode(errors="replace")) or line.strip() or "it ended"
            raise InfrastructureError(f"{self.name}: {why}") from None
        if "error" in answer:
            raise InfrastructureError(f"{self.name}: {answer['error']}")
        return answer


@contextmanager
def resident(name: str, command: list[str], environment: dict[str, str]) -> Iterator[Resident]:
    program = Resident(name, command, environment)
    try:
        program.wait_until_ready()
        yield program
    finally:
        program.close()


@dataclass
class Stand:
    """Where they stand: a folder for their files, how many threads they have, and which level of x86-64 they are held to
    (None: the best)."""

    folder: Path
    threads: int
    level: str | None = None

    def environment(self) -> dict[str, str]:
        """For the children. The two programs get the same number of threads and, without AVX2, both do without."""
        held = {"GALLIUM_OVERRIDE_CPU_CAPS": "sse4.1"} if self.level in WITHOUT_AVX2 else {}
        level = {"SHADELAB_LEVEL": self.level} if self.level else {}
        threads = {"OMP_NUM_THREADS": str(self.threads), "LP_NUM_THREADS": str(self.threads)}
        cache = {"MESA_SHADER_CACHE_DIR": str(self.folder / "shaders")}
        return {**ENVIRONMENT, **os.environ, "SHADELAB_ROOT": str(ROOT), **threads, **level, **held, **cache}

    @contextmanager
    def frames(
        self, scene: Path, assignment: Path, plugin: Path | None, view: renderer.View, double: bool = False
    ) -> Iterator[Resident]:
        """Our rasterizer, with any scene. `assignment`: the folder; without a plugin nothing is shaded."""
        described = renderer.describe(scene, assignment, view)
        command = renderer.frames(described, assignment, plugin, view, self.threads, double)
        with resident("shadelab-render frames", list(command.words), self.environment()) as program:
            yield program

    @contextmanager
    def opengl(self, scene: Path, assignment: Path, view: renderer.View) -> Iterator[Resident]:
        """OpenGL with the solution's shading.glsl, with any scene."""
        packet = self.folder / "frame.packet"
        renderer.packet(scene, assignment, packet, view)
        command = [sys.executable, "-I", "-m", "shadelab.measure.peer", str(packet), str(assignment / "shading.glsl")]
        with resident("llvmpipe", command, self.environment()) as program:
            packet.unlink()
            yield program
