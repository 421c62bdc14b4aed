"""A stance judged as good without measuring it: the quick way through most of a search.

The body is taken in pieces of 2 x 2 columns and compared with the highest ground and the lowest
obstacle around each. What this accepts is good by `infomap_ros.motion.base.stance` too; what it
does not accept may be.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.settling import settle, tilt_to
from infomap_ros.motion.base.stance import (
    MEASURES,
    STANDS,
    TerrainArrays,
    VehicleArrays,
    is_within,
    judge,
    tip_margin,
)

_STEEPEST = 0.25  # tangent of the steepest slope that is judged quickly
_SPREAD = 0.1  # largest difference of height within a piece [m]
_DIRECTIONS = 64  # in which a slope is tried for balance
_ANGLE_RESERVE = 0.01  # for what lies between these directions [rad]


class QuickArrays(NamedTuple):
    """A terrain and a vehicle as `is_good` takes them, besides their own arrays.

    Attributes:
        bottom: highest ground around a cell, inf where some of it is unknown [m, map].
        top: lowest upper end of free space around a cell [m, map].
        hard: cells near which a step or roughness exceeds the limits.
        pieces: (x, y, lowest z, highest z) of pieces of the body, shape (B, 4) [m].
        half: half the edge of a piece, for columns [m].
        lowest_zz: cosine of the steepest slope that is judged quickly.
    """

    bottom: NDArray[np.float32]
    top: NDArray[np.float32]
    hard: NDArray[np.bool_]
    pieces: FloatArray
    half: float
    lowest_zz: float


class Ground(NamedTuple):
    """All that `is_good` needs besides a place.

    Attributes:
        terrain: the ground.
        vehicle: the robot.
        quick: of both.
        scratch: pose, gaps and measures, as `stand` takes them: working memory of one thread.
    """

    terrain: TerrainArrays
    vehicle: VehicleArrays
    quick: QuickArrays
    scratch: tuple[FloatArray, FloatArray, FloatArray]


def ground_of(terrain: TerrainArrays, vehicle: VehicleArrays, spacing: float) -> Ground:
    """Prepare a terrain for a vehicle whose columns are `spacing` apart [m]."""
    scratch = np.eye(4), np.empty(len(vehicle.centers)), np.empty(MEASURES)
    return Ground(terrain, vehicle, _quick_arrays(terrain, vehicle, spacing), scratch)


def _quick_arrays(terrain: TerrainArrays, vehicle: VehicleArrays, spacing: float) -> QuickArrays:
    cells = math.ceil((spacing / math.sqrt(2.0) + _STEEPEST * _SPREAD) / terrain.resolution + 0.5)
    around = 2 * cells + 1
    treads = np.linalg.norm(vehicle.contacts - vehicle.centers[:, None], axis=2)
    beside = 2 * math.ceil(float(treads.max()) / terrain.resolution + 0.5) + 1
    _, slope, step, roughness, margin, _ = vehicle.limits
    with np.errstate(invalid="ignore"):
        hard = ~((terrain.step <= step) & (terrain.roughness <= roughness))
    steepest = min(float(slope), _steepest_balanced(vehicle, float(margin)), math.atan(_STEEPEST))
    return QuickArrays(
        maximum_filter(terrain.bottom, around, mode="nearest"),
        minimum_filter(terrain.top, around, mode="nearest"),
        maximum_filter(hard, beside, mode="nearest"),
        _pieces(vehicle.columns, spacing),
        0.5 * spacing,
        math.cos(steepest),
    )


def _pieces(columns: FloatArray, spacing: float) -> FloatArray:
    """Columns joined two by two where they are of nearly the same height."""
    squares = np.floor(columns[:, :2] / spacing).astype(np.int64) // 2
    _, groups = np.unique(squares, axis=0, return_inverse=True)
    pieces = []
    for group in range(int(groups.max(initial=-1)) + 1):
        own = columns[groups.ravel() == group]
        if np.ptp(own[:, 2]) > _SPREAD or np.ptp(own[:, 3]) > _SPREAD:
            pieces.append(own)
        else:
            square = squares[np.flatnonzero(groups.ravel() == group)[0]]
            x, y = (2.0 * square + 1.0) * spacing
            pieces.append(np.array([[x, y, own[:, 2].min(), own[:, 3].max()]]))
    return np.concatenate([np.zeros((0, 4)), *pieces])


def _steepest_balanced(vehicle: VehicleArrays, margin: float) -> float:
    """Steepest slope [rad] on which the tip-over margin holds in every direction, by bisection."""
    low, high, pose = 0.0, 1.5, np.eye(4)
    for _ in range(20):
        slope = 0.5 * (low + high)
        smallest = math.inf
        for angle in np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False):
            rise = math.tan(slope)
            tilt_to(pose, 0.0, rise * math.cos(angle), rise * math.sin(angle))
            smallest = min(smallest, tip_margin(pose, vehicle.support, vehicle.center_of_mass))
        low, high = (slope, high) if smallest >= margin + _ANGLE_RESERVE else (low, slope)
    return low


@kernel
def is_good(ground: Any, x: float, y: float, yaw: float) -> bool:
    """Whether the robot may stand at x, y [m, map], heading yaw [rad]; `ground` is a `Ground`."""
    terrain, vehicle, quick = ground.terrain, ground.vehicle, ground.quick
    pose, gaps, measures = ground.scratch
    pose[0, 3], pose[1, 3] = x, y
    if not is_within(terrain, x, y, vehicle.reach):
        return False
    if settle(terrain, vehicle, yaw, pose, gaps) >= 0:
        return False
    for w in range(len(gaps)):
        if abs(gaps[w]) > vehicle.limits[0]:
            return False
    is_flat = pose[2, 2] > quick.lowest_zz
    if (
        is_flat
        and _on_soft_ground(terrain, vehicle, quick, pose)
        and _is_clear(terrain, quick, pose)
    ):
        return True
    return judge(terrain, vehicle, pose, gaps, measures) == STANDS


@kernel
def _on_soft_ground(terrain: Any, vehicle: Any, quick: Any, pose: Any) -> bool:
    """Whether no step or roughness beyond the limits is near a wheel."""
    inverse = 1.0 / terrain.resolution
    for w in range(len(vehicle.centers)):
        a, b, c = vehicle.centers[w, 0], vehicle.centers[w, 1], vehicle.centers[w, 2]
        x = pose[0, 3] + pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c
        y = pose[1, 3] + pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c
        if quick.hard[int((x - terrain.x) * inverse), int((y - terrain.y) * inverse)]:
            return False
    return True


@kernel
def _is_clear(terrain: Any, quick: Any, pose: Any) -> bool:
    """Whether all pieces of the body are above all ground and below all obstacles near them."""
    bottom, top, pieces = quick.bottom, quick.top, quick.pieces
    inverse = 1.0 / terrain.resolution
    r00, r01, r02 = pose[0, 0] * inverse, pose[0, 1] * inverse, pose[0, 2] * inverse
    r10, r11, r12 = pose[1, 0] * inverse, pose[1, 1] * inverse, pose[1, 2] * inverse
    r20, r21, r22, z = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    x, y = (pose[0, 3] - terrain.x) * inverse, (pose[1, 3] - terrain.y) * inverse
    nx, ny = bottom.shape
    bend = (abs(r20) + abs(r21)) * quick.half
    for n in range(len(pieces)):
        a, b, low, high = pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3]
        u, v, level = x + r00 * a + r01 * b, y + r10 * a + r11 * b, z + r20 * a + r21 * b
        i, j = min(int(u + r02 * low), nx - 1), min(int(v + r12 * low), ny - 1)
        k, m = min(int(u + r02 * high), nx - 1), min(int(v + r12 * high), ny - 1)
        if level + r22 * low - bend <= bottom[i, j] or level + r22 * high + bend > top[k, m]:
            return False
    return True
