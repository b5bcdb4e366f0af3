"""Where things stand in the checkout."""

import hashlib
import os
from pathlib import Path


def _state(root: Path) -> Path:
    """What is made on the way: in the checkout, or in the user's cache where the checkout is another user's or read-only."""
    own = root / ".shadelab"
    if os.access(own if own.exists() else root, os.W_OK):
        return own
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache) / "shadelab" / hashlib.sha256(str(root).encode()).hexdigest()[:16]


PACKAGE = Path(__file__).resolve().parent
ROOT = Path(os.environ.get("SHADELAB_ROOT") or PACKAGE.parents[1])
STATE = _state(ROOT)
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
