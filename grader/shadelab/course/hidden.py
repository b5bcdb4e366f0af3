"""Hidden scenes: solution/NAME/hidden.toml, which is never given to students, varies public ones.

seed = "..."                            # one per package, the same for every student; results record its digest only
[[family]]
name = "moved-lights"                   # its scenes are called hidden-moved-lights, and -2, -3 ... when there are several
base = "../../scenes/NAME/SCENE.toml"
points = 4                              # per scene
vary = [{ key = "light[0].position", low = [-2, 2, 1], high = [2, 4, 3] }]
"""

import hashlib
import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from pydantic import Field

from shadelab.course.toml_files import Declared, read_toml, validated
from shadelab.errors import UserError
from shadelab.paths import kept, shown


class Variation(Declared):
    """One value of a scene file that a hidden scene draws anew, each number of it between `low` and `high`."""

    key: str  # as in "light[0].position" or "material.clay.q"
    low: float | list[float]
    high: float | list[float]
    scale: Literal["linear", "log"] = "linear"


class Family(Declared):
    name: str
    base: str
    points: float = Field(0, ge=0)  # per scene
    scenes: int = Field(1, ge=1)
    vary: list[Variation]


class Hidden(Declared):
    seed: str = ""
    family: list[Family] = []

    @property
    def seed_digest(self) -> str:
        return hashlib.sha256(self.seed.encode()).hexdigest()[:16] if self.family else "no hidden scenes"


FILE = "hidden.toml"
_step = re.compile(r"\.?([\w-]+)|\[(\d+)\]")


def load_hidden(directory: Path) -> Hidden:
    file = directory / FILE
    return validated(Hidden, file) if file.exists() else Hidden()


def hidden_scene_files(declared: Hidden, directory: Path, assignment: str) -> Iterator[tuple[Path, Family, int]]:
    """The files of all families, with the number of the scene in its family.

    They stand below a folder that is named by what they are made from (the seed, the declaration, the bases, this code), so they
    change with that and with nothing else.
    """
    if not declared.family:
        return
    made_from = hashlib.sha256(declared.model_dump_json().encode() + Path(__file__).read_bytes())
    for base in (_base(directory, family) for family in declared.family):
        made_from.update(b"\0" + (base.read_bytes() if base.exists() else b""))
    folder = kept("hidden", made_from.hexdigest()[:16], assignment)
    for family in declared.family:
        for number in range(1, family.scenes + 1):
            yield folder / (f"hidden-{family.name}" + (f"-{number}" if number > 1 else "") + ".toml"), family, number


def draw_hidden_scenes(declared: Hidden, directory: Path, assignment: str) -> None:
    """Writes the files that are not there yet."""
    for file, family, number in hidden_scene_files(declared, directory, assignment):
        if file.exists():
            continue
        base = _base(directory, family)
        scene = _varied(read_toml(base), family, declared.seed, number, shown(directory / FILE))
        for entry in scene.get("object", []):
            entry["mesh"] = os.path.relpath((base.parent / entry["mesh"]).resolve(), file.parent)
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
        temporary.write_text(tomli_w.dumps(scene))
        os.replace(temporary, file)


def _base(directory: Path, family: Family) -> Path:
    return (directory / family.base).resolve()


def _varied(scene: dict[str, Any], family: Family, seed: str, number: int, where: str) -> dict[str, Any]:
    digest = hashlib.sha256(f"{seed}/{family.name}/{number}".encode()).digest()
    rng = np.random.default_rng(list(digest))
    for vary in family.vary:
        at = f"{where}: {family.name}: {vary.key}"
        *path, last = [m[1] if m[1] else int(m[2]) for m in _step.finditer(vary.key)]
        holder: Any = scene
        try:
            for step in path:
                holder = holder[step]
            present = holder[last]
        except (KeyError, IndexError, TypeError):
            raise UserError(f"{at}: {family.base} has no such value") from None
        low, high = np.asarray(vary.low, float), np.asarray(vary.high, float)
        if np.asarray(present).dtype.kind not in "if" or not low.shape == high.shape == np.shape(present):
            raise UserError(f"{at}: low and high must be like the value in {family.base}: {present}")
        share = rng.uniform(size=low.shape)
        value = low + (high - low) * share if vary.scale == "linear" else low * (high / low) ** share
        holder[last] = np.round(value, 6).tolist()
    return scene
