"""The processor, as an x86-64 level: which of the renderer's versions runs, and what plugins are compiled for."""

import os
import re
from functools import cache
from pathlib import Path

from shadelab.errors import UserError

LEVELS = ("plain", "v2", "v3", "v4")
_needed = {
    "v2": {"sse4_2", "popcnt"},
    "v3": {"avx2", "fma", "bmi2"},
    "v4": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
}


@cache
def processor_level(wanted: str | None = None) -> str:
    """The x86-64 level whose instructions renderer and plugins use: `wanted`, SHADELAB_LEVEL, or the best that the processor has.

    It changes the speed and no bit. "plain" is the compiler's default, and what other processors have.
    """
    try:
        flags = set(re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE).group(1).split())
    except (OSError, AttributeError):
        flags = set()
    best = "plain"
    for level in LEVELS[1:]:
        if not _needed[level] <= flags:
            break
        best = level
    asked = wanted or os.environ.get("SHADELAB_LEVEL") or best
    if asked not in LEVELS:
        raise UserError(f"SHADELAB_LEVEL={asked}: must be plain, v2, v3 or v4")
    if LEVELS.index(asked) > LEVELS.index(best):
        raise UserError(f"SHADELAB_LEVEL={asked}: this processor has {best} at most")
    return asked
