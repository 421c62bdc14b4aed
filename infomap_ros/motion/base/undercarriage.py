"""Wheels and support polygon of a robot, read from its model."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import solid_extent

_SAMPLE_SPACING = 0.05  # of points along and across a wheel's tread [m]
_ALONG = 0.9  # tread points reach so far forward and back, in radii


@dataclass(frozen=True, eq=False)
class Undercarriage:
    """What touches the ground, base frame.

    Attributes:
        names: of the wheels or corners.
        centers: shape (W, 3) [m].
        contacts: points that may touch ground, shape (W, S, 3) [m].
        outline: corners of the ground between the wheels seen from above, counter-clockwise,
            shape (E, 2) [m].
        support: lowest points of the wheels at the corners of the support polygon,
            counter-clockwise from above, shape (C, 3) [m].
    """

    names: tuple[str, ...]
    centers: FloatArray
    contacts: FloatArray
    outline: FloatArray
    support: FloatArray


def wheels_of(robot: RobotModel, patterns: str, solids: Sequence[PlacedSolid]) -> Undercarriage:
    """Wheels are the links with a shape whose names match one of the patterns (comma-separated).

    Args:
        robot: the robot.
        patterns: as of a file name, for example ``*_wheel,caster*``.
        solids: of all links, in the base frame.

    Raises:
        RobotModelError: fewer than three links that match have a collision shape, or all are in
            one line.
    """
    globs = [pattern.strip() for pattern in patterns.split(",")]
    solid_links = {solid.name for solid in solids}
    names = tuple(
        name
        for name in robot.frames
        if name in solid_links and any(fnmatch.fnmatchcase(name, glob) for glob in globs)
    )
    if len(names) < 3:
        raise RobotModelError(
            f"robot '{robot.name}' has {len(names)} links with a collision shape that match "
            f"'{patterns}', expected at least 3 wheels: give another pattern or a footprint"
        )
    centers, treads = [], []
    for name in names:
        own = [solid for solid in solids if solid.name == name]
        low, high = (np.array(x) for x in zip(*(solid_extent(solid) for solid in own), strict=True))
        low, high = low.min(axis=0), high.max(axis=0)
        centers.append(0.5 * (low + high))
        treads.append(_tread(0.5 * (high[2] - low[2]), 0.5 * (high[1] - low[1])))
    most = max(len(tread) for tread in treads)
    padded = [np.concatenate([t, np.repeat(t[:1], most - len(t), axis=0)]) for t in treads]
    contacts = np.array(centers)[:, None] + np.array(padded)
    return _undercarriage(names, np.array(centers), contacts)


def footprint_of(corners: Sequence[float], height: float) -> Undercarriage:
    """A body without wheels that rests on the corners of a polygon.

    Args:
        corners: x0, y0, x1, y1, ... base frame [m].
        height: of the ground in the base frame [m].

    Raises:
        RobotModelError: fewer than three corners, or all in one line.
    """
    if len(corners) < 6 or len(corners) % 2:
        raise RobotModelError(f"a footprint of {len(corners)} numbers, expected 3 or more x, y")
    points = np.array(corners, dtype=np.float64).reshape(-1, 2)
    centers = np.column_stack([points, np.full(len(points), height)])
    names = tuple(f"corner {index}" for index in range(len(points)))
    return _undercarriage(names, centers, centers[:, None])


def _undercarriage(
    names: tuple[str, ...], centers: FloatArray, contacts: FloatArray
) -> Undercarriage:
    lowest = contacts[np.arange(len(contacts)), contacts[:, :, 2].argmin(axis=1)].copy()
    lowest[:, :2] = centers[:, :2]
    support = lowest[_hull(lowest[:, :2])]
    touching = contacts.reshape(-1, 3)[:, :2]
    return Undercarriage(names, centers, contacts, touching[_hull(touching)], support)


def _hull(points: FloatArray) -> NDArray[np.int64]:
    """Indices of the corners of the convex hull of points, shape (n, 2), counter-clockwise."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(ConvexHull(points).vertices, dtype=np.int64)
    except (QhullError, ValueError) as error:
        raise RobotModelError("the wheels or corners of the footprint are in one line") from error


def _tread(radius: float, half_width: float) -> FloatArray:
    """Points of the lower half of a wheel that rolls along x, about its center, shape (S, 3)."""
    along = np.linspace(-_ALONG, _ALONG, 2 * max(1, round(_ALONG * radius / _SAMPLE_SPACING)) + 1)
    across = np.linspace(-1.0, 1.0, max(1, int(np.ceil(2.0 * half_width / _SAMPLE_SPACING))) + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(along * radius, across * half_width))
    points = np.column_stack([x, y, -np.sqrt(radius**2 - x**2)])
    return points[np.lexsort((np.abs(y), points[:, 2]))]
