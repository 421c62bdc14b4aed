"""Recorded real sequences in their own formats, as the records that a bag would give."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.replay.bags.writer import BagWriter
from infomap_ros.replay.sequences.entries import Entries, Entry
from infomap_ros.replay.sequences.kalibr import kalibr_pairs
from infomap_ros.replay.sequences.pairs import aloe, motorcycle, rover_pairs
from infomap_ros.replay.sequences.rgbd import kitchen, rgbd_frames

FORMATS: dict[str, Callable[[Path], Entries]] = {
    "rgbd": rgbd_frames,
    "kitchen": kitchen,
    "kalibr": kalibr_pairs,
    "rover": rover_pairs,
    "motorcycle": motorcycle,
    "aloe": aloe,
}
"""Readers by the name of the format."""


def convert(name: str, folder: Path, out: Path, overwrite: bool = False) -> int:
    """Write a recorded sequence as a bag.

    Args:
        name: format, one of `FORMATS`.
        folder: where the sequence is.
        out: folder of the bag.
        overwrite: replace a bag that is there.

    Returns:
        Number of messages.

    Raises:
        InvalidInputError: the format is not known.
        BagError: the sequence is not complete, or the bag cannot be written.
    """
    if name not in FORMATS:
        raise InvalidInputError("format", f"'{name}', expected one of {', '.join(FORMATS)}")
    if not folder.is_dir():
        raise BagError(f"there is no folder {folder}")
    count = 0
    with BagWriter(out, overwrite=overwrite) as writer:
        for topic, record in FORMATS[name](folder):
            writer.write(topic, record)
            count += 1
    return count


__all__ = ["FORMATS", "Entries", "Entry", "convert"]
