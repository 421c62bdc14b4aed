"""The robot as the exploration sees it, moved through base_path and arm_trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.exploration.planar import planar_pose
from infomap_ros.exploration.robot import Interrupted, Motion, RobotState
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import POINT_CLOUD
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.arm.controller_trajectories import stopping_path
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.motion_result import MotionResult, Outcome
from infomap_ros.nodes.planning.motion_results import MotionResults
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig


@dataclass(frozen=True)
class RosRobotConfig:
    """When a motion of the robot counts as done, and when as failed.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = parameter(
        0.12, "The base has arrived when it rests so near the end of its path.", unit="m", low=0.001
    )
    heading_tolerance: float = parameter(
        0.2,
        "The base has arrived when its heading is so near the wanted one.",
        unit="rad",
        low=0.01,
    )
    joint_tolerance: float = parameter(
        0.03, "The arm has arrived when every joint is so near its goal.", unit="rad or m", low=1e-4
    )
    patience: float = parameter(
        15.0,
        "A motion has failed when nothing has moved for so long, and a look when no scan has been "
        "fused for so long. A motion may take as long as it likes while it goes on.",
        unit="s",
        low=0.5,
        high=600.0,
    )
    scans_per_view: int = parameter(
        2,
        "Stereo pairs that are fused at each view: one look rarely makes a voxel free.",
        low=1,
        high=100,
    )

    def __post_init__(self) -> None:
        check_config(self)


_STILL = 0.02  # [m or rad]; what moves less stands: poses are noisy


