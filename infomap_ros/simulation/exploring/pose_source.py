"""Where the simulated robot has its camera's pose from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from infomap_ros.geometry import StereoRig, skew
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.stereo import RangeCloud, StereoConfig, StereoRangeSensor, StereoRectifier


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Where the left camera is in the map.

    Attributes:
        transform: ``T_map_camera``, shape (4, 4).
        covariance: shape (6, 6), convention of `geometry.transforms`.
    """

    transform: FloatArray
    covariance: FloatArray

    def moved(self, prior: MotionPrior) -> CameraPose:
        """After a motion that is known by its prior alone."""
        rotation, step = self.transform[:3, :3], prior.T_before_after[:3, 3]
        over = np.eye(6)
        over[:3, 3:] = -skew(rotation @ step)
        turn = np.kron(np.eye(2), rotation)
        covariance = over @ self.covariance @ over.T + turn @ prior.covariance @ turn.T
        return CameraPose(self.transform @ prior.T_before_after, covariance)


@dataclass(frozen=True, eq=False)
class PosedScan:
    """A range cloud with the pose from which it was taken.

    Attributes:
        stamp: [ns].
        cloud: in the frame of the left camera.
        pose: of the camera.
    """

    stamp: int
    cloud: RangeCloud
    pose: CameraPose


class PoseSource(Protocol):
    """Tells where the left camera is in the map, and takes scans from there.

    Attributes:
        rig: the rectified stereo pair.
    """

    @property
    def rig(self) -> StereoRig: ...  # noqa: D102

    def initialise(self) -> None:
        """Find out where the robot is before it moves for the first time.

        Raises:
            PoseUnavailableError: it cannot be found out.
        """

    def pose(self) -> CameraPose:
        """Where the camera is now.

        Raises:
            PoseUnavailableError: that was never known.
        """

    def take_scan(self, voxel_map: VoxelMap) -> PosedScan:
        """Take a stereo pair now.

        Raises:
            PoseUnavailableError: from where is not known well enough to map what is seen.
            SimulationError: this machine cannot draw images.
        """

    def watch(self, voxel_map: VoxelMap) -> str:
        """Called again and again on the way; empty, or why the robot should not go on."""

    def correct(self, correctable: CorrectableMap) -> None:
        """Let the scans of a map follow what became known of their poses since."""

    def save(self, path: Path) -> None:
        """Keep in a file what is needed to go on when this software was ended.

        Raises:
            MapFileError: the file cannot be written.
        """

    def resume(self, path: Path) -> None:
        """Go on from what was kept, in the same map; before anything else is asked.

        Raises:
            MapFileError: the file cannot be used.
        """


class MeasuredPoses:
    """The true pose with noise, as a good localisation would measure it. Implements `PoseSource`.

    Args:
        simulator: knows the truth.
        stereo: how pairs are measured.
    """

    def __init__(self, simulator: Simulator, stereo: StereoConfig) -> None:
        self._simulator = simulator
        self._rectifier = StereoRectifier(*simulator.calibrations)
        self.rig: StereoRig = self._rectifier.rig
        self._sensor = StereoRangeSensor(self.rig, stereo)

    def initialise(self) -> None:
        """Nothing is to be done."""

    def pose(self) -> CameraPose:
        """Where the camera is now, with new noise."""
        record = self._simulator.camera_pose()
        assert record.covariance is not None
        return CameraPose(record.transform, record.covariance)

    def take_scan(self, voxel_map: VoxelMap) -> PosedScan:
        """Take a stereo pair now; see `PoseSource`."""
        pair = self._simulator.capture()
        cloud = self._sensor.measure(*self._rectifier.rectify(pair.left, pair.right))
        return PosedScan(pair.stamp, cloud, self.pose())

    def watch(self, voxel_map: VoxelMap) -> str:
        """Nothing can go wrong."""
        return ""

    def correct(self, correctable: CorrectableMap) -> None:
        """Poses stay as they are."""

    def save(self, path: Path) -> None:
        """Nothing need be kept."""

    def resume(self, path: Path) -> None:
        """The simulator knows where the robot is."""
