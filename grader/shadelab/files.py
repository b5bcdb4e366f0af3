"""Files that appear whole or not at all, and errors that say which file it was."""

import errno
import fcntl
import os
import re
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from shadelab.errors import UserError
from shadelab.paths import shown


@contextmanager
def whole(file: Path) -> Iterator[Path]:
    """Gives a path beside `file` to write to, which takes its place at the end: whoever reads, or kills us, finds a whole file,
    the old or the new one. Raises OSError that names `file`."""
    part = file.with_name(f".{os.getpid()}-{threading.get_ident()}.{file.name}")  # the suffix says which format it is
    try:
        with naming(file, made_as=part):
            yield part
            os.replace(part, file)
    finally:
        with suppress(OSError):  # what went wrong first is what is told
            part.unlink(missing_ok=True)


def write_whole(file: Path, text: str) -> None:
    with whole(file) as part:
        part.write_text(text, encoding="utf-8")


@contextmanager
def naming(path: Path, made_as: Path | None = None) -> Iterator[None]:
    """An OSError that names no file, as while one that is open is written, gets this one; so does one that names `made_as`, where
    it is put together, or what stands below."""
    try:
        yield
    except OSError as error:
        code, why, name = error.errno, error.strerror, str(error.filename2 or error.filename or path)
        if isinstance(error, shutil.Error):  # of a whole folder: a list, of which the first tells enough
            _, name, said = error.args[0][0]
            why = re.sub(r"^\[Errno \d+\] ([^:]*).*$", r"\1", said)
        if made_as is not None and Path(name).is_relative_to(made_as):
            name = str(path / Path(name).relative_to(made_as))
        # numpy counts what was written, and gives no reason
        raise OSError(code or errno.EIO, why or f"could not be written whole ({error})", name) from None


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Nobody else who asks for it writes in the folder meanwhile. The lock belongs to this process: it goes however that ends.
    Raises UserError."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise UserError(
            f"{shown(folder)}: another grading is writing there; wait until it is done, or choose another folder with --out"
        ) from None
    except OSError:
        pass  # this file system knows no locks
    try:
        yield
    finally:
        os.close(handle)
