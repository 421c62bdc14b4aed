"""A robot that stops for teammates while it moves.

Paths of base and arm are planned around where the teammates are and where they said they go. Here
the robot looks at them while it moves: where one has come too near to the path ahead, the robot
stops, waits until it has gone, and goes on; after some time it gives the motion up, so that another
one is planned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.robot import Interrupted, Motion, Robot, RobotState, spaced
from infomap_ros.geometry import PlacedSolid
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.solid_extent import quick_extent, upright_extent
from infomap_ros.motion.route import ArmPath
from infomap_ros.team.agents import Agent

PAUSE = 0.2
"""Time between two looks whether the path is clear again [s]."""

_AHEAD = 1.0  # length of the path of the base ahead that must be clear [m]
_WAIT_TIMEOUT = 15.0  # after which the motion is given up, and another one planned [s]
_MORE = 0.1  # [m] by which a teammate must be farther away for the robot to go on


@dataclass(frozen=True)
class KeepClearConfig:
    """When a robot stops for a teammate.

    Raises:
        ConfigError: a value is out of its range.
    """

    distance: float = parameter(
        0.2,
        "The robot stops where a teammate's body comes nearer than this to its own along the path "
        "ahead of the base, or to the arm in what is left of its motion; teammates are taken for "
        "upright cylinders. Below the 0.3 m that next_best_view keeps.",
        unit="m",
        low=0.0,
        high=10.0,
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
        rest = WatchedDrive(self._robot, self._around, poses, _AHEAD)
        return self._follow(rest, interrupted)

    def _follow(self, rest: WatchedDrive | WatchedReach, interrupted: Interrupted) -> Motion:
        """Move, stop, wait and go on, until it is done or given up."""
        stopped_for: list[str] = []

        def stop() -> bool:
            stopped_for[:] = rest.obstructions(self._config.distance)
            return bool(stopped_for) or interrupted()

        places: list[list[float]] = []
        while True:
            stopped_for.clear()
            motion = rest.go_on(stop)
            places += [list(place) for place in motion.path]
            if not motion.outcome or not stopped_for or interrupted():
                return Motion(motion.outcome, places)
            problem = self._wait(rest, stopped_for[0], interrupted)
            if problem:
                return Motion(problem, places)

    def _wait(self, rest: WatchedDrive | WatchedReach, why: str, interrupted: Interrupted) -> str:
        """Wait until the path is clear; returns empty, or why it did not become so."""
        self._around.say("waiting for teammates", why)
        for _ in range(math.ceil(_WAIT_TIMEOUT / PAUSE)):
            if interrupted():
                return "broken off"
            if not rest.obstructions(self._config.distance + _MORE):
                self._around.say("going on", "the path is clear again")
                return ""
            self._around.pause()
        return why


NEARER = 0.05
"""Poses are noisy: who is nearer by less is where it was [m]."""

_SPACING = 0.05  # of the places of the path that are looked at [m]
_MOST_POSTURES = 40  # of a path that are looked at
_MOVES = 1e-3  # [m]; solids that move by less stay where they are
_STARTING = 1.0  # [s] in which an arm that was stopped comes to the speed of its path


@dataclass(frozen=True, eq=False)
class Awareness:
    """What the robot knows while it moves.

    Attributes:
        place: gives where its base is: x, y [m, map] and yaw [rad].
        joints: gives their positions by name [rad or m].
        body: its solids in a posture, by positions of the joints, placed in its base frame.
        teammates: gives who is present, and where.
        pause: lets a moment pass.
        say: is given what the robot does, and why.
    """

    place: Callable[[], tuple[float, float, float]]
    joints: Callable[[], Mapping[str, float]]
    body: Callable[[Mapping[str, float]], Sequence[PlacedSolid]]
    teammates: Callable[[], Sequence[Agent]]
    pause: Callable[[], object]
    say: Callable[[str, str], object]

    def radius(self) -> float:
        """How far the body reaches from the axis of its base now [m]."""
        return upright_extent(self.body(self.joints()))[0]


def who_and_how_near(mate: Agent, gap: float) -> str:
    """A teammate that is in the way, in words; the gap to it [m]."""
    return f"robot {mate.robot} is in the way, {max(gap, 0.0):.2f} m from it"


class WatchedDrive:
    """The rest of a path of the base. Bodies are taken for upright cylinders.

    Args:
        robot: that drives.
        around: what it knows on the way.
        path: base poses (x, y, yaw), shape (K, 3) [m, rad, map].
        ahead: length of the part ahead that is looked at [m].
    """

    def __init__(self, robot: Robot, around: Awareness, path: FloatArray, ahead: float) -> None:
        self._robot, self._around, self._ahead = robot, around, ahead
        self._path, self._has_begun = path, False
        self._planned = self._distances(path)

    def go_on(self, interrupted: Interrupted) -> Motion:
        """Drive what is left of the path."""
        if self._has_begun:
            self._path = self._rest()
        self._has_begun = True
        return self._robot.drive(self._path, interrupted)

    def obstructions(self, distance: float) -> list[str]:
        """Who is nearer than a distance [m] to the path ahead, and came nearer, in words."""
        mates = self._around.teammates()
        if not mates:
            return []
        here = np.array(self._around.place()[:2])
        ahead, own = self._places_ahead(here), self._around.radius()
        found = []
        for mate in mates:
            there = mate.T_map_base[:2, 3]
            nearest = float(np.linalg.norm(ahead - there, axis=1).min())
            now = float(np.linalg.norm(here - there))
            came = nearest < self._planned.get(mate.robot, np.inf) - NEARER
            gap = nearest - own - mate.reach
            if came and nearest <= now and gap < distance:
                found.append(who_and_how_near(mate, gap))
        return found

    def _distances(self, path: FloatArray) -> dict[int, float]:
        """How far each teammate is from a path now [m]."""
        places = spaced(path[:, :2], _SPACING)
        return {
            mate.robot: float(np.linalg.norm(places - mate.T_map_base[:2, 3], axis=1).min())
            for mate in self._around.teammates()
        }

    def _places_ahead(self, here: FloatArray) -> FloatArray:
        """Places on the next part of the path, the own one first, shape (n, 2) [m]."""
        path = self._path
        nearest = int(np.linalg.norm(path[:, :2] - here, axis=1).argmin())
        rest = np.concatenate([here[None], path[nearest + 1 :, :2]])
        return spaced(rest, _SPACING, self._ahead)

    def _rest(self) -> FloatArray:
        """The path from where the robot is, shape (K, 3)."""
        here, path = np.array(self._around.place()), self._path
        nearest = int(np.linalg.norm(path[:, :2] - here[:2], axis=1).argmin())
        return np.concatenate([here[None], path[min(nearest + 1, len(path) - 1) :]])


class _Sweep(NamedTuple):
    """Postures of a path (P, n), boxes of what it moves (P, M, 2, 3), numbers of these (M,)."""

    positions: FloatArray
    boxes: FloatArray
    moved: NDArray[np.intp]


class WatchedReach:
    """The rest of a motion of the arm.

    The solids that it moves count by the upright boxes that hold them, teammates by their upright
    cylinders. Where the arm is near to one already, it may come away from it.

    Args:
        robot: whose arm moves; its base stands.
        around: what it knows meanwhile.
        path: of the arm.
    """

    def __init__(self, robot: Robot, around: Awareness, path: ArmPath) -> None:
        self._robot, self._around, self._path = robot, around, path
        self._has_begun, self._passed = False, 0

    def go_on(self, interrupted: Interrupted) -> Motion:
        """Do what is left of the motion, unless it must not begin."""
        if interrupted():
            return Motion("broken off")
        if self._has_begun:
            self._path = rest_of(self._path, self._around.joints())
        self._has_begun = True
        return self._robot.move_arm(self._path, interrupted)

    def obstructions(self, distance: float) -> list[str]:
        """To whom the arm would come nearer than a distance [m], and than it is, in words."""
        mates = self._around.teammates()
        if not mates:
            return []
        sweep, joints = self._sweep, self._around.joints()
        here = np.array([joints[name] for name in self._path.joint_names])
        left = np.abs(sweep.positions[self._passed :] - here).max(axis=1)
        self._passed += int(left.argmin())
        now, ahead = self._boxes(joints)[sweep.moved], sweep.boxes[self._passed :]
        found = []
        for mate in mates:
            gap = _gap(ahead, mate)
            if gap < min(distance, _gap(now, mate) - NEARER):
                found.append(who_and_how_near(mate, gap))
        return found

    @cached_property
    def _sweep(self) -> _Sweep:
        path, joints = self._path, self._around.joints()
        count = min(len(path.positions), _MOST_POSTURES)
        chosen = path.positions[np.linspace(0, len(path.positions) - 1, count).round().astype(int)]
        boxes = np.array(
            [self._boxes({**joints, **dict(zip(path.joint_names, q, strict=True))}) for q in chosen]
        )
        moved = np.flatnonzero(np.ptp(boxes, axis=0).max(axis=(1, 2), initial=0.0) > _MOVES)
        return _Sweep(chosen, boxes[:, moved], moved)

    def _boxes(self, joints: Mapping[str, float]) -> FloatArray:
        """Upright boxes in the map that hold the body's solids, lowest and highest, (S, 2, 3)."""
        T, body = self._T_map_base, self._around.body(joints)
        placed = [PlacedSolid(each.solid, T @ each.transform, each.name) for each in body]
        return np.array([quick_extent(each) for each in placed]).reshape(-1, 2, 3)

    @cached_property
    def _T_map_base(self) -> FloatArray:
        return self._robot.state().T_map_base


