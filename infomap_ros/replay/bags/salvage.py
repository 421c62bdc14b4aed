"""Opens a damaged bag, whatever its format."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from backports import zstd

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.blocks import Salvage, SalvagedSource
from infomap_ros.replay.bags.salvage_mcap import salvage_mcap
from infomap_ros.replay.bags.salvage_rosbag1 import salvage_rosbag1
from infomap_ros.replay.bags.salvage_sqlite import salvage_sqlite, stated_size

_PIECE = 1 << 16

SALVAGERS: dict[str, Callable[[Path], Salvage]] = {
    ".mcap": salvage_mcap,
    ".db3": salvage_sqlite,
    ".bag": salvage_rosbag1,
}


def open_salvage(path: Path) -> SalvagedSource:
    """Open a damaged bag, file by file and without its metadata and index.

    Compressed files, and SQLite files that were cut off, are copied to a temporary folder.

    Raises:
        BagError: none of its files is a bag.
    """
    folder = tempfile.TemporaryDirectory(prefix="infomap_bag_")
    parts, failures = [], []
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        try:
            ready, problems = _prepared(file, Path(folder.name))
            if ready.suffix in SALVAGERS:
                part = SALVAGERS[ready.suffix](ready)
                part.problems[:0] = problems
                parts.append(part)
        except BagError as error:
            failures.append(str(error))
    if not parts:
        folder.cleanup()
        raise BagError("; ".join(failures) or f"{path} holds no bag files")
    parts[0].problems[:0] = failures
    if path.is_dir() and not (path / "metadata.yaml").exists():
        parts[0].problems.insert(0, f"{path.name} has no metadata.yaml")
    return SalvagedSource(parts, folder.cleanup)


def _prepared(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """The file in a form that can be read from its beginning, and what was wrong with it."""
    problems: list[str] = []
    if file.suffix == ".zstd":
        file, problems = _unpacked(file, folder)
    if file.suffix == ".db3" and 0 < file.stat().st_size < (size := stated_size(file)):
        problems.append(f"{file.name} is truncated: it has {file.stat().st_size} of {size} bytes")
        file = _filled(file, folder, size)
    return file, problems


def _unpacked(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """Unpack a compressed file as far as it goes."""
    target = folder / file.stem
    with file.open("rb") as raw, target.open("wb") as out:
        try:
            with zstd.open(raw, "rb") as packed:
                shutil.copyfileobj(packed, out, _PIECE)
        except (EOFError, zstd.ZstdError) as error:
            return target, [f"{file.name} is damaged: {error}"]
    return target, []


def _filled(file: Path, folder: Path, size: int) -> Path:
    """A copy with zeros for what is missing: SQLite refuses a file that is too short."""
    target = folder / f"filled_{file.name}"
    shutil.copyfile(file, target)
    with target.open("r+b") as out:
        out.truncate(size)
    return target
