"""How a wheeled body stands on a terrain: compiled kernels. The public form is `Vehicle.stance`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray

_SETTLING_STEPS = 3  # the last with all points of the treads, those before with the lowest

STANDS, OUTSIDE, UNKNOWN_WHEEL, UNKNOWN_BODY, OFF_GROUND, STEEP = 0, 1, 2, 3, 4, 5
STEPPED, ROUGH, TIPS, TOUCHES_GROUND, TOUCHES_OBSTACLE, UNSEEN = 6, 7, 8, 9, 10, 11
"""Outcomes of a stance; STANDS is the only good one."""

SLOPE, STEP, ROUGHNESS, MISFIT, TIP, CLEARANCE, CULPRIT = 0, 1, 2, 3, 4, 5, 6
MEASURES = 7
"""Columns of the measures of a stance: slope [rad], step [m], roughness [m], largest distance of
a wheel from the plane of all [m], tip-over margin [rad], clearance above ground [m], and the wheel
or body column that the outcome is about. NaN = not reached before the stance was refused."""


class TerrainArrays(NamedTuple):
    """A `Terrain` as the kernels take it; grids float32, shape (nx, ny) [m, map].

    Besides its own: `bottom`, what the heights are at least, inf where unknown; and `top`, below
    which a column is free for this vehicle.
    """

    heights: NDArray[np.float32]
    roughness: NDArray[np.float32]
    step: NDArray[np.float32]
    floor: NDArray[np.float32]
    overhead: NDArray[np.float32]
    seen: NDArray[np.float32]
    bottom: NDArray[np.float32]
    top: NDArray[np.float32]
    x: float
    y: float
    resolution: float


class VehicleArrays(NamedTuple):
    """A `Vehicle` as the kernels take it, base frame [m].

    Attributes:
        centers: of the W wheels, shape (W, 3).
        contacts: points of each wheel that may touch ground, shape (W, S, 3).
        columns: (x, y, lowest z, highest z) of the body's columns, shape (B, 4).
        needs_ground: columns between the wheels, shape (B,).
        support: corners of the support polygon, counter-clockwise from above, shape (E, 3).
        center_of_mass: shape (3,).
        reach: from the base to the farthest point, horizontally, on the steepest slope [m].
        limits: suspension travel [m], slope [rad], step [m], roughness [m], tip margin [rad], and
            whether unseen space is free (0 or 1), shape (6,).
    """

    centers: FloatArray
    contacts: FloatArray
    columns: FloatArray
    needs_ground: NDArray[np.bool_]
    support: FloatArray
    center_of_mass: FloatArray
    reach: float
    limits: FloatArray


@kernel
def interpolate_height(heights: Any, u: float, v: float) -> float:
    """Height between cell middles, u and v in cells from the grid's corner; NaN where unknown."""
    u, v = u - 0.5, v - 0.5
    i, j = math.floor(u), math.floor(v)
    if i < 0 or j < 0 or i + 1 >= heights.shape[0] or j + 1 >= heights.shape[1]:
        return math.nan
    s, t = u - i, v - j
    low = heights[i, j] + s * (heights[i + 1, j] - heights[i, j])
    high = heights[i, j + 1] + s * (heights[i + 1, j + 1] - heights[i, j + 1])
    return float(low + t * (high - low))


@kernel
def tilt_to(pose: Any, yaw: float, slope_x: float, slope_y: float) -> None:
    """Rotation of a pose from its heading and the rise of its plane along x and y of the map."""
    norm = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    zx, zy, zz = -slope_x * norm, -slope_y * norm, norm
    xx, xy = math.cos(yaw), math.sin(yaw)
    xz = slope_x * xx + slope_y * xy
    scale = 1.0 / math.sqrt(1.0 + xz * xz)
    xx, xy, xz = xx * scale, xy * scale, xz * scale
    pose[0, 0], pose[1, 0], pose[2, 0] = xx, xy, xz
    pose[0, 1], pose[1, 1], pose[2, 1] = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
    pose[0, 2], pose[1, 2], pose[2, 2] = zx, zy, zz


