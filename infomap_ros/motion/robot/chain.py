"""The joints between a robot's base and its camera, as plain arrays.

Every joint moves about or along the z axis of its own frame, so that a turn mixes two columns and
the axis is the third: half the work of a general axis. In kernels poses are the upper three rows
of a transform, shape (3, 4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray


class ChainArrays(NamedTuple):
    """A chain as plain arrays, in the order from the base to the camera.

    Joint k moves by ``scales[k] * q[columns[k]] + offsets[k]``, so that joints which mimic another
    and joints that are passed from their far end need nothing more.

    Attributes:
        columns: index into the positions q, shape (S,).
        scales: shape (S,).
        offsets: [rad or m], shape (S,).
        prismatic: slides instead of turning, shape (S,).
        placements: of the joint's frame at zero in the frame before it, shape (S, 3, 4).
        tail: camera in the frame of the last joint, shape (3, 4).
    """

    columns: NDArray[np.int64]
    scales: NDArray[np.float64]
    offsets: NDArray[np.float64]
    prismatic: NDArray[np.bool_]
    placements: NDArray[np.float64]
    tail: NDArray[np.float64]


@njit(cache=True, nogil=True)
def compose(first: Any, second: Any, out: Any) -> None:
    """Write the pose ``first @ second``, shapes (3, 4), into `out`, which is neither of them."""
    for i in range(3):
        a, b, c = first[i, 0], first[i, 1], first[i, 2]
        for j in range(4):
            out[i, j] = a * second[0, j] + b * second[1, j] + c * second[2, j]
        out[i, 3] += first[i, 3]


@njit(cache=True, nogil=True)
def move(place: Any, slides: bool, by: float) -> None:
    """Turn a pose about its own z axis, or slide it along, in place."""
    if slides:
        for i in range(3):
            place[i, 3] += by * place[i, 2]
        return
    cosine, sine = math.cos(by), math.sin(by)
    for i in range(3):
        x, y = place[i, 0], place[i, 1]
        place[i, 0] = cosine * x + sine * y
        place[i, 1] = cosine * y - sine * x


@njit(cache=True, nogil=True)
def place_chain(chain: Any, q: Any, places: Any) -> None:
    """Place all frames of a chain in the base frame.

    Args:
        chain: a `ChainArrays`.
        q: positions [rad or m], shape (n,).
        places: written: the joints' frames, then the camera's, shape (S + 1, 3, 4).
    """
    columns, scales, offsets, prismatic, placements, tail = chain
    steps = columns.shape[0]
    if steps == 0:
        places[0] = tail
        return
    places[0] = placements[0]
    for k in range(steps):
        if k > 0:
            compose(places[k - 1], placements[k], places[k])
        move(places[k], prismatic[k], scales[k] * q[columns[k]] + offsets[k])
    compose(places[steps - 1], tail, places[steps])


@njit(cache=True, nogil=True)
def fill_jacobian(chain: Any, places: Any, jacobian: Any) -> None:
    """Jacobian of the camera's position and rotation, both in the base frame.

    Args:
        chain: a `ChainArrays`.
        places: of `place_chain`.
        jacobian: written, shape (6, n): velocity [m/s] above angular velocity [rad/s].
    """
    columns, scales, prismatic = chain.columns, chain.scales, chain.prismatic
    steps = columns.shape[0]
    jacobian[:] = 0.0
    camera = places[steps]
    for k in range(steps):
        place, column, scale = places[k], columns[k], scales[k]
        x, y, z = scale * place[0, 2], scale * place[1, 2], scale * place[2, 2]
        if prismatic[k]:
            jacobian[0, column] += x
            jacobian[1, column] += y
            jacobian[2, column] += z
            continue
        dx, dy, dz = (
            camera[0, 3] - place[0, 3],
            camera[1, 3] - place[1, 3],
            camera[2, 3] - place[2, 3],
        )
        jacobian[0, column] += y * dz - z * dy
        jacobian[1, column] += z * dx - x * dz
        jacobian[2, column] += x * dy - y * dx
        jacobian[3, column] += x
        jacobian[4, column] += y
        jacobian[5, column] += z


@njit(cache=True, nogil=True)
def camera_poses(chain: Any, qs: Any, poses: Any) -> None:
    """Camera poses ``T_base_camera`` for many positions.

    Args:
        chain: a `ChainArrays`.
        qs: shape (N, n) [rad or m].
        poses: written, shape (N, 4, 4).
    """
    places = np.empty((chain.columns.shape[0] + 1, 3, 4))
    for i in range(qs.shape[0]):
        place_chain(chain, qs[i], places)
        poses[i, :3] = places[-1]
        poses[i, 3, :3] = 0.0
        poses[i, 3, 3] = 1.0


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
