"""What the simulated robot measures of itself, and what is true of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    invert_transform,
    perturb_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_body import RobotBody
from infomap_ros.simulation.body.wheel_odometry import WheelOdometry

if TYPE_CHECKING:
    from infomap_ros.simulation.simulator import SimulatorConfig


class RobotSensors:
    """Joint encoders, odometry and a measured camera pose, all stamped with simulated time.

    Args:
        body: the robot, at rest.
        config: sizes of the errors.
        rngs: sources of the errors of joints, odometry and camera pose.
    """

    def __init__(
        self,
        body: RobotBody,
        config: SimulatorConfig,
        rngs: tuple[np.random.Generator, np.random.Generator, np.random.Generator],
    ) -> None:
        self.config, self._body = config, body
        self._rng, odometry, self._pose_rng = rngs
        self._odometry = WheelOdometry(config.odometry, body.base_pose(), odometry)
        self._period = config.dynamics.steps * config.dynamics.timestep
        self._ticks = 0

    @property
    def time(self) -> float:
        """Simulated time from the start [s]."""
        return self._ticks * self._period

    @property
    def stamp(self) -> int:
        """Simulated time as a stamp [ns]."""
        return round((self.config.start_time + self.time) * 1e6) * 1000

    def joint_state(self) -> JointStateRecord:
        """Positions of all joints, with noise."""
        positions = self._body.joint_positions()
        noise = self._rng.normal(0.0, self.config.joint_noise, len(positions))
        return JointStateRecord(
            self.stamp, "", tuple(positions), np.array(list(positions.values())) + noise
        )

    def odometry(self) -> OdometryRecord:
        """Dead-reckoned ``T_odom_base`` with its covariance."""
        estimate = self._odometry.estimate()
        return OdometryRecord(
            self.stamp,
            "odom",
            estimate.transform,
            estimate.covariance,
            self.config.robot.base_frame,
            estimate.twist,
            estimate.twist_covariance,
        )

    def odometry_camera_pose(self) -> FloatArray:
        """``T_odom_camera`` of the left optical frame as odometry and joints have it, (4, 4)."""
        T_base_camera = invert_transform(self.true_pose()) @ self.true_camera_pose()
        return self._odometry.estimate().transform @ T_base_camera

    def camera_pose(self) -> PoseRecord:
        """Left optical frame in the map, as a good localization would measure it."""
        config = self.config
        sigma = np.repeat([config.position_noise, config.rotation_noise], 3)
        measured = perturb_transform(
            self.true_camera_pose(), self._pose_rng.normal(0.0, np.maximum(sigma, 0.0))
        )
        covariance = np.diag(np.maximum(sigma, 1e-6) ** 2)
        frame = self.config.robot.left_camera_frame
        return PoseRecord(self.stamp, "map", measured, covariance, frame)

    def true_pose(self) -> FloatArray:
        """``T_world_base``, shape (4, 4)."""
        return self._body.base_pose()

    def true_camera_pose(self) -> FloatArray:
        """``T_world_camera`` of the left optical frame, shape (4, 4)."""
        return self._body.frame(self.config.robot.left_camera_frame)

    def true_joints(self) -> dict[str, float]:
        """Positions of all joints by name, without noise [rad or m]."""
        return dict(self._body.joint_positions())

    def frame(self, link: str) -> FloatArray:
        """True ``T_world_link``, shape (4, 4).

        Raises:
            RobotModelError: the robot has no such link.
        """
        return self._body.frame(link)

    @property
    def camera_frames(self) -> tuple[str, str]:
        """Names of the left and right optical frame."""
        robot = self.config.robot
        return robot.left_camera_frame, robot.right_camera_frame or (
            f"{robot.left_camera_frame}_right"
        )

    @property
    def T_world_odom(self) -> FloatArray:
        """Where the odom frame truly is, shape (4, 4)."""
        return self._odometry.T_world_odom
