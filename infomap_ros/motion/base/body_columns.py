"""The body of a robot as vertical columns, for comparison with a terrain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from infomap_ros.geometry import PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.solid_extent import solid_extent

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