@kernel
def settle(terrain: Any, vehicle: Any, yaw: float, pose: Any, gaps: Any) -> int:
    """Let the wheels down on the ground, as equal springs would: by least squares.

    Args:
        terrain: a `TerrainArrays`.
        vehicle: a `VehicleArrays`.
        yaw: heading [rad].
        pose: T_map_base with x and y set, shape (4, 4); receives the rest.
        gaps: receives how far each wheel's ground is above the plane of all wheels [m].

    Returns:
        -1, or the wheel under which the ground is unknown.
    """
    heights, centers, contacts = terrain.heights, vehicle.centers, vehicle.contacts
    inverse, x0, y0 = 1.0 / terrain.resolution, terrain.x, terrain.y
    wheels, samples = contacts.shape[0], contacts.shape[1]
    slope_x, slope_y, pose[2, 3] = 0.0, 0.0, 0.0
    tilt_to(pose, yaw, 0.0, 0.0)
    for step in range(_SETTLING_STEPS):
        r00, r01, r02, x = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
        r10, r11, r12, y = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
        r20, r21, r22, z = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
        for w in range(wheels):
            highest = -math.inf
            for n in range(samples if step == _SETTLING_STEPS - 1 else 1):
                a, b, c = contacts[w, n, 0], contacts[w, n, 1], contacts[w, n, 2]
                u = (x + r00 * a + r01 * b + r02 * c - x0) * inverse
                v = (y + r10 * a + r11 * b + r12 * c - y0) * inverse
                gap = interpolate_height(heights, u, v) - (z + r20 * a + r21 * b + r22 * c)
                if math.isnan(gap):
                    return w
                highest = max(highest, gap)
            gaps[w] = highest
        lift, rise_x, rise_y = _fit_plane((r00, r01, r02), (r10, r11, r12), centers, gaps)
        slope_x, slope_y = slope_x + rise_x, slope_y + rise_y
        tilt_to(pose, yaw, slope_x, slope_y)
        pose[2, 3] += lift
        for w in range(wheels):
            x, y = _across((r00, r01, r02), centers, w), _across((r10, r11, r12), centers, w)
            gaps[w] -= lift + rise_x * x + rise_y * y
    return -1


@kernel
def _across(axis: Any, centers: Any, w: int) -> float:
    """Where the middle of a wheel is along an axis from the base [m]."""
    return float(axis[0] * centers[w, 0] + axis[1] * centers[w, 1] + axis[2] * centers[w, 2])


@kernel
def _fit_plane(along_x: Any, along_y: Any, centers: Any, gaps: Any) -> tuple[float, float, float]:
    """Least-squares plane through the wheels' gaps: value at the origin, slopes."""
    n = len(gaps)
    mx, my, mz = 0.0, 0.0, 0.0
    for w in range(n):
        mx, my = mx + _across(along_x, centers, w), my + _across(along_y, centers, w)
        mz += gaps[w]
    mx, my, mz = mx / n, my / n, mz / n
    xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0
    for w in range(n):
        x = _across(along_x, centers, w) - mx
        y, z = _across(along_y, centers, w) - my, gaps[w] - mz
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    scale = 1.0 / (xx * yy - xy * xy)
    rise_x, rise_y = (yy * xz - xy * yz) * scale, (xx * yz - xy * xz) * scale
    return mz - rise_x * mx - rise_y * my, rise_x, rise_y


@kernel
def tip_margin(pose: Any, support: Any, center_of_mass: Any) -> float:
    """Smallest angle by which the body must turn about an edge of its support to fall over [rad].

    The static case of the force-angle measure of Papadopoulos and Rey 1996,
    https://doi.org/10.1109/ROBOT.1996.509185; negative when it falls already.
    """
    dx, dy, dz = -pose[2, 0], -pose[2, 1], -pose[2, 2]
    smallest = math.inf
    for n in range(len(support)):
        m = n + 1 if n + 1 < len(support) else 0
        ax, ay, az = (
            support[m, 0] - support[n, 0],
            support[m, 1] - support[n, 1],
            support[m, 2] - support[n, 2],
        )
        norm = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
        ax, ay, az = ax * norm, ay * norm, az * norm
        lx, ly, lz = (
            support[m, 0] - center_of_mass[0],
            support[m, 1] - center_of_mass[1],
            support[m, 2] - center_of_mass[2],
        )
        along_l, along_d = ax * lx + ay * ly + az * lz, ax * dx + ay * dy + az * dz
        lx, ly, lz = lx - along_l * ax, ly - along_l * ay, lz - along_l * az
        fx, fy, fz = dx - along_d * ax, dy - along_d * ay, dz - along_d * az
        sine = ax * (ly * fz - lz * fy) + ay * (lz * fx - lx * fz) + az * (lx * fy - ly * fx)
        smallest = min(smallest, math.atan2(sine, lx * fx + ly * fy + lz * fz))
    return smallest


