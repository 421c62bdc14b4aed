"""The joints between a robot's base and its camera, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.chain_kernels import ChainArrays, camera_poses


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """A serial chain of joints that moves a camera; immutable.

    Attributes:
        joint_names: of the n joints that move, in the order of the positions q, from the base to
            the camera.
        lower: smallest positions [rad or m], shape (n,); -inf where there is no limit.
        upper: largest positions [rad or m], shape (n,); inf where there is no limit.
        velocity: largest speeds [rad/s or m/s], shape (n,); inf where none is known.
        is_continuous: turns without end, shape (n,).
        is_prismatic: slides, shape (n,).
        arrays: for kernels; one row per joint on the way, mimicking ones included.
    """

    joint_names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    is_continuous: NDArray[np.bool_]
    is_prismatic: NDArray[np.bool_]
    arrays: ChainArrays

    def __len__(self) -> int:
        return len(self.joint_names)

    def camera_pose(self, q: ArrayLike) -> FloatArray:
        """Pose of the camera, ``T_base_camera``.

        Args:
            q: positions [rad or m], shape (n,) or (N, n).

        Returns:
            Shape (4, 4) or (N, 4, 4).

        Raises:
            InvalidInputError: `q` has another shape, or is not finite.
        """
        positions = float_array(q, "q")
        if positions.ndim not in (1, 2) or positions.shape[-1] != len(self):
            raise InvalidInputError(
                "q", f"shape {positions.shape}, expected ({len(self)},) or (N, {len(self)})"
            )
        if not np.isfinite(positions).all():
            raise InvalidInputError("q", "holds NaN or infinity")
        rows = np.atleast_2d(positions)
        poses = np.empty((len(rows), 4, 4))
        camera_poses(self.arrays, rows, poses)
        return poses[0] if positions.ndim == 1 else poses

    def positions(self, joint_positions: Mapping[str, float]) -> FloatArray:
        """The chain's positions q, shape (n,), out of a robot's joint positions [rad or m].

        Raises:
            RobotModelError: a joint of the chain is missing.
        """
        missing = [name for name in self.joint_names if name not in joint_positions]
        if missing:
            raise RobotModelError(f"no position of joint {', '.join(map(repr, missing))}")
        return np.array([float(joint_positions[name]) for name in self.joint_names])

    def by_name(self, q: ArrayLike) -> dict[str, float]:
        """Positions by joint name [rad or m], the inverse of `positions`."""
        return {
            name: float(position)
            for name, position in zip(self.joint_names, self.check(q), strict=True)
        }

    def check(self, q: ArrayLike, name: str = "q") -> FloatArray:
        """Return positions of one configuration, shape (n,), as an array.

        Raises:
            InvalidInputError: another shape, or not finite.
        """
        positions = float_array(q, name)
        if positions.shape != (len(self),):
            raise InvalidInputError(
                name, f"shape {positions.shape}, expected ({len(self)},): {self.joint_names}"
            )
        if not np.isfinite(positions).all():
            raise InvalidInputError(name, f"is not finite: {positions.tolist()}")
        return positions
