"""stability.toml, beside an assignment's manifest: what cannot be read off the domains about their ends.

[[function]]
name = "beckmann"
points = 3                               # both languages together
idea = "..."                             # the better form, for whoever loses these points
reciprocal = { swap = ["l", "v"] }       # promised: equal when these change places; per = "n.l" divides each by its own n.l first
ordered = [["hotspot", "falloff"]]       # the first is never larger
[[function.case]]                        # rows for one stiff case
name = "m = 1e-4"
hazards = [6]                            # numbers of docs/stability.md
pin = { m = 1e-4, h = { near = "n", by = [1e-6, 1e-3] } }

A pinned column is a constant, a copy of another ("light.position", "-v"), or lies close to one: `near` another direction or to
"mirror(l)", `by` an angle in radians between the two (positions: a distance), spread over its logarithm.
"""

from collections.abc import Collection
from pathlib import Path

from pydantic import Field

from shadelab.course.toml_files import Declared, validated
from shadelab.errors import UserError
from shadelab.paths import shown

FILE = "stability.toml"


class Near(Declared):
    near: str
    by: tuple[float, float]


class Case(Declared):
    name: str
    hazards: list[int] = []
    pin: dict[str, float | list[float] | str | Near] = {}


class Reciprocal(Declared):
    swap: tuple[str, str]
    per: str | None = None  # "n.l": divided by the dot product of these two arguments first


class Stable(Declared):
    """What is declared of one function."""

    name: str
    points: float = Field(0, ge=0)
    idea: str = ""
    reciprocal: Reciprocal | None = None
    ordered: list[tuple[str, str]] = []
    case: list[Case] = []


class _File(Declared):
    function: list[Stable] = []


def load_stability(directory: Path, functions: Collection[str]) -> dict[str, Stable]:
    """By function; empty where nothing is declared."""
    file = directory / FILE
    if not file.exists():
        return {}
    declared: _File = validated(_File, file)
    for stable in declared.function:
        if stable.name not in functions:
            raise UserError(f"{shown(file)}: {stable.name}: the manifest declares no such function")
        if stable.points and not stable.idea:
            raise UserError(f"{shown(file)}: {stable.name}: whoever loses its points needs an idea")
    return {stable.name: stable for stable in declared.function}
