"""What is taken from a submission: the files that the manifest names and nothing else."""

from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.errors import UserError
from shadelab.paths import shown
from shadelab.words import decoded, has_mark

MAX_BYTES = 1 << 20


def take(submission: Path, assignment: Assignment, folder: Path) -> dict[str, str | None]:
    """Copies the named files into `folder`. Returns for each name None, or why it could not be taken."""
    if not submission.is_dir():
        raise UserError(
            f"{shown(submission)}: there is no such folder; give the folder that holds {' and '.join(assignment.files)}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    out: dict[str, str | None] = {}
    for name in assignment.files:
        source, target = submission / name, folder / name
        target.unlink(missing_ok=True)
        if source.is_symlink() or (source.exists() and not source.is_file()):
            out[name] = f"{name}: must be a regular file, not a link or a folder"
        elif not source.exists():
            near = [f.name for f in submission.iterdir() if f.name.lower() == name.lower()]
            out[name] = f"{name} is missing" + (f"; it must be called {name}, not {near[0]}" if near else "")
        elif source.stat().st_size > MAX_BYTES:
            out[name] = f"{name} is larger than {MAX_BYTES >> 20} MiB"
        else:
            # Some editors begin a file with a byte order mark, or write UTF-16; compilers know neither. Nothing else is changed.
            data = source.read_bytes()
            target.write_bytes(decoded(data).encode() if has_mark(data) else data)
            out[name] = None
    return out
