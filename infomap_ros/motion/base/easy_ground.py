"""Cells over which a vehicle can certainly stand in any heading, found without settling it.

Where the ground around a cell is within e of one plane p, every wheel's ground is within e of p.
The plane that fits the wheels by least squares then differs from p by at most ``e sum |c_w|`` at a
point whose value is ``sum c_w d_w`` of the wheels' deviations d_w. So misfit, slope, balance and
clearance are bounded by e and the slope of p, and most ground need not be looked at heading by
heading.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.motion.base.settling import tilt_to
from infomap_ros.motion.base.stance import TerrainArrays, VehicleArrays, tip_margin

_DIRECTIONS = 64  # in which a slope is tried for balance
_ANGLE_RESERVE = 0.01  # for what lies between these directions [rad]


class Allowance(NamedTuple):
    """What a vehicle bears, in any heading.

    Attributes:
        reach: of the body about its base [m].
        amplification: largest deviation of the wheels' plane over the body, per that of ground.
        misfit: largest distance of a wheel from the plane of all, per deviation of ground.
        steepening: largest change of slope, per deviation of ground [1/m].
        travel: of the suspension [m].
        rise: largest tangent of slope.
        step: [m].
        roughness: [m].
        underside: lowest point of the body above the plane of the wheels' lowest points [m].
        height: highest point of the body above that plane [m].
        tread: largest extent of a wheel about its middle [m].
    """

    reach: float
    amplification: float
    misfit: float
    steepening: float
    travel: float
    rise: float
    step: float
    roughness: float
    underside: float
    height: float
    tread: float


def allowance_of(vehicle: VehicleArrays) -> Allowance:
    """What a vehicle bears."""
    travel, slope, step, roughness, margin, _ = vehicle.limits
    design = np.column_stack([np.ones(len(vehicle.centers)), vehicle.centers[:, :2]])
    fit = np.linalg.pinv(design)
    lowest = vehicle.contacts[:, :, 2].min(axis=1)
    plane = fit @ lowest
    places = np.column_stack([np.ones(len(vehicle.columns)), vehicle.columns[:, :2]])
    ground = places @ plane
    offsets = vehicle.contacts - vehicle.centers[:, None]
    return Allowance(
        reach=vehicle.reach,
        amplification=float(np.abs(places @ fit).sum(axis=1).max(initial=0.0)),
        misfit=1.0 + float(np.abs(design @ fit).sum(axis=1).max()),
        steepening=float(np.hypot(*np.abs(fit[1:]).sum(axis=1))),
        travel=travel - float(np.abs(lowest - design @ plane).max()),
        rise=math.tan(min(slope, steepest_balanced(vehicle, margin))),
        step=step,
        roughness=roughness,
        underside=float((vehicle.columns[:, 2] - ground).min(initial=math.inf)),
        height=float((vehicle.columns[:, 3] - ground).max(initial=0.0)),
        tread=float(np.linalg.norm(offsets, axis=2).max()),
    )


def steepest_balanced(vehicle: VehicleArrays, margin: float) -> float:
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


def easy_cells(terrain: TerrainArrays, vehicle: VehicleArrays) -> NDArray[np.bool_]:
    """Cells of the terrain anywhere in which the vehicle can stand in any heading.

    A cell that is not among them may be good as well.

    Returns:
        Shape (nx, ny).
    """
    easy = np.zeros(terrain.heights.shape, np.bool_)
    allowance = allowance_of(vehicle)
    if allowance.rise > 0.0:
        _mark(terrain, allowance, easy)
    return easy


@njit(cache=True, nogil=True)
def _mark(terrain: Any, allowance: Any, easy: Any) -> None:
    nx, ny = easy.shape
    edge = terrain.resolution
    reach = math.ceil(allowance.reach / edge) + 1
    for i in range(reach, nx - reach):
        for j in range(reach, ny - reach):
            easy[i, j] = _is_easy(terrain, allowance, i, j, reach)


@njit(cache=True, nogil=True)
def _is_easy(terrain: Any, allowance: Any, i: int, j: int, reach: int) -> bool:
    """Whether the square about a cell is near enough to one plane, and open above it."""
    if not (terrain.step[i, j] <= allowance.step):
        return False
    level, rise_x, rise_y = _plane_of(terrain.heights, i, j, reach)
    rise = math.hypot(rise_x, rise_y) / terrain.resolution
    if not rise < allowance.rise:
        return False
    heights, steps, roughness, tops = terrain.heights, terrain.step, terrain.roughness, terrain.top
    deviation, room, step, rough = 0.0, math.inf, 0.0, 0.0
    for a in range(i - reach, i + reach + 1):
        for b in range(j - reach, j + reach + 1):
            plane = level + rise_x * (a - i) + rise_y * (b - j)
            deviation = max(deviation, abs(heights[a, b] - plane))
            room = min(room, tops[a, b] - plane)
            step, rough = max(step, steps[a, b]), max(rough, roughness[a, b])
    rise += deviation * allowance.steepening
    bend = deviation * (1.0 + allowance.amplification) + rise * terrain.resolution
    lift = allowance.tread * rise
    return (
        deviation * allowance.misfit < allowance.travel
        and rise < allowance.rise
        and step <= allowance.step
        and rough <= allowance.roughness
        and bend < allowance.underside
        and allowance.height * math.sqrt(1.0 + rise * rise) + lift + bend < room
    )


@njit(cache=True, nogil=True)
def _plane_of(heights: Any, i: int, j: int, reach: int) -> tuple[float, float, float]:
    """Least-squares plane of the square about a cell: level, rise per cell along x and y.

    Level is NaN where a height is unknown.
    """
    level, sum_x, sum_y = 0.0, 0.0, 0.0
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            z = heights[i + a, j + b]
            level, sum_x, sum_y = level + z, sum_x + a * z, sum_y + b * z
        if math.isnan(level):
            return level, level, level
    side = 2.0 * reach + 1.0
    moment = side * side * (side * side - 1.0) / 12.0
    return level / (side * side), sum_x / moment, sum_y / moment
