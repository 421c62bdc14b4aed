"""Files that are there as they were or as they are to be, whenever the process ends."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import json
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

_PARTIAL = ".saving"
_NOT_A_FILE = "is a device, pipe or socket, not a file"
_ATTEMPTS = 100  # to open a file before another process takes it for remains

MALFORMED = LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError
"""What JSON of a wrong structure, or wrong numbers in it, can raise where it is read."""


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of another when the block ends without an error.

    It is written beside its final place, under a name that nobody can foresee, and renamed when it
    is on the disk: a reader, another writer, and whoever comes after a crash see the old file or
    the new one. A symbolic link at `path` is replaced; what it names stays as it is.

    Raises:
        OSError: it cannot be written, or at `path`, or where it leads to, is neither a regular file
            nor nothing (a device, a folder, links in a loop); what was there before stays.
    """
    target = Path(path)
    _check_replaceable(target)
    _remove_remains(target)
    partial, file = _begin(target)
    with file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
            partial.replace(target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_text(path: str | Path, text: str) -> None:
    """Write text to a file, as `replacing` does; raises as that does."""
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def write_json(path: Path, content: object) -> None:
    """Write JSON to a file, as `replacing` does; raises as that does."""
    write_text(path, json.dumps(content))


def save_figure(figure: Any, path: str | Path, dpi: float | None = None) -> None:
    """Write a figure of Matplotlib, as `replacing` does; the ending says its format."""
    with replacing(path) as file:
        figure.savefig(file, dpi=dpi or "figure", format=Path(path).suffix[1:])


def appending(path: str | Path) -> BinaryIO:
    """Open a file to add to its end; an OSError where it is a symbolic link, or no regular file."""
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
    file = os.fdopen(os.open(path, flags | os.O_NONBLOCK, 0o666), "ab")  # a pipe would wait
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise OSError(errno.EINVAL, _NOT_A_FILE, str(path))


def _check_replaceable(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    except ValueError as error:  # a name with a NUL
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    is_in_dev = path.parent.resolve() == Path("/dev")  # /dev/stdout leads to whatever it is sent to
    if is_in_dev or not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, _NOT_A_FILE, str(path))


def _begin(target: Path) -> tuple[Path, BinaryIO]:
    """A new file beside another, locked, so that nobody takes it for remains."""
    for _ in range(_ATTEMPTS):
        partial = target.with_name(f".{target.name}.{secrets.token_hex(4)}{_PARTIAL}")
        file = partial.open("xb")
        fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:  # not removed between the two
            return partial, file
        file.close()
    raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), str(target))


def _remove_remains(target: Path) -> None:
    """Remove what killed processes left of their attempts: files that nobody has locked."""
    for remains in target.parent.glob(f".{glob.escape(target.name)}.*{_PARTIAL}"):
        with contextlib.suppress(OSError):
            number = os.open(remains, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remains.unlink()
            finally:
                os.close(number)
