"""A command line, with the files that it needs: what a sandbox has to let through, and nothing else."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Command:
    words: tuple[str, ...]
    reads: tuple[Path, ...] = ()  # files and folders
    writes: tuple[Path, ...] = ()
