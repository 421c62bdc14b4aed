"""Real sequences in the layouts that people have, and what is told of each."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from infomap_ros.replay.sequences import SequenceOptions

CALIBRATIONS = Path(__file__).resolve().parents[2] / "benchmarks" / "calibrations"

KITCHEN_FLOOR = -1.53
"""Height of the kitchen's floor in its map, from planes fitted to it in six frames [m]."""


@dataclass(frozen=True)
class RealSequence:
    """A sequence below the folder of real data."""

    folder: str
    layout: str
    frames: int
    has_poses: bool = True
    options: SequenceOptions = field(default_factory=SequenceOptions)


REAL = {
    "kitchen": RealSequence(
        "rgbd_kitchen",
        "rgbd",
        250,
        options=SequenceOptions(
            calibration=[CALIBRATIONS / "rgbd_kitchen.yaml"], rate=30.0, down=(0.0, 0.893, 0.450)
        ),
    ),
    "tumvi": RealSequence("tumvi_room1", "euroc", 15),
    "kitti": RealSequence("stereo_kitti_03", "kitti", 5),
    "kitti curve": RealSequence("stereo_kitti_curve", "kitti", 51),
    "motorcycle": RealSequence(
        "stereo_motorcycle",
        "images",
        1,
        has_poses=False,
        options=SequenceOptions(
            left="*_left.png",
            right="*_right.png",
            calibration=[CALIBRATIONS / "motorcycle.txt"],
        ),
    ),
    "rover": RealSequence(
        "rover_sandbox/run1",
        "images",
        32,
        has_poses=False,
        options=SequenceOptions(calibration=[CALIBRATIONS / "rover_sandbox.yaml"]),
    ),
}
