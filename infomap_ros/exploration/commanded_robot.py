"""A robot that is sent paths and trajectories, and is watched until it has carried them out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.robot import Interrupted, Motion, RobotState, planar_pose
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.controller_trajectories import stopping_path
from infomap_ros.motion.route import ArmPath


@dataclass(frozen=True)
class CommandedRobotConfig:
    """When a motion of the robot counts as done, and when as failed.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = parameter(
        0.12, "The base has arrived when it rests so near the end of its path.", unit="m", low=0.001
    )
    progress_timeout: float = parameter(
        15.0,
        "A motion has failed when nothing has moved for so long, and a look when no scan has been "
        "fused for so long, by the robot's time where a simulator is slow. A motion may take as "
        "long as it likes while it goes on.",
        unit="s",
        low=0.5,
        high=600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


_HEADING_TOLERANCE = 0.2  # the base has arrived when its heading is so near the wanted one [rad]
_JOINT_TOLERANCE = 0.03  # the arm has arrived when every joint is so near its goal [rad or m]
_SCANS_PER_VIEW = 2  # pairs fused at each view: one look rarely makes a voxel free
_STILL = 0.02  # [m or rad, or each in a second]; what moves less stands: poses are noisy


class RobotLink(Protocol):
    """What there is between the exploration and a robot: topics, or a simulator's own objects."""

    def known_state(self, in_odometry: bool = False) -> RobotState | None:
        """Where it is now, in the map or in the frame of odometry; None where that is unknown."""

    def joint_positions(self) -> Mapping[str, float]:
        """Newest position of each joint, by name [rad or m]."""

    def joint_velocities(self) -> Mapping[str, float]:
        """Velocity of each joint, by name [rad/s or m/s]."""

    def base_speed(self) -> float:
        """How fast odometry has the base move, the larger of [m/s] and [rad/s]; 0 if unknown."""

    @property
    def fused_scans(self) -> int:
        """Scans of this robot that have been fused so far."""

    def send_base_path(self, poses: FloatArray, in_odometry: bool) -> str:
        """Have the base drive through poses (x, y, yaw), shape (K, 3), of map or odometry.

        Returns:
            Name of the motion, for `result`.
        """

    def send_arm_path(self, path: ArmPath) -> str:
        """Have the arm move, beginning now; returns the name of the motion."""

    @property
    def reports_results(self) -> bool:
        """Whether what moves the robot reports results of motions."""

    def result(self, motion: str) -> str | None:
        """What became of a motion: empty where it succeeded, else why not; None as yet."""

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Interrupted
    ) -> bool:
        """Let time pass until a condition holds, at most `timeout` [s]; whether it holds."""


