"""A motion of the arm, and which teammates it would come too near to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.robot import Interrupted, Motion, Robot
from infomap_ros.exploration.team.awareness import NEARER, Awareness, who_and_how_near
from infomap_ros.geometry import PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.solid_extent import quick_extent
from infomap_ros.motion.route import ArmPath
from infomap_ros.team.agents import Agent

_MOST_POSTURES = 40  # of a path that are looked at
_MOVES = 1e-3  # [m]; solids that move by less stay where they are
_STARTING = 1.0  # [s] in which an arm that was stopped comes to the speed of its path


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

    def in_the_way(self, distance: float) -> list[str]:
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
