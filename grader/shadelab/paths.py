"""Where things stand in the checkout."""

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
ROOT = Path(os.environ.get("SHADELAB_ROOT") or PACKAGE.parents[1])
STATE = ROOT / ".shadelab"
RENDER = ROOT / "build" / "shadelab-render"
FRAMEWORK = ROOT / "framework"
# In a release, the manifests of its assignments, and of the given ones the code as well.
SOLUTION = ROOT / ("solution" if (ROOT / "solution").is_dir() else "assignments")
STARTER = ROOT / "starter"
SCENES = ROOT / "scenes"
EXPECTED = STATE / "expected"
SHIPPED = ROOT / "expected"  # in a release: the public part, ready made


def shown(path: Path | str) -> str:
    """The path as a user would type it: relative to the working folder where it lies below it."""
    try:
        return str(Path(path).resolve().relative_to(Path.cwd().resolve()))
    except ValueError:
        return str(path)
