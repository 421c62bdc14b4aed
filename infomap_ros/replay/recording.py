"""A recording that somebody has: a bag, or a folder of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.reader import BagReader, Recording
from infomap_ros.replay.sequences import SequenceOptions, SequenceReader, find_sequence

__all__ = ["Recording", "open_recording"]

_BAG_FILES = ("*.mcap", "*.db3", "metadata.yaml", "*.mcap.zstd", "*.db3.zstd")


def open_recording(path: Path | str, calibration: Sequence[Path] = ()) -> Recording:
    """Open a bag, or a folder of images in one of the layouts of `infomap_ros.replay.sequences`.

    Args:
        path: rosbag2 folder or file, ROS 1 bag, or folder of images.
        calibration: files with the calibration of the images; looked for in the folder where
            none is given. Not for bags, which hold their own.

    Raises:
        BagError: there is nothing, or it cannot be read; says what is there.
    """
    path = Path(path)
    is_folder = path.is_dir() and not any(list(path.glob(name)) for name in _BAG_FILES)
    if is_folder:
        return SequenceReader(path, find_sequence(path, SequenceOptions(calibration=calibration)))
    if calibration:
        raise BagError(f"{path} is a bag: the calibration is in its camera infos")
    return BagReader(path)
