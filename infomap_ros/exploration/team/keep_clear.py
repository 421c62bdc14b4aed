"""A robot that stops for teammates while it drives.

A way is planned around where the teammates are and where they said they go. Here the robot looks at
them while it drives: where one has come nearer to the way ahead than it was when the way began, and
nearer than a distance, the robot stops, waits until it has gone, and drives on; after some time it
gives the way up, so that another one is planned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.exploration.robot import Interrupted, Motion, Robot, RobotState
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath
from infomap_ros.team.agents import Agent

PAUSE = 0.2
"""Time between two looks whether the way is clear again [s]."""

_SPACING = 0.05  # of the places of the way that are looked at [m]
_NEARER = 0.05  # [m]; poses are noisy
_MORE = 0.1  # [m] by which a teammate must be farther away for the robot to drive on


@dataclass(frozen=True)
class KeepClearConfig:
    """When a robot stops for a teammate.

    Raises:
        ConfigError: a value is out of its range.
    """

    distance: float = parameter(
        0.2,
        "The robot stops where a teammate's body comes nearer than this to its own along the way "
        "ahead, both taken for upright cylinders; below agents.clearance of next_best_view.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    ahead: float = parameter(
        1.0, "Length of the way ahead that must be clear.", unit="m", low=0.0, high=100.0
    )
    patience: float = parameter(
        15.0,
        "After so long a wait the way is given up, and another one planned.",
        unit="s",
        low=0.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What the robot knows while it drives.

    Attributes:
        place: tells where its base is: x, y [m, map] and yaw [rad].
        radius: tells how far its body reaches from the axis of its base [m].
        teammates: tells who was heard lately, and where.
        pause: waits for `PAUSE`.
        say: is told what the robot does, and why.
    """

    place: Callable[[], tuple[float, float, float]]
    radius: Callable[[], float]
    teammates: Callable[[], Sequence[Agent]]
    pause: Callable[[], object]
    say: Callable[[str, str], object]


class KeepsClear:
    """A robot that gives way; implements `infomap_ros.exploration.robot.Robot`.

    Args:
        robot: that moves.
        around: what it knows while it drives.
        config: when it stops.
    """

    def __init__(
        self, robot: Robot, around: Surroundings, config: KeepClearConfig | None = None
    ) -> None:
        self._robot, self._around = robot, around
        self._config = config or KeepClearConfig()

    def state(self) -> RobotState:
        """Where it is now."""
        return self._robot.state()

    def look(self, interrupted: Interrupted) -> str:
        """Take a view from where it is."""
        return self._robot.look(interrupted)

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """Move the arm."""
        return self._robot.move_arm(path, interrupted)

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Drive through base poses (x, y, yaw), shape (K, 3), and stop for teammates."""
        left, path, planned = poses, list[Sequence[float]](), self._distances(poses)
        while True:
            stopped_for: list[str] = []

            def stop(left: FloatArray = left, found: list[str] = stopped_for) -> bool:
                found += self._in_the_way(left, planned, self._config.distance)
                return bool(found) or interrupted()

            motion = self._robot.drive(left, stop)
            path += motion.path
            if not motion.outcome or not stopped_for or interrupted():
                return Motion(motion.outcome, path)
            problem = self._wait(left, planned, stopped_for[0], interrupted)
            if problem:
                return Motion(problem, path)
            left = self._rest(left)

    def _wait(
        self, way: FloatArray, planned: Mapping[int, float], why: str, interrupted: Interrupted
    ) -> str:
        """Wait until the way is clear; returns empty, or why it did not become so."""
        self._around.say("waiting for teammates", why)
        for _ in range(math.ceil(self._config.patience / PAUSE)):
            if interrupted():
                return "broken off"
            if not self._in_the_way(way, planned, self._config.distance + _MORE):
                self._around.say("driving on", "the way is clear again")
                return ""
            self._around.pause()
        return why

    def _in_the_way(
        self, way: FloatArray, planned: Mapping[int, float], distance: float
    ) -> list[str]:
        """Who is, in words."""
        mates = self._around.teammates()
        if not mates:
            return []
        here = np.array(self._around.place()[:2])
        ahead, own = self._ahead(way, here), self._around.radius()
        found = []
        for mate in mates:
            there = mate.T_map_base[:2, 3]
            nearest = float(np.linalg.norm(ahead - there, axis=1).min())
            now = float(np.linalg.norm(here - there))
            came = nearest < planned.get(mate.robot, np.inf) - _NEARER
            gap = nearest - own - mate.radius
            if came and nearest <= now and gap < distance:
                found.append(f"robot {mate.robot} is in the way, {max(gap, 0.0):.2f} m from it")
        return found

    def _distances(self, way: FloatArray) -> dict[int, float]:
        """How far each teammate is from a way now [m]."""
        places = _spaced(way[:, :2], np.inf)
        return {
            mate.robot: float(np.linalg.norm(places - mate.T_map_base[:2, 3], axis=1).min())
            for mate in self._around.teammates()
        }

    def _ahead(self, way: FloatArray, here: FloatArray) -> FloatArray:
        """Places on the next part of a way, the own one first, shape (n, 2) [m]."""
        nearest = int(np.linalg.norm(way[:, :2] - here, axis=1).argmin())
        return _spaced(np.concatenate([here[None], way[nearest + 1 :, :2]]), self._config.ahead)

    def _rest(self, way: FloatArray) -> FloatArray:
        """The way from where the robot is, shape (K, 3)."""
        here = np.array(self._around.place())
        nearest = int(np.linalg.norm(way[:, :2] - here[:2], axis=1).argmin())
        return np.concatenate([here[None], way[min(nearest + 1, len(way) - 1) :]])


def _spaced(places: FloatArray, length: float) -> FloatArray:
    """The first part of a way through places, (K, 2), by points at most `_SPACING` apart."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = min(float(along[-1]), length)
    at = np.linspace(0.0, end, math.ceil(end / _SPACING) + 1)
    return np.column_stack([np.interp(at, along, places[:, axis]) for axis in range(2)])
