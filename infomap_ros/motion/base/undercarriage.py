"""What a terrain is compared with: wheels, support polygon, columns of the body, center of mass."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

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


_FINE = 4  # points per edge of a square at which the solids are asked
_HEIGHT_STEP = 0.01  # of the search for a column's lowest and highest point [m]


def body_columns(
    solids: Sequence[PlacedSolid], spacing: float, margin: float, wider: float = 0.0
) -> FloatArray:
    """Lowest and highest point of a body over each square of a grid, grown by a margin.

    What lies between them counts as body, which errs towards "touches".

    Args:
        solids: the body, base frame.
        spacing: edge of the squares [m].
        margin: growth of the solids [m], at least a fifth of the spacing is taken.
        wider: further growth to all sides, not up or down [m].

    Returns:
        (x, y, lowest z, highest z) of the squares that hold body, shape (B, 4) [m].
    """
    if not solids:
        return np.zeros((0, 4))
    growth = max(margin, spacing / _FINE / np.sqrt(2.0))
    extents = np.array([solid_extent(solid) for solid in solids])
    around = growth + wider
    first = np.floor((extents[:, 0, :2].min(axis=0) - around) / spacing).astype(int)
    last = np.ceil((extents[:, 1, :2].max(axis=0) + around) / spacing).astype(int)
    shape = _FINE * (last - first) + 1
    lowest, highest = np.full(shape, np.inf), np.full(shape, -np.inf)
    for solid, (low, high) in zip(solids, extents, strict=True):
        _add(solid, low - growth, high + growth, growth, first, spacing, lowest, highest)
    if wider > 0.0:
        disk = _disk(wider * _FINE / spacing)
        lowest = minimum_filter(lowest, footprint=disk, mode="constant", cval=np.inf)
        highest = maximum_filter(highest, footprint=disk, mode="constant", cval=-np.inf)
    lowest, highest = _over_squares(lowest, np.minimum), _over_squares(highest, np.maximum)
    i, j = np.nonzero(highest >= lowest)
    x, y = (i + first[0] + 0.5) * spacing, (j + first[1] + 0.5) * spacing
    return np.column_stack([x, y, lowest[i, j] - _HEIGHT_STEP, highest[i, j] + _HEIGHT_STEP])


def off_the_ground(columns: FloatArray, ground: float, step: float, margin: float) -> FloatArray:
    """Columns of a body whose shapes reach down to the ground on which it stands.

    A shape that encloses wheels or casters, or a skirt, is no body where it touches level ground:
    it begins as high as the highest step that the vehicle drives over.

    Args:
        columns: of `body_columns`, shape (B, 4) [m].
        ground: height of level ground in the base frame [m].
        step: highest step [m].
        margin: by which the columns were grown [m].
    """
    lowest = columns[:, 2]
    touching = lowest <= ground + 2.0 * _HEIGHT_STEP
    lifted = np.where(touching, ground + max(step, margin + 2.0 * _HEIGHT_STEP), lowest)
    return np.column_stack([columns[:, :2], lifted, columns[:, 3]])[columns[:, 3] > lifted]


def _add(
    placed: PlacedSolid, low: FloatArray, high: FloatArray, growth: float,
    first: np.ndarray[tuple[int, ...], np.dtype[np.int_]], spacing: float,
    lowest: FloatArray, highest: FloatArray,
) -> None:  # fmt: skip
    """Lower `lowest` and raise `highest` at the points of the fine grid where the solid is."""
    step = spacing / _FINE
    begin = np.maximum(np.floor(low[:2] / step).astype(int) - _FINE * first, 0)
    end = np.minimum(np.ceil(high[:2] / step).astype(int) - _FINE * first + 1, lowest.shape)
    xs, ys = ((np.arange(begin[k], end[k]) + _FINE * first[k]) * step for k in range(2))
    zs = np.arange(low[2], high[2] + _HEIGHT_STEP, _HEIGHT_STEP)
    points = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1)
    local = (points - placed.transform[:3, 3]) @ placed.transform[:3, :3]
    inside = placed.solid.signed_distance(local) <= growth
    part = np.s_[begin[0] : end[0], begin[1] : end[1]]
    lowest[part] = np.minimum(lowest[part], np.where(inside, zs, np.inf).min(axis=2))
    highest[part] = np.maximum(highest[part], np.where(inside, zs, -np.inf).max(axis=2))


def _disk(radius: float) -> NDArray[np.bool_]:
    """Points of a grid of edge 1 within a radius of its middle."""
    offsets = np.arange(-int(radius), int(radius) + 1)
    return np.asarray(np.hypot(*np.meshgrid(offsets, offsets)) <= radius)


def _over_squares(fine: FloatArray, extreme: np.ufunc) -> FloatArray:
    """Extreme over each square and its border, from values on the fine grid."""
    for axis in range(2):
        steps = np.arange(0, fine.shape[axis] - 1, _FINE)
        inner = extreme.reduceat(np.delete(fine, -1, axis), steps, axis=axis)
        border = np.take(fine, steps + _FINE, axis)
        fine = extreme(inner, border)
    return fine


def center_of_mass(robot: RobotModel, joint_positions: Mapping[str, float]) -> FloatArray:
    """Center of mass, shape (3,) [m, base frame]; all joints must be there.

    Raises:
        RobotModelError: the robot has no inertials, or a joint is missing.
    """
    model = robot.model
    data = model.createData()
    pinocchio.forwardKinematics(
        model, data, robot.mechanism.configuration(joint_positions, robot.mechanism.indices)
    )
    masses = np.array([float(inertia.mass) for inertia in model.inertias])
    if masses.sum() <= 0.0:
        raise RobotModelError(f"robot '{robot.name}' has no inertials, so no center of mass")
    centers = np.array(
        [pose.act(i.lever) for pose, i in zip(data.oMi, model.inertias, strict=True)]
    ).reshape(-1, 3)
    center = (masses @ np.where(masses[:, None] > 0.0, centers, 0.0)) / masses.sum()
    root = str(model.frames[1].name)
    T_base_root = robot.forward_kinematics(joint_positions, root)
    return T_base_root[:3, :3] @ center + T_base_root[:3, 3]