class RosRobot:
    """Implements `infomap_ros.exploration.robot.Robot`; called by one thread that may block.

    Args:
        node: publishes base_path and arm_trajectory, listens to map_updates.
        tracker: knows where the robot is.

    Attributes:
        in_odometry: ways of the base are given in the frame of odometry, not in the map.
    """

    in_odometry = False

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._config, self._tracker = node.config(RosRobotConfig), tracker
        self._map_frame = node.config(RobotTrackerConfig).map_frame
        self._clock, self._types = node.get_clock(), RclpyMessageTypes()
        self._results = MotionResults(node, tracker.notify)
        self._fused, self._last_base = 0, (0.0, 0.0, 0.0)
        self._paths = node.advertise(Path, "base_path", qos.stream(depth=1))
        self._trajectories = node.advertise(JointTrajectory, "arm_trajectory", qos.stream(depth=1))
        node.listen(PointCloud2, "map_updates", self._on_update, qos.stream(depth=50))
        self._newest_update = 0

    def state(self) -> RobotState:
        """Where it is now; see `RobotTracker.state`. Waits where messages were lost."""
        self._wait(self._tracker.is_complete, self._config.patience, lambda: False)
        return self._tracker.state()

    @property
    def sees(self) -> bool:
        """Whether a scan has been fused since this object was made."""
        return self._fused > 0

    def look(self, interrupted: Interrupted) -> str:
        """Wait until scans taken from here have been fused."""
        before, wanted = self._fused, self._config.scans_per_view + 1  # one may be from before
        done = self._wait(
            lambda: self._fused - before >= wanted, self._config.patience, interrupted
        )
        return "" if done else f"no new scan was fused within {self._config.patience:g} s"

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """Send the trajectory and wait for its result, or until the joints are where it ends."""
        goal = dict(zip(path.joint_names, path.positions[-1], strict=True))
        label = f"trajectory {self._now()}"
        self._trajectories.publish(encode_arm_trajectory(self._types, 0, path, label=label))
        end = self._finish(
            lambda: self._farthest(goal)[1] <= self._tolerance,
            lambda: self._results.of_trajectory(label),
            interrupted,
        )
        if end is not None:
            return Motion(end)
        name, error = self._farthest(goal)
        self._hold_arm(path)
        return Motion(_broken_off(interrupted, f"{name} has stopped {error:.3f} off its goal"))

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Send the path and wait for its result, or until the base rests at its end."""
        stamp = self._send_path(poses)
        travelled = [self.place()]

        def arrived() -> bool:
            travelled.append(self.place())
            left, turn = _away(travelled[-1], poses[-1])
            near = left <= self._config.position_tolerance
            return near and turn <= self._config.heading_tolerance

        end = self._finish(arrived, lambda: self._results.of_path(stamp), interrupted)
        path = [(x, y, 0.0) for x, y, _ in _thinned(travelled)]
        if end is not None:
            return Motion(end, path)
        here = self.place()
        self._send_path(np.array([here]))  # stay
        left, turn = _away(here, poses[-1])
        stopped = f"the base has stopped {left:.2f} m and {turn:.2f} rad from its goal"
        return Motion(_broken_off(interrupted, stopped), path)

    def place(self) -> tuple[float, float, float]:
        """Where the base is, or was when that was last known: messages may be lost on the way.

        Returns:
            x, y [m] and yaw [rad], in the frame in which ways are given.
        """
        state = self._tracker.known_state(self.in_odometry)
        if state is not None:
            self._last_base = planar_pose(state.T_map_base)
        return self._last_base

    @property
    def _tolerance(self) -> float:
        return self._config.joint_tolerance

    def _wait(self, condition: Callable[[], bool], time: float, interrupted: Interrupted) -> bool:
        return self._tracker.wait_until(condition, time, interrupted)

    def _finish(
        self,
        arrived: Callable[[], bool],
        result: Callable[[], MotionResult | None],
        interrupted: Interrupted,
    ) -> str | None:
        """Wait for a motion to end for as long as something moves.

        Args:
            arrived: whether it looks as if it were done, where nobody tells.
            result: what robot_driver tells.
            interrupted: breaks it off.

        Returns:
            Empty where it is done, else what robot_driver says of its failure; None where that
            says nothing, and the robot has to be stopped.
        """
        driven = self._results.are_offered

        def ended() -> bool:
            if driven:
                return result() is not None or not self._results.are_offered
            return arrived()

        while True:
            moved = partial(self._has_left, self._whereabouts())
            goes_on = self._wait(_either(ended, moved), self._config.patience, interrupted)
            arrived()  # notes the way
            told = result()
            if told is not None:
                return "" if told.outcome is Outcome.SUCCEEDED else told.reason
            if ended():
                return "robot_driver has gone" if driven else ""
            if not goes_on:
                return None

    def _has_left(self, place: FloatArray) -> bool:
        return bool(np.abs(self._whereabouts() - place).max() > _STILL)

    def _whereabouts(self) -> FloatArray:
        """Base pose and joint positions, to see whether anything moves [m, rad]."""
        joints = self._tracker.joint_positions()
        return np.array([*self.place(), *(joints[name] for name in sorted(joints))])

    def _on_update(self, message: PointCloud2) -> None:
        stamp, _ = MessageFields(message, POINT_CLOUD).header()
        if stamp != self._newest_update:  # one scan may come in several messages
            self._newest_update = stamp
            self._fused += 1
            self._tracker.notify()

    def _now(self) -> int:
        return int(self._clock.now().nanoseconds)

    def _farthest(self, goal: dict[str, float]) -> tuple[str, float]:
        """The joint that is farthest from its goal, and how far [rad or m]."""
        positions = self._tracker.joint_positions()
        errors = {name: abs(positions.get(name, np.inf) - q) for name, q in goal.items()}
        name = max(errors, key=errors.__getitem__)
        return name, float(errors[name])

    def _hold_arm(self, path: ArmPath) -> None:
        """Have the arm slow down and stay."""
        positions, speeds = self._tracker.joint_positions(), self._tracker.joint_velocities()
        here = np.array([positions[name] for name in path.joint_names])
        velocities = np.array([speeds.get(name, 0.0) for name in path.joint_names])
        stop = stopping_path(path.joint_names, here, velocities)
        self._trajectories.publish(encode_arm_trajectory(self._types, 0, stop))

    def _send_path(self, poses: FloatArray) -> int:
        """Publish a path; returns its stamp [ns]."""
        frame, stamp = (
            self._tracker.odom_frame if self.in_odometry else self._map_frame,
            self._now(),
        )
        self._paths.publish(encode_base_path(self._types, stamp, frame, poses))
        return stamp


def _either(first: Callable[[], bool], second: Callable[[], bool]) -> Callable[[], bool]:
    return lambda: first() or second()


def _away(base: tuple[float, float, float], goal: FloatArray) -> tuple[float, float]:
    """How far a base is from a pose (x, y, yaw) [m, rad]."""
    turn = abs(float(np.angle(np.exp(1j * (goal[2] - base[2])))))
    return float(np.hypot(goal[0] - base[0], goal[1] - base[1])), turn


def _broken_off(interrupted: Interrupted, otherwise: str) -> str:
    return "broken off" if interrupted() else otherwise


def _thinned(places: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Leave out places less than 2 cm from the one before."""
    kept = places[:1]
    for place in places[1:]:
        if np.hypot(place[0] - kept[-1][0], place[1] - kept[-1][1]) > 0.02:
            kept.append(place)
    return kept
