"""Where compiled kernels are kept.

numba notices a change of the file that holds a kernel, not of the kernels which that one calls. The
cache therefore lies in a folder named after the state of the sources of all folders with kernels:
``__pycache__/kernels-<digest>`` of the package, or where that is not writable (a system-wide or
read-only installation) ``$XDG_CACHE_HOME/infomap_ros`` or ``~/.cache/infomap_ros``, and where there
is no home either, a folder of the user below the temporary folder. ``NUMBA_CACHE_DIR`` overrides
all of this.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

_KEPT = 7 * 24 * 3600.0
"""Age at which the cache of an older state is dropped [s]."""


def _writable(folder: Path) -> bool:
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def _private_folder(folder: Path) -> Path:
    """The folder if it is this user's own, else a new one: kernels are code."""
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid == os.getuid():
        return folder
    return Path(tempfile.mkdtemp(prefix="infomap_ros-"))


def _root(package: Path) -> Path:
    if _writable(package / "__pycache__"):
        return package / "__pycache__"
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        if _writable(home / "infomap_ros"):
            return home / "infomap_ros"
    except RuntimeError:  # no home
        pass
    return _private_folder(Path(tempfile.gettempdir()) / f"infomap_ros-{os.getuid()}")


def _compiled(text: bytes) -> bool:
    """Whether a source says that something in it is compiled."""
    return b"njit" in text or b"geometry.kernel import" in text


def _source_digest(package: Path) -> str:
    """Digest over the folders that hold kernels."""
    sources = sorted(package.rglob("*.py"))
    folders = {source.parent for source in sources if _compiled(source.read_bytes())}
    digest = hashlib.sha256()
    for source in sources:
        if source.parent in folders and source.parent != package:
            state = source.stat()
            digest.update(f"{source}:{state.st_size}:{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:16]


def use_kernel_cache(package: Path) -> None:
    """Point numba to the cache of this state of the package, and drop old ones."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = _root(package)
    folder = root / f"kernels-{_source_digest(package)}"
    if not folder.exists():
        for older in root.glob("kernels-*"):
            if older.stat().st_mtime < time.time() - _KEPT:
                shutil.rmtree(older, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:  # it has read the variable already
        sys.modules["numba"].config.CACHE_DIR = str(folder)
