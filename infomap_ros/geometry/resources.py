"""Files that belong to the package: robot descriptions, parameter files, small bags.

A source checkout has them beside the package (``config/rover.urdf``); an installation puts them
into ``share/infomap_ros`` of its prefix (``share/infomap_ros/config/rover.urdf``).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import infomap_ros
from infomap_ros.errors import ResourceError


def find_share(relative: str | os.PathLike[str]) -> Path:
    """Find a file or folder of the package, from a source checkout or an installation.

    A source checkout wins over an installation, so that what one edits is what one runs.

    Args:
        relative: path below the share folder, for example ``config/rover.urdf``.

    Returns:
        Absolute path that exists.

    Raises:
        ResourceError: it is absolute, or in none of the places; names them all.
    """
    wanted = Path(relative)
    if wanted.is_absolute():
        known = "is absolute, expected a path below share/infomap_ros"
        raise ResourceError(f"{wanted} {known if wanted.exists() else 'is not there'}")
    folders = list(dict.fromkeys(_share_folders()))
    for folder in folders:
        if (folder / wanted).exists():
            return (folder / wanted).resolve()
    places = ", ".join(str(folder) for folder in folders)
    raise ResourceError(f"{wanted} belongs to infomap_ros but is in none of: {places}")


def _share_folders() -> Iterator[Path]:
    package = Path(infomap_ros.__file__).resolve().parent
    if (package.parent / "package.xml").is_file() or (package.parent / "pyproject.toml").is_file():
        yield package.parent
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in (*filter(None, prefixes), sys.prefix):
        yield Path(prefix) / "share" / "infomap_ros"
    # Installed with --prefix or by colcon and run without its setup file.
    for parent in package.parents:
        if parent.name in ("lib", "local"):
            yield parent.parent / "share" / "infomap_ros"
