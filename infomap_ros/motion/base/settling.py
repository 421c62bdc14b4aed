"""Wheels let down on a terrain, by least squares: compiled kernels."""

from __future__ import annotations

import math
from typing import Any

from infomap_ros.geometry.kernel import kernel

_SETTLING_STEPS = 3  # the last with all points of the treads, those before with the lowest


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
