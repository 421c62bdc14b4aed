"""Information-driven stereo mapping for mobile manipulators with ROS 2.

Compiled kernels are cached beside the code. Where that is not writable (a system-wide or
read-only installation) the cache is ``$XDG_CACHE_HOME/infomap_ros`` or ``~/.cache/infomap_ros``,
and where there is no home either, a folder of the user below the temporary folder.
``NUMBA_CACHE_DIR`` overrides all of this.
"""

import os as _os
import tempfile as _tempfile
from pathlib import Path as _Path


def _writable(folder: _Path) -> bool:
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    return existing.is_dir() and _os.access(existing, _os.W_OK | _os.X_OK)


def _kernel_cache(package: _Path) -> _Path | None:
    """Folder for compiled kernels; None for beside the code."""
    if all(_writable(room / "__pycache__") for room in (package, *package.glob("[a-z]*/"))):
        return None
    try:
        home = _Path(_os.environ.get("XDG_CACHE_HOME") or _Path.home() / ".cache")
        if _writable(home / "infomap_ros"):
            return home / "infomap_ros"
    except RuntimeError:  # no home
        pass
    return _private_folder(_Path(_tempfile.gettempdir()) / f"infomap_ros-{_os.getuid()}")


def _private_folder(folder: _Path) -> _Path:
    """The folder if it is this user's own, else a new one: kernels are code."""
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid == _os.getuid():
        return folder
    return _Path(_tempfile.mkdtemp(prefix="infomap_ros-"))


# numba reads the variable when it is imported, so this comes before any kernel.
if (_cache := _kernel_cache(_Path(__file__).resolve().parent)) is not None:
    _os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache))