def rest_of(path: ArmPath, joints: Mapping[str, float]) -> ArmPath:
    """What is left of a path for an arm that was stopped on it.

    Times pass slowly at first, by s = t^2 / (2 T) for the time s on the path until both pass alike,
    so that the arm comes to its speed again within T = 1 s.

    Args:
        path: that was broken off.
        joints: where the joints are, by name [rad or m].
    """
    here = np.array([joints[name] for name in path.joint_names])
    nearest = int(np.abs(path.positions - here).max(axis=1).argmin())
    nearest = min(nearest, len(path.positions) - 2)
    since = path.times[nearest:] - path.times[nearest]
    slow = np.sqrt(2.0 * _STARTING * np.minimum(since, 0.5 * _STARTING))
    times = slow + np.maximum(since - 0.5 * _STARTING, 0.0)
    positions = np.concatenate([here[None], path.positions[nearest + 1 :]])
    return replace(path, positions=positions, times=times)


def _gap(boxes: FloatArray, mate: Agent) -> float:
    """Least distance of boxes, (..., 2, 3), from a teammate's cylinder [m]; negative within it."""
    if not boxes.size:
        return np.inf
    there, low, high = mate.T_map_base[:3, 3], boxes[..., 0, :], boxes[..., 1, :]
    away = np.maximum(np.maximum(low - there, there - high), 0.0)
    beside = np.hypot(away[..., 0], away[..., 1]) - mate.reach
    above = np.maximum(low[..., 2] - there[2] - mate.top, there[2] + mate.bottom - high[..., 2])
    outside = np.hypot(np.maximum(beside, 0.0), np.maximum(above, 0.0))
    return float(np.where(outside > 0.0, outside, np.maximum(beside, above)).min())
