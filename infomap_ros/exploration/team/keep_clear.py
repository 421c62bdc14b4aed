"""A robot that stops for teammates while it moves.

Ways of base and arm are planned around where the teammates are and where they said they go. Here
the robot looks at them while it moves: where one has come too near to the way ahead, the robot
stops, waits until it has gone, and goes on; after some time it gives the motion up, so that another
one is planned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.exploration.robot import Interrupted, Motion, Robot, RobotState
from infomap_ros.exploration.team.watched_motion import Awareness, WatchedDrive, WatchedReach
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath

PAUSE = 0.2
"""Time between two looks whether the way is clear again [s]."""

_MORE = 0.1  # [m] by which a teammate must be farther away for the robot to go on


@dataclass(frozen=True)
class KeepClearConfig:
    """When a robot stops for a teammate.

    Raises:
        ConfigError: a value is out of its range.
    """

    distance: float = parameter(
        0.2,
        "The robot stops where a teammate's body comes nearer than this to its own along the way "
        "ahead of the base, or to the arm in what is left of its motion; teammates are taken for "
        "upright cylinders. Below agents.clearance of next_best_view.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    ahead: ClassVar[float] = 1.0
    """Length of the way of the base ahead that must be clear [m]."""
    wait_timeout: float = setting(
        15.0,
        "After so long a wait the motion is given up, and another one planned.",
        unit="s",
        low=0.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class KeepsClear:
    """A robot that gives way; implements `infomap_ros.exploration.robot.Robot`.

    Args:
        robot: that moves.
        around: what it knows while it moves; its pauses last `PAUSE`.
        config: when it stops.
    """

    def __init__(
        self, robot: Robot, around: Awareness, config: KeepClearConfig | None = None
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
        """Move the arm, and stop it for teammates."""
        return self._follow(WatchedReach(self._robot, self._around, path), interrupted)

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Drive through base poses (x, y, yaw), shape (K, 3), and stop for teammates."""
        way = WatchedDrive(self._robot, self._around, poses, self._config.ahead)
        return self._follow(way, interrupted)

    def _follow(self, way: WatchedDrive | WatchedReach, interrupted: Interrupted) -> Motion:
        """Move, stop, wait and go on, until it is done or given up."""
        stopped_for: list[str] = []

        def stop() -> bool:
            stopped_for[:] = way.in_the_way(self._config.distance)
            return bool(stopped_for) or interrupted()

        places: list[list[float]] = []
        while True:
            stopped_for.clear()
            motion = way.go_on(stop)
            places += [list(place) for place in motion.path]
            if not motion.outcome or not stopped_for or interrupted():
                return Motion(motion.outcome, places)
            problem = self._wait(way, stopped_for[0], interrupted)
            if problem:
                return Motion(problem, places)

    def _wait(self, way: WatchedDrive | WatchedReach, why: str, interrupted: Interrupted) -> str:
        """Wait until the way is clear; returns empty, or why it did not become so."""
        self._around.say("waiting for teammates", why)
        for _ in range(math.ceil(self._config.wait_timeout / PAUSE)):
            if interrupted():
                return "broken off"
            if not way.in_the_way(self._config.distance + _MORE):
                self._around.say("going on", "the way is clear again")
                return ""
            self._around.pause()
        return why
