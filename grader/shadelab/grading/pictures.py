"""Images of a grading, as files: what a submission drew, and beside it what was expected, so that any report can be made later.

evidence/BACKEND/SCENE.npy          (H, W, 13) float32, the CHANNELS up to coverage; where the scene is right in both languages
                                    (H, W, 3), the total alone
evidence/expected/SCENE.npz, .json  as in the expected data (truth/expected.py)
evidence/about.json                 what reports say beside the result
"""

import json
import shutil
import threading
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from shadelab.course.assignment import Scene
from shadelab.errors import UserError
from shadelab.files import whole, write_whole
from shadelab.paths import shown
from shadelab.result import Result
from shadelab.truth.expected import SceneTruth
from shadelab.truth.measures import tolerance

FOLDER = "evidence"


@contextmanager
def readable(file: Path) -> Iterator[None]:
    """What somebody cut, emptied or wrote over is one line that names the file. Raises UserError."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(f"{shown(file)}: is damaged, so no report can show it: {why}; grade again") from None


@dataclass
class Pictures:
    """Of one image check, read when somebody looks. Linear; row 0 is the top."""

    drawn: Path
    truth_file: Path

    @cached_property
    def layers(self) -> np.ndarray | None:
        """The student's (H, W, 13) float32, the CHANNELS up to coverage, or (H, W, 3), the total; None: there is no picture."""
        if not self.drawn.exists():
            return None
        with readable(self.drawn):
            return np.load(self.drawn, mmap_mode="r", allow_pickle=False)

    @cached_property
    def truth(self) -> SceneTruth:
        with readable(self.truth_file):
            truth = SceneTruth.load(self.truth_file)
        truth.layers = _Layers(truth.layers, self.truth_file)
        return truth

    @cached_property
    def limit(self) -> np.ndarray:
        """(H, W, 3): the tolerance of each pixel and channel of the total."""
        return np.ones_like(self.truth.total) if self.layers is None else tolerance(self.truth)

    @property
    def student(self) -> np.ndarray | None:
        return None if self.layers is None else self.layers[..., :3]

    @property
    def expected(self) -> np.ndarray:
        return self.truth.total


@dataclass
class _Layers(Mapping):
    """Those of a file, each read when it is asked for."""

    layers: Mapping[str, np.ndarray]
    file: Path

    def __getitem__(self, name: str) -> np.ndarray:
        with readable(self.file):
            return self.layers[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.layers)

    def __len__(self) -> int:
        return len(self.layers)


class PictureFolder:
    """`folder`: where they go. `kept`: whether they are for reports, with all that these need beside them. `hidden`: those of
    hidden scenes, too: without it a graded folder can be handed on, and shows nobody what the scenes look like."""

    def __init__(self, folder: Path, kept: bool, hidden: bool = False) -> None:
        # Absolute: an assignment's own checks read them from a process that stands in another folder.
        self.folder, self.kept, self._hidden = folder.absolute(), kept, hidden
        self._lock = threading.Lock()  # the languages are judged at the same time
        self._failed: set[str] = set()
        self._waiting: dict[str, tuple[str, np.ndarray]] = {}  # scene -> backend and layers of one that passed

    def keeps(self, scene: Scene) -> bool:
        return self.kept and (self._hidden or not scene.hidden)

    def clear(self) -> None:
        """An older run's pictures must not pass for this one's."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def file(self, backend: str, scene: str) -> Path:
        return self.folder / backend / f"{scene}.npy"

    def truth_file(self, scene: str) -> Path:
        return self.folder / "expected" / f"{scene}.npz"

    def keep(self, backend: str, scene: str, layers: np.ndarray | None, failed: bool) -> None:
        """What reports show: everything of a scene that fails in either language, of others the total. So one that passes waits
        for the other language's verdict; flush() is the end of waiting. `layers` is None when a failure gave no picture."""
        with self._lock:
            waiting = self._waiting.pop(scene, None)
            if failed:
                self._failed.add(scene)
            elif scene not in self._failed and waiting is None:
                self._waiting[scene] = backend, layers
                return
            whole = scene in self._failed
        for drawn_by, drawn in [(backend, layers), *([waiting] if waiting else [])]:
            if drawn is not None:
                self.save(drawn_by, scene, drawn if whole else drawn[..., :3])

    def flush(self) -> None:
        for scene, (backend, layers) in self._waiting.items():
            self.save(backend, scene, layers[..., :3])
        self._waiting.clear()

    def save(self, backend: str, scene: str, layers: np.ndarray) -> None:
        file = self.file(backend, scene)
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as part:
            np.save(part, layers)

    def keep_truth(self, expected: Path, scene: str) -> None:
        """Of the expected data's folder. A copy: whatever becomes of it, the next grading's truth is another file."""
        for suffix in (".npz", ".json"):
            target = self.truth_file(scene).with_suffix(suffix)
            if not target.exists():  # the other language's check of the scene may be here at the same time
                target.parent.mkdir(parents=True, exist_ok=True)
                with whole(target) as part:
                    shutil.copyfile(expected / f"{scene}{suffix}", part)

    def title(self) -> str | None:
        """Of the assignment; None where no pictures were kept. Raises UserError for a file that says nothing of the kind."""
        file = self.folder / "about.json"
        if not file.exists():
            return None
        with readable(file):
            return str(json.loads(file.read_text())["title"])

    def write_about(self, **facts: Any) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(self.folder / "about.json", json.dumps(facts, indent=1) + "\n")

    def of(self, result: Result) -> dict[str, Pictures]:
        """By the id of the image check."""
        out = {}
        for check in result.checks:
            scene = check.id.split("/")[-1]
            drawn, truth = self.file(check.backend, scene), self.truth_file(scene)
            if check.kind == "image" and truth.exists() and (drawn.exists() or check.status == "failed"):
                out[check.id] = Pictures(drawn, truth)
        return out
