"""Where an arm has been since its base stands where it stands.

The map may change its mind about space through which the arm has come: a scan adds a speck of
noise, or the base stands a little off from where the way was planned. The way back is open all the
same, as the body itself has just been there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath, Route

_SAME = 0.05  # [rad or m]; by which an arm may be off from its way
_MOVED = 0.1  # [m]; by which a base that stands may seem to move
_TURNED = 0.15  # [rad]
_STRAIGHT = 1e-6  # [rad or m]


@dataclass(frozen=True, eq=False)
class ArmTrail:
    """Configurations that the arm has passed, with straight lines between them.

    Attributes:
        T_map_base: where the base stands, shape (4, 4).
        positions: the oldest first, the present one last, shape (K, n) [rad or m].
    """

    T_map_base: FloatArray
    positions: FloatArray

    @classmethod
    def at(cls, T_map_base: FloatArray, q: FloatArray) -> ArmTrail:
        """Nothing is known but where the robot is."""
        return cls(np.array(T_map_base), np.array(q, dtype=np.float64)[None])

    def after(self, T_map_base: FloatArray, q: FloatArray, route: Route | None) -> ArmTrail:
        """The trail of a robot that was sent along a route, or along none, and is now here.

        A route may have been left at any point; what the arm has done besides it is not known.

        Args:
            T_map_base: where the base is, shape (4, 4).
            q: where the arm is, shape (n,).
            route: that began where this trail ends.
        """
        fresh = ArmTrail.at(T_map_base, q)
        if route is not None and route.moves_base:
            passed = _passed(route.arm_after, q)
            if passed is not None:
                return ArmTrail(fresh.T_map_base, passed)
        if self._stood_elsewhere(T_map_base):
            return fresh
        steps = [] if route is None else [route.arm_before]
        if route is not None and not route.moves_base:
            steps.append(route.arm_after)
        if np.abs(self.positions[-1] - q).max(initial=0.0) <= _SAME and not any(
            step.moves for step in steps
        ):
            return ArmTrail(fresh.T_map_base, np.concatenate([self.positions, fresh.positions]))
        before = self.positions
        for step in steps:
            passed = _passed(step, q)
            if passed is not None:
                return ArmTrail(fresh.T_map_base, np.concatenate([before, passed]))
            before = np.concatenate([before, step.positions])
        return fresh

    def back(self) -> FloatArray:
        """Corners of the way back, the present configuration first, shape (K, n)."""
        return corners_of(self.positions)[::-1]

    def _stood_elsewhere(self, T_map_base: FloatArray) -> bool:
        change = np.linalg.inv(self.T_map_base) @ T_map_base
        turn = math.acos(min(max(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0), 1.0))
        return float(np.linalg.norm(change[:3, 3])) > _MOVED or turn > _TURNED


def corners_of(positions: FloatArray) -> FloatArray:
    """Leave out the configurations, of (K, n), that lie on the line between their neighbors."""
    differs = np.abs(np.diff(positions, axis=0)).max(axis=1, initial=0.0) > _STRAIGHT
    positions = positions[np.append(True, differs)]
    kept = [0]
    for row in range(1, len(positions) - 1):
        first, middle, last = positions[kept[-1]], positions[row], positions[row + 1]
        way = last - first
        length = float(way @ way)
        share = float((middle - first) @ way) / length if length > 0.0 else 2.0
        on_line = 0.0 <= share <= 1.0 and np.abs(first + share * way - middle).max() <= _STRAIGHT
        if not on_line:
            kept.append(row)
    if len(positions) > 1:
        kept.append(len(positions) - 1)
    return positions[kept]


def _passed(path: ArmPath, q: FloatArray) -> FloatArray | None:
    """The part of a way that an arm at `q` has behind it; None if it is not on that way."""
    if not len(path.positions):
        return None
    away = np.abs(path.positions - q).max(axis=1)
    nearest = int(np.argmin(away))
    if away[nearest] > _SAME:
        return None
    return np.concatenate([path.positions[: nearest + 1], q[None]])