@kernel
def is_within(terrain: Any, x: float, y: float, reach: float) -> bool:
    """Whether all within a distance of a place lies on the grid."""
    nx, ny = terrain.heights.shape
    u, v, cells = x - terrain.x, y - terrain.y, terrain.resolution
    return reach <= u < nx * cells - reach and reach <= v < ny * cells - reach


@kernel
def _under_wheels(terrain: Any, vehicle: Any, pose: Any, measures: Any) -> None:
    """Largest step and roughness under the wheels."""
    inverse = 1.0 / terrain.resolution
    step, roughness = 0.0, 0.0
    contacts, steps, rough = vehicle.contacts, terrain.step, terrain.roughness
    for w in range(contacts.shape[0]):
        for n in range(contacts.shape[1]):
            a, b, c = contacts[w, n, 0], contacts[w, n, 1], contacts[w, n, 2]
            x = pose[0, 3] + pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c
            y = pose[1, 3] + pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c
            i, j = int((x - terrain.x) * inverse), int((y - terrain.y) * inverse)
            if steps[i, j] > step:
                step = steps[i, j]
            if rough[i, j] > roughness:
                roughness = rough[i, j]
    measures[STEP], measures[ROUGHNESS] = step, roughness


@kernel
def _body_clear(terrain: Any, vehicle: Any, pose: Any, measures: Any) -> int:
    """Compare the body's columns with the ground below and with what is above."""
    bottom, top, columns = terrain.bottom, terrain.top, vehicle.columns
    inverse = 1.0 / terrain.resolution
    r00, r01, r02 = pose[0, 0] * inverse, pose[0, 1] * inverse, pose[0, 2] * inverse
    r10, r11, r12 = pose[1, 0] * inverse, pose[1, 1] * inverse, pose[1, 2] * inverse
    r20, r21, r22, z = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    x, y = (pose[0, 3] - terrain.x) * inverse, (pose[1, 3] - terrain.y) * inverse
    clearance = math.inf
    for n in range(len(columns)):
        a, b, low, high = columns[n, 0], columns[n, 1], columns[n, 2], columns[n, 3]
        u, v, level = x + r00 * a + r01 * b, y + r10 * a + r11 * b, z + r20 * a + r21 * b
        i, j = int(u + r02 * low), int(v + r12 * low)
        k, m = int(u + r02 * high), int(v + r12 * high)
        above = level + r22 * low - bottom[i, j]
        below = top[k, m] - (level + r22 * high)
        if above <= 0.0 or below < 0.0:
            measures[CULPRIT], measures[CLEARANCE] = n, above
            outcome = _column_outcome(terrain, vehicle, n, i, j, k, m, level, r22)
            if outcome != STANDS:
                return outcome
        elif above < clearance:
            clearance = above
    measures[CLEARANCE] = clearance
    return STANDS


@kernel
def _column_outcome(
    terrain: Any, vehicle: Any, n: int, i: int, j: int, k: int, m: int, level: float, r22: float
) -> int:
    """Outcome of one column of the body with its lower end over cell i, j, its upper over k, m."""
    unseen_is_free = vehicle.limits[5] > 0.0
    low, high = level + r22 * vehicle.columns[n, 2], level + r22 * vehicle.columns[n, 3]
    ground = terrain.heights[i, j]
    if math.isnan(ground):
        ground = terrain.floor[i, j]
        if ground == math.inf and terrain.overhead[i, j] < math.inf:
            return TOUCHES_OBSTACLE
        if vehicle.needs_ground[n]:
            return UNKNOWN_BODY
        if low <= ground and not unseen_is_free:
            return UNSEEN
    elif low <= ground:
        return TOUCHES_GROUND
    if high > terrain.overhead[k, m]:
        return TOUCHES_OBSTACLE
    return UNSEEN if high > terrain.seen[k, m] and not unseen_is_free else STANDS


