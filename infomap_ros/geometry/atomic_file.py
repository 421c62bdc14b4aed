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
from typing import BinaryIO

_PARTIAL = ".saving"
_ATTEMPTS = 100  # to open a file before another process takes it for remains


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of another when the block ends without an error.

    It is written beside its final place, under a name that nobody can foresee, and renamed when it
    is on the disk: a reader, another writer, and whoever comes after a crash see the old file or
    the new one. Where `path` is a symbolic link, what it names is replaced.

    Raises:
        OSError: it cannot be written, or `path` is neither a regular file nor free for one (a
            device, a folder, links in a loop); what was there before stays.
    """
    target = _regular(Path(path))
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
    """Write text to a file, as `replacing` does.

    Raises:
        OSError: the file cannot be written; what was there before stays.
    """
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def write_json(path: Path, content: object) -> None:
    """Write JSON to a file, as `replacing` does; raises as `write_text` does."""
    write_text(path, json.dumps(content))


def _regular(path: Path) -> Path:
    """Where the links of a path lead to, which is a regular file or free."""
    try:
        target = path.resolve()
        mode = target.stat().st_mode
    except FileNotFoundError:
        return target
    except RuntimeError as error:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from error
    except ValueError as error:  # a name with a NUL
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a device, pipe or socket, not a file", str(path))
    return target


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
