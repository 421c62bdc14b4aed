"""Folders of images in the layouts that people have: mapped as they are, or made to bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.replay.bags.writer import BagWriter
from infomap_ros.replay.sequences.layouts import LAYOUTS, SequenceOptions, find_sequence
from infomap_ros.replay.sequences.sequence import ImageSequence, SequenceReader


def convert(
    layout: str,
    folder: Path,
    out: Path,
    options: SequenceOptions | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> int:
    """Write a folder of images as a bag.

    Args:
        layout: one of `LAYOUTS`.
        folder: where the images are.
        out: folder of the bag.
        options: what is told beside what is found.
        overwrite: replace a bag that is there.
        say: is told what was left out or assumed, in sentences.

    Returns:
        Number of messages.

    Raises:
        InvalidInputError: the layout is not known.
        BagError: the sequence is not complete, or the bag cannot be written.
        CalibrationError: there is no calibration that fits.
    """
    if layout not in LAYOUTS:
        raise InvalidInputError("layout", f"'{layout}', expected one of {', '.join(LAYOUTS)}")
    if not folder.is_dir():
        raise BagError(f"there is no folder {folder}")
    reader = SequenceReader(folder, LAYOUTS[layout](folder, options or SequenceOptions()))
    count = 0
    with BagWriter(out, overwrite=overwrite) as writer:
        for entry in reader.records():
            writer.write(entry.topic, entry.record)
            count += 1
    for text in (*reader.problems, *reader.skipped):
        say(text)
    return count


__all__ = [
    "LAYOUTS",
    "ImageSequence",
    "SequenceOptions",
    "SequenceReader",
    "convert",
    "find_sequence",
]