@kernel
def stand(
    terrain: Any, vehicle: Any, x: float, y: float, yaw: float, pose: Any, gaps: Any, measures: Any
) -> int:
    """Outcome of one stance.

    Args:
        terrain: a `TerrainArrays`.
        vehicle: a `VehicleArrays`.
        x: of the base's origin [m, map].
        y: of the base's origin [m, map].
        yaw: heading of the base's x axis [rad].
        pose: T_map_base, shape (4, 4), its last row set; receives the rest.
        gaps: scratch, one per wheel.
        measures: receives the measures, shape (MEASURES,).
    """
    measures[:] = math.nan
    pose[0, 3], pose[1, 3] = x, y
    if not is_within(terrain, x, y, vehicle.reach):
        return OUTSIDE
    wheel = settle(terrain, vehicle, yaw, pose, gaps)
    if wheel >= 0:
        measures[CULPRIT] = wheel
        return UNKNOWN_WHEEL
    return judge(terrain, vehicle, pose, gaps, measures)


@kernel
def judge(terrain: Any, vehicle: Any, pose: Any, gaps: Any, measures: Any) -> int:
    """Outcome of a stance that is settled and lies within the grid; see `stand`."""
    limits = vehicle.limits
    worst = 0
    for w in range(len(gaps)):
        if abs(gaps[w]) > abs(gaps[worst]):
            worst = w
    measures[MISFIT], measures[CULPRIT] = abs(gaps[worst]), worst
    measures[SLOPE] = math.acos(min(max(pose[2, 2], -1.0), 1.0))
    if measures[SLOPE] > limits[1]:
        return STEEP
    _under_wheels(terrain, vehicle, pose, measures)
    measures[TIP] = tip_margin(pose, vehicle.support, vehicle.center_of_mass)
    if measures[STEP] > limits[2]:
        return STEPPED
    if measures[MISFIT] > limits[0]:
        return OFF_GROUND
    if measures[ROUGHNESS] > limits[3]:
        return ROUGH
    if measures[TIP] < limits[4]:
        return TIPS
    return _body_clear(terrain, vehicle, pose, measures)


class Ground(NamedTuple):
    """All that `is_good` needs besides a place.

    Attributes:
        terrain: the ground.
        vehicle: the robot.
        scratch: pose, gaps and measures, as `stand` takes them: working memory of one thread.
    """

    terrain: TerrainArrays
    vehicle: VehicleArrays
    scratch: tuple[FloatArray, FloatArray, FloatArray]

    @classmethod
    def of(cls, terrain: TerrainArrays, vehicle: VehicleArrays) -> Ground:
        """A terrain for a vehicle."""
        scratch = np.eye(4), np.empty(len(vehicle.centers)), np.empty(MEASURES)
        return cls(terrain, vehicle, scratch)


@kernel
def is_good(ground: Any, x: float, y: float, yaw: float) -> bool:
    """Whether the robot may stand at x, y [m, map], heading yaw [rad]; `ground` is a `Ground`."""
    pose, gaps, measures = ground.scratch
    return stand(ground.terrain, ground.vehicle, x, y, yaw, pose, gaps, measures) == STANDS


@njit(cache=True, nogil=True)
def stand_all(
    terrain: Any, vehicle: Any, places: Any, poses: Any, outcomes: Any, measures: Any
) -> None:
    """Outcomes of many stances (x, y, yaw), shape (N, 3); see `stand`."""
    gaps = np.empty(len(vehicle.centers))
    for n in range(len(places)):
        outcomes[n] = stand(
            terrain, vehicle, places[n, 0], places[n, 1], places[n, 2], poses[n], gaps, measures[n]
        )
