"""Where things stand in the checkout."""

import os
from pathlib import Path

ROOT = Path(os.environ.get("SHADELAB_ROOT") or Path(__file__).resolve().parents[2])
STATE = ROOT / ".shadelab"
RENDER = ROOT / "build" / "shadelab-render"
FRAMEWORK = ROOT / "framework"
SOLUTION = ROOT / "solution"
STARTER = ROOT / "starter"
SCENES = ROOT / "scenes"
EXPECTED = STATE / "expected"


def shown(path: Path | str) -> str:
    """The path as a user would type it: relative to the working folder where it lies below it."""
    try:
        return str(Path(path).resolve().relative_to(Path.cwd().resolve()))
    except ValueError:
        return str(path)
