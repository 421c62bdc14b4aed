"""What the exploration asks of a robot and of what chooses the views.

Poses and paths of a base, seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath, Route

Interrupted = Callable[[], bool]
"""Whether what is going on is to be broken off."""


@dataclass(frozen=True)
class MapProgress:
    """The state of the map within the region of the task.

    Attributes:
        known_fraction: share of the reachable surface that is known, 0 to 1, as
            `exploration.progress.measure_progress` defines it.
        entropy_bits: what is not known, summed over all voxels of the region [bits].
        mean_sigma: mean standard deviation of the surface along its normal [m]; NaN without one.
        surface_voxels: surface voxels in the region.
        known_voxels: voxels of the whole map that were ever observed.
        precise_fraction: share of the reachable surface that is known precisely enough, 0 to 1.
        interest_fraction: the same of the place of interest where it is least; 1 without one.
    """

    known_fraction: float
    entropy_bits: float
    mean_sigma: float
    surface_voxels: int
    known_voxels: int
    precise_fraction: float
    interest_fraction: float = 1.0

    @property
    def min_fraction(self) -> float:
        """What of the region is known precisely enough, and of each place of interest, 0 to 1."""
        return min(self.precise_fraction, self.interest_fraction)


@dataclass(frozen=True, eq=False)
class RobotState:
    """Where the robot is.

    Attributes:
        T_map_base: pose of its base, shape (4, 4).
        T_map_camera: pose of the left optical frame, shape (4, 4).
        pose_covariance: of the camera's pose, shape (6, 6), convention of `geometry.transforms`.
        joints: positions by name [rad or m].
    """

    T_map_base: FloatArray
    T_map_camera: FloatArray
    pose_covariance: FloatArray
    joints: Mapping[str, float]


@dataclass(frozen=True)
class KnownPlace:
    """A place where the robot has stood.

    Attributes:
        name: what is remarkable of it.
        base: its pose there (x, y, yaw) [m, rad, map]; empty where it is not known yet.
        joints: positions by name [rad or m].
    """

    name: str
    base: tuple[float, ...] = ()
    joints: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_known(self) -> bool:
        """Whether there is such a place yet."""
        return bool(self.base)


@dataclass(frozen=True, eq=False)
class Motion:
    """What became of a motion.

    Attributes:
        outcome: empty when the goal was reached, else why not.
        path: places that the base (or for the arm, the camera) came by, shape (n, 3) [m, map].
    """

    outcome: str
    path: Sequence[Sequence[float]] = ()


class Robot(Protocol):
    """A robot with an arm, a base and a stereo camera. Every call is bounded in time."""

    def state(self) -> RobotState:
        """Where it is now."""

    def look(self, interrupted: Interrupted) -> str:
        """Take a view from where it is and have it fused; returns empty, or why it failed."""

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """Move the arm."""

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Drive through base poses (x, y, yaw), shape (K, 3), map frame [m, rad]."""


@dataclass(frozen=True, eq=False)
class Choice:
    """What the planner says.

    Attributes:
        progress: state of the map.
        pose: the chosen view, ``T_map_camera``, shape (4, 4); None when there is none.
        route: the way there; None when there is none.
        reason: why this view, or why none.
        explanation: the entry of the run log, see `run_log`.
    """

    progress: MapProgress
    pose: FloatArray | None
    route: Route | None
    reason: str
    explanation: Mapping[str, Any] = field(default_factory=dict)

    @property
    def target(self) -> FloatArray | None:
        """Where the route is to bring the camera: the view, or the end of a partial route."""
        if self.route is not None and self.route.partial:
            return self.route.T_map_camera
        return self.pose


@dataclass(frozen=True, eq=False)
class FailedView:
    """A chosen view that brought nothing.

    Attributes:
        pose: ``T_map_camera`` that was chosen, shape (4, 4).
        reason: why.
        reached: whether the robot looked from there, or from as near as it came.
    """

    pose: FloatArray
    reason: str
    reached: bool = False


class Planner(Protocol):
    """Chooses the next best view and the route there. Every call is bounded in time."""

    def choose(self, state: RobotState) -> Choice:
        """The next best view from `state`."""

    def route_to(self, state: RobotState, place: KnownPlace) -> Choice:
        """The route to where the robot has stood, as it stood there."""

    def plan_arm(self, state: RobotState, T_map_camera: FloatArray) -> Choice:
        """The rest of the route to a view, from where the base has come to stand.

        Args:
            state: where the robot is now.
            T_map_camera: the view that was planned last, shape (4, 4).

        Returns:
            The route, of the arm alone or with a short drive; its reason says why the camera comes
            only near to the view, and is empty where it gets there. No route where the arm cannot
            move at all.
        """

    def route_problem(self, state: RobotState) -> str:
        """Why what is left of the route planned last is blocked; empty where it is still free."""

    def failed(self, view: FailedView) -> None:
        """Tell that a chosen view brought nothing, so that it is not chosen again at once."""


def planar_pose(T_map_base: FloatArray) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of a pose, shape (4, 4)."""
    yaw = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0]))
    return float(T_map_base[0, 3]), float(T_map_base[1, 3]), yaw


def path_length(path: ArrayLike) -> float:
    """Length of a path through points, shape (n, 3) [m]."""
    points = np.asarray(path, dtype=np.float64)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) if len(points) > 1 else 0.0


def spaced(places: FloatArray, spacing: float, length: float = np.inf) -> FloatArray:
    """First part of a path through places, (K, 2) [m], by points at most `spacing` [m] apart."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = min(float(along[-1]), length)
    at = np.linspace(0.0, end, math.ceil(end / spacing) + 1)
    return np.column_stack([np.interp(at, along, places[:, axis]) for axis in range(2)])
