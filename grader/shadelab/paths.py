"""Where things stand in the checkout, and where what is made while it is used."""

import hashlib
import os
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
RECORD = "release.json"  # at the top of a release: what it is one of
ROOT = Path(os.environ.get("SHADELAB_ROOT") or PACKAGE.parents[1])
SET_UP = ROOT / ".shadelab"  # what ./shadelab made


def _state() -> Path:
    """SHADELAB_STATE, or the checkout's own folder, or for one that cannot be written to a folder of the user's."""
    if given := os.environ.get("SHADELAB_STATE"):
        return Path(given).absolute()
    if os.access(SET_UP if SET_UP.exists() else ROOT, os.W_OK):
        return SET_UP
    home = os.environ.get("HOME")
    cache = os.environ.get("XDG_CACHE_HOME") or (f"{home}/.cache" if home else tempfile.gettempdir())
    return Path(cache).absolute() / "shadelab" / f"{ROOT.name}-{hashlib.sha256(str(ROOT).encode()).hexdigest()[:12]}"


STATE = _state()
RENDER = ROOT / "build" / "shadelab-render"
FRAMEWORK = ROOT / "framework"
# In a release, the manifests of its assignments, and of the given ones the code as well.
SOLUTION = ROOT / ("solution" if (ROOT / "solution").is_dir() else "assignments")
STARTER = ROOT / "starter"
SCENES = ROOT / "scenes"
SHIPPED = ROOT / "expected"  # in a release: the public part, ready made


def kept(*names: str) -> Path:
    """A folder of STATE; where the checkout has it already, and STATE is elsewhere, that one: it is read and not written to."""
    own = SET_UP.joinpath(*names)
    return own if STATE != SET_UP and os.access(own, os.R_OK | os.X_OK) else STATE.joinpath(*names)


def shown(path: Path | str) -> str:
    """The path as a user would type it: relative to the working folder where it lies below it."""
    try:
        return str(Path(path).resolve().relative_to(Path.cwd().resolve()))
    except ValueError:
        return str(path)