class CommandedRobot:
    """Implements `infomap_ros.exploration.robot.Robot`; called by one thread that may block.

    Args:
        link: to the robot.
        config: when its motions are done.

    Attributes:
        in_odometry: paths of the base are given in the frame of odometry, not in the map.
    """

    in_odometry = False

    def __init__(self, link: RobotLink, config: CommandedRobotConfig | None = None) -> None:
        self._link, self._config = link, config or CommandedRobotConfig()
        self._last_base = (0.0, 0.0, 0.0)

    def state(self) -> RobotState:
        """Where it is now. Waits where messages were lost.

        Raises:
            PoseUnavailableError: pose, joints or description do not arrive.
        """
        link = self._link
        self._wait(lambda: link.known_state() is not None, lambda: False)
        if (state := link.known_state()) is None:
            raise PoseUnavailableError("the robot's pose, joints or description are not known")
        return state

    @property
    def sees(self) -> bool:
        """Whether a scan of it has been fused."""
        return self._link.fused_scans > 0

    def look(self, interrupted: Interrupted) -> str:
        """Wait until scans taken from here have been fused, for as long as one after one is."""
        fused = self._link.fused_scans
        wanted = fused + _SCANS_PER_VIEW + 1  # one may be from before

        def more() -> bool:
            return self._link.fused_scans > fused

        while fused < wanted:
            if not self._wait(more, interrupted):
                return f"no new scan was fused within {self._config.progress_timeout:g} s"
            fused = self._link.fused_scans
        return ""

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """Send the path and wait for its result, or until the joints are where it ends."""
        goal = dict(zip(path.joint_names, path.positions[-1], strict=True))
        motion, tolerance = self._link.send_arm_path(path), _JOINT_TOLERANCE
        end = self._finish(motion, lambda: self._farthest(goal)[1] <= tolerance, interrupted)
        if end is not None:
            return Motion(end)
        name, error = self._farthest(goal)
        self._hold_arm(path)
        return Motion(_broken_off(interrupted, f"{name} has stopped {error:.3f} off its goal"))

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Send the path and wait for its result, or until the base rests at its end."""
        motion = self._link.send_base_path(poses, self.in_odometry)
        traveled = [self.place()]

        def arrived() -> bool:
            traveled.append(self.place())
            left, turn = _away(traveled[-1], poses[-1])
            near = left <= self._config.position_tolerance
            there = near and turn <= _HEADING_TOLERANCE
            return there and self._link.base_speed() <= _STILL

        end = self._finish(motion, arrived, interrupted)
        path = [(x, y, 0.0) for x, y, _ in _thinned(traveled)]
        if end is not None:
            return Motion(end, path)
        here = self.place()
        self._link.send_base_path(np.array([here]), self.in_odometry)  # stay
        left, turn = _away(here, poses[-1])
        stopped = f"the base has stopped {left:.2f} m and {turn:.2f} rad from its goal"
        return Motion(_broken_off(interrupted, stopped), path)

    def place(self) -> tuple[float, float, float]:
        """Where the base is, or was when that was last known: messages may be lost on the way.

        Returns:
            x, y [m] and yaw [rad], in the frame in which paths are given.
        """
        state = self._link.known_state(self.in_odometry)
        if state is not None:
            self._last_base = planar_pose(state.T_map_base)
        return self._last_base

    def _wait(self, condition: Callable[[], bool], interrupted: Interrupted) -> bool:
        return self._link.wait_until(condition, self._config.progress_timeout, interrupted)

    def _finish(
        self, motion: str, arrived: Callable[[], bool], interrupted: Interrupted
    ) -> str | None:
        """Wait for a motion to end for as long as something moves.

        Args:
            motion: its name.
            arrived: whether it looks as if it were done, where nobody reports.
            interrupted: breaks it off.

        Returns:
            Empty where it is done, else the reported failure; None where nothing is reported,
            and the robot has to be stopped.
        """
        link, is_reported = self._link, self._link.reports_results

        def ended() -> bool:
            if is_reported:
                return link.result(motion) is not None or not link.reports_results
            return arrived()

        while True:
            moved = partial(self._has_left, self._whereabouts())
            goes_on = self._wait(_either(ended, moved), interrupted)
            has_arrived = arrived()  # notes the path, too
            if (failure := link.result(motion)) is not None:
                return failure
            if is_reported and not link.reports_results:
                return "what moves the robot has gone"
            if has_arrived and not is_reported:
                return ""
            if not goes_on:
                return None

    def _has_left(self, place: FloatArray) -> bool:
        return bool(np.abs(self._whereabouts() - place).max() > _STILL)

    def _whereabouts(self) -> FloatArray:
        """Base pose and joint positions, to see whether anything moves [m, rad]."""
        joints = self._link.joint_positions()
        return np.array([*self.place(), *(joints[name] for name in sorted(joints))])

    def _farthest(self, goal: dict[str, float]) -> tuple[str, float]:
        """The joint that is farthest from its goal, and how far [rad or m]."""
        positions = self._link.joint_positions()
        errors = {name: abs(positions.get(name, np.inf) - q) for name, q in goal.items()}
        name = max(errors, key=errors.__getitem__)
        return name, float(errors[name])

    def _hold_arm(self, path: ArmPath) -> None:
        """Have the arm slow down and stay, nowhere that its path does not go."""
        positions, speeds = self._link.joint_positions(), self._link.joint_velocities()
        here = np.array([positions[name] for name in path.joint_names])
        velocities = np.array([speeds.get(name, 0.0) for name in path.joint_names])
        stop = stopping_path(path.joint_names, here, velocities)
        knots = np.clip(stop.positions, path.positions.min(axis=0), path.positions.max(axis=0))
        self._link.send_arm_path(replace(stop, positions=knots))


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
