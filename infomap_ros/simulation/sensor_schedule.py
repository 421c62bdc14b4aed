"""What the sensors of a simulated robot measure, when it is due."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from infomap_ros.geometry import CameraInfoRecord, ImageRecord, PoseRecord, Record
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.simulation.simulator import Simulator

TICK = 0.02
"""Simulated time between two looks at what is due [s]."""

SIDES = ("left", "right")

Measured = list[tuple[str, Record]]
"""Records with the topics on which they belong, in their order."""

_STATE_RATE = 20.0  # of joint_states, odom and camera_pose [Hz]


@dataclass(frozen=True)
class SensorScheduleConfig:
    """What is measured and how often, in simulated time.

    Raises:
        ConfigError: a value is out of its range.
    """

    image_rate: float = parameter(1.0, "Stereo pairs per second.", unit="Hz", low=0.01, high=60.0)
    images_while_moving: bool = setting(
        True, "Take pairs while the robot moves; drawing them is what takes most of the time."
    )
    publish_camera_pose: bool = parameter(
        True,
        "Publish camera_pose: the true pose with the noise of position_noise and rotation_noise, "
        "in place of a localization. Off where another node localizes.",
    )

    def __post_init__(self) -> None:
        check_config(self)


class Due(NamedTuple):
    """What is due now.

    Attributes:
        state: what joints and odometry measure.
        image: what cameras see; then the state is due as well.
    """

    state: bool
    image: bool


class Periodic:
    """Something that is done at a rate [Hz] of simulated time, from 0 on."""

    def __init__(self, rate: float) -> None:
        self._period, self._next = 1.0 / rate, 0.0

    def is_due(self, now: float) -> bool:
        """Whether it is to be done at the time `now` [s]; that counts as done."""
        if now < self._next - 1e-9:
            return False
        self._next = max(self._next + self._period, now)
        return True


class SensorSchedule:
    """Says what is due, and measures.

    Args:
        simulator: of the robot.
        config: what is measured.
        map_frame: in which camera_pose is given.
    """

    def __init__(
        self, simulator: Simulator, config: SensorScheduleConfig, map_frame: str = "map"
    ) -> None:
        self._simulator, self._config, self._map_frame = simulator, config, map_frame
        self._state, self._image = Periodic(_STATE_RATE), Periodic(config.image_rate)

    def due(self) -> Due:
        """What is due by now; it counts as done."""
        simulator, config = self._simulator, self._config
        may_look = config.images_while_moving or not simulator.is_moving
        image = may_look and self._image.is_due(simulator.time)
        return Due(self._state.is_due(simulator.time) or image, image)

    def state(self) -> Measured:
        """What joints and odometry measure now, and where the camera is measured to be."""
        simulator = self._simulator
        measured: Measured = [
            ("joint_states", simulator.joint_state()),
            ("odom", simulator.odometry()),
        ]
        if self._config.publish_camera_pose:
            pose = simulator.camera_pose()
            record = PoseRecord(simulator.stamp, self._map_frame, pose.transform, pose.covariance)
            measured.append(("camera_pose", record))
        return measured

    def camera_infos(self) -> Measured:
        """What is known of the two cameras."""
        simulator = self._simulator
        return [
            (f"{side}/camera_info", CameraInfoRecord(simulator.stamp, frame, calibration))
            for side, frame, calibration in zip(
                SIDES, simulator.camera_frames, simulator.calibrations, strict=True
            )
        ]

    def pair(self) -> Measured:
        """The raw images of a stereo pair that is taken now.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        simulator = self._simulator
        stamp, pair = simulator.stamp, simulator.capture()
        return [
            (f"{side}/image_raw", ImageRecord(stamp, frame, pixels, "mono8"))
            for side, frame, pixels in zip(
                SIDES, simulator.camera_frames, (pair.left, pair.right), strict=True
            )
        ]
