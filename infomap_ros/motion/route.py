"""What a plan of motion consists of: path of the arm, path of the base, path of the arm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class ArmPath:
    """A path of the arm through joint space, with times.

    Attributes:
        joint_names: names of the n joints, the columns of `positions`.
        positions: knots, shape (K, n) [rad or m]; straight lines between them. Empty where no path
            was found.
        times: of the knots since the start of the motion, increasing from 0, shape (K,) [s].
        converged: whether the path leads from start to goal.
        reason: why not, in words; empty where it does.
    """

    joint_names: tuple[str, ...]
    positions: FloatArray
    times: FloatArray
    converged: bool = True
    reason: str = ""

    @classmethod
    def failed(cls, joint_names: tuple[str, ...], reason: str) -> ArmPath:
        """No path, and why."""
        return cls(joint_names, np.zeros((0, len(joint_names))), np.zeros(0), False, reason)

    @classmethod
    def staying(cls, joint_names: tuple[str, ...], q: FloatArray) -> ArmPath:
        """The arm stays at `q`, shape (n,): one knot at time 0."""
        return cls(joint_names, np.array(q, dtype=np.float64)[None], np.zeros(1))

    @property
    def moves(self) -> bool:
        """Whether the arm moves at all."""
        return len(self.positions) > 1

    @property
    def duration(self) -> float:
        """Time from start to end [s]; 0 without knots."""
        return float(self.times[-1]) if len(self.times) else 0.0

    @property
    def joint_travel(self) -> float:
        """Travel of the joint that moves most, there and back counted [rad or m]."""
        if len(self.positions) < 2:
            return 0.0
        return float(np.abs(np.diff(self.positions, axis=0)).sum(axis=0).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Route:
    """How a view is reached: the arm to its driving posture, the base, the arm to the view.

    Attributes:
        arm_before: to the driving posture; a single knot where the arm need not move first.
        base_path: x, y [m] and yaw [rad] in the map, shape (K, 3); (0, 3) where the base stays.
        base_poses: ``T_map_base`` of each, shape (K, 4, 4).
        arm_after: from the driving posture to the view.
        T_map_camera: camera pose at the end, shape (4, 4).
        partial: it ends at the farthest safe approach, not at the view.
    """

    arm_before: ArmPath
    base_path: FloatArray
    base_poses: FloatArray
    arm_after: ArmPath
    T_map_camera: FloatArray
    partial: bool = False

    @property
    def moves_base(self) -> bool:
        """Whether the base drives at all."""
        return len(self.base_path) > 1


@dataclass(frozen=True, eq=False)
class ReachResult:
    """Answer to "can the camera get there?"; the fields that choosing a view asks for.

    Attributes:
        reason: empty where it can, else a short sentence that says why not.
        travel: length of the base's path [m].
        joint_travel: travel of the arm's joint that moves most, over the whole route [rad or m].
        route: how; None where there is none.
        partial: the route ends at the farthest safe approach, not at the view itself.
        T_map_camera: camera pose in which the route ends, shape (4, 4); NaN without a route.
        seconds: time that the route takes, the arm before and after included [s].
    """

    reason: str
    travel: float = 0.0
    joint_travel: float = 0.0
    route: Route | None = None
    partial: bool = False
    T_map_camera: FloatArray = field(default_factory=lambda: np.full((4, 4), np.nan))
    seconds: float = 0.0
