"""Compiled forward kinematics of a chain of joints; the public form is `chain.KinematicChain`.

Every joint moves about or along the z axis of its own frame, so that a turn mixes two columns and
the axis is the third: half the work of a general axis. Poses are the upper three rows of a
transform, shape (3, 4).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


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
def place_chain(
    columns: Any,
    scales: Any,
    offsets: Any,
    prismatic: Any,
    placements: Any,
    tail: Any,
    q: Any,
    places: Any,
) -> None:
    """Place all frames of a chain (the first six arguments, see `ChainArrays`) in the base frame.

    Args:
        columns: of `ChainArrays`.
        scales: of `ChainArrays`.
        offsets: of `ChainArrays`.
        prismatic: of `ChainArrays`.
        placements: of `ChainArrays`.
        tail: of `ChainArrays`.
        q: positions [rad or m], shape (n,).
        places: written: the joints' frames, then the camera's, shape (S + 1, 3, 4).
    """
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
def fill_jacobian(columns: Any, scales: Any, prismatic: Any, places: Any, jacobian: Any) -> None:
    """Jacobian of the camera's position and rotation, both in the base frame.

    Args:
        columns: of `ChainArrays`.
        scales: of `ChainArrays`.
        prismatic: of `ChainArrays`.
        places: of `place_chain`.
        jacobian: written, shape (6, n): velocity [m/s] above angular velocity [rad/s].
    """
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
    columns, scales, offsets, prismatic, placements, tail = chain
    places = np.empty((columns.shape[0] + 1, 3, 4))
    for i in range(qs.shape[0]):
        place_chain(columns, scales, offsets, prismatic, placements, tail, qs[i], places)
        poses[i, :3] = places[-1]
        poses[i, 3, :3] = 0.0
        poses[i, 3, 3] = 1.0
