"""A pyramid over the range image that answers for whole footprints.

`lower` is the depth up to which every measured pixel of a cell sees through, `share` the part of
its area that is measured, `safe` the smallest `lower` of a cell and its neighbors (-inf where too
little of one is measured), `upper` what its farthest-seeing pixel reaches.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel

LOW_CELL = 8
"""Parts of an image that begin at multiples of this [px] share no cell of the low levels."""

_LOW_LEVELS = 3
_MEASURED = 2.0 / 3.0  # share of a cell that must be measured for it to see through


class Pyramid(NamedTuple):
    """Depth pyramid; level l has cells of 2^(l + 1) pixels, all levels in flat arrays.

    Attributes:
        lower: depth up to which all measured pixels of a cell see through, float32 [m]; inf where
            none is measured.
        share: part of a cell's area that is measured, 0 to 1, float32.
        safe: smallest `lower` of a cell and its neighbors, float32 [m].
        upper: float32 [m].
        starts: first cell of each level, int64.
        widths: cells per row of each level, int64.
        heights: rows of cells of each level, int64.
    """

    lower: NDArray[np.float32]
    share: NDArray[np.float32]
    safe: NDArray[np.float32]
    upper: NDArray[np.float32]
    starts: NDArray[np.int64]
    widths: NDArray[np.int64]
    heights: NDArray[np.int64]


def empty_pyramid(width: int, height: int) -> Pyramid:
    """Storage for an image of this size [px]."""
    widths, heights = [(width + 1) // 2], [(height + 1) // 2]
    while max(widths[-1], heights[-1]) > 1:
        widths.append((widths[-1] + 1) // 2)
        heights.append((heights[-1] + 1) // 2)
    cells = np.array(widths) * np.array(heights)
    starts = np.concatenate([[0], np.cumsum(cells)[:-1]]).astype(np.int64)
    total = int(cells.sum())
    return Pyramid(
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        starts,
        np.array(widths, np.int64),
        np.array(heights, np.int64),
    )


def ground_level(pyramid: Pyramid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`lower` and `upper` of the lowest level, by row and column of its cells."""
    shape = int(pyramid.heights[0]), int(pyramid.widths[0])
    cells = shape[0] * shape[1]
    return pyramid.lower[:cells].reshape(shape), pyramid.upper[:cells].reshape(shape)


@kernel
def build_low_levels(pyramid: Any, first: int, last: int) -> None:
    """Fill the levels whose cells are no wider than `LOW_CELL`, for some rows of the image.

    Those of the ground level have `lower` and `upper`. `safe` is left out in the cells beside other
    rows.

    Args:
        pyramid: a `Pyramid`.
        first: first row of the image [px], a multiple of `LOW_CELL`.
        last: one past the last row, a multiple of `LOW_CELL` or the height.
    """
    lower, share, width = pyramid.lower, pyramid.share, pyramid.widths[0]
    for i in range((first >> 1) * width, ((last + 1) >> 1) * width):
        share[i] = 1.0 if lower[i] < np.inf else 0.0
    for level in range(min(_LOW_LEVELS, len(pyramid.starts))):
        cell = 2 << level
        top, bottom = first // cell, (last + cell - 1) // cell
        if level > 0:
            _build_level(pyramid, level, top, bottom)
        is_end = bottom == pyramid.heights[level]
        _spread_level(pyramid, level, top + (top > 0), bottom - (0 if is_end else 1))


@kernel
def build_high_levels(pyramid: Any, cuts: Any) -> None:
    """Fill the other levels, and `safe` where it was left out.

    Args:
        pyramid: a `Pyramid`.
        cuts: rows of the image at which `build_low_levels` began, the first excepted.
    """
    for level in range(len(pyramid.starts)):
        if level >= _LOW_LEVELS:
            _build_level(pyramid, level, 0, pyramid.heights[level])
            _spread_level(pyramid, level, 0, pyramid.heights[level])
            continue
        for cut in cuts:
            row = cut // (2 << level)
            _spread_level(pyramid, level, max(row - 1, 0), min(row + 1, pyramid.heights[level]))


@kernel
def _build_level(pyramid: Any, level: int, first: int, last: int) -> None:
    """Fill the rows [first, last) of a level from the level below."""
    lower, share, upper = pyramid.lower, pyramid.share, pyramid.upper
    below, below_start = pyramid.widths[level - 1], pyramid.starts[level - 1]
    below_height, width = pyramid.heights[level - 1], pyramid.widths[level]
    for v in range(first, last):
        for u in range(width):
            low, high = np.inf, -np.inf
            parts, measured = 0, 0.0
            for dv in range(2):
                for du in range(2):
                    if 2 * v + dv < below_height and 2 * u + du < below:
                        i = below_start + (2 * v + dv) * below + 2 * u + du
                        parts += 1
                        measured += share[i]
                        low = min(low, lower[i])
                        high = max(high, upper[i])
            cell = pyramid.starts[level] + v * width + u
            lower[cell], share[cell] = low, measured / parts
            upper[cell] = high


@kernel
def _spread_level(pyramid: Any, level: int, first: int, last: int) -> None:
    """Fill `safe` from `lower` and `share` in the rows [first, last) of a level.

    Of a table top that is seen edge-on no pixel may be kept, as all are next to a jump of depth.
    What is measured beside the strip that is left out says nothing of the table top.
    """
    lower, share, safe = pyramid.lower, pyramid.share, pyramid.safe
    width, height = pyramid.widths[level], pyramid.heights[level]
    start = pyramid.starts[level]
    for v in range(first, last):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        columns_before, columns_here = np.inf, np.inf
        for u in range(width + 1):
            columns_next = np.inf
            if u < width:
                a, b, c = above * width + u, v * width + u, below * width + u
                columns_next = min(
                    _seen(lower, share, start + a),
                    min(_seen(lower, share, start + b), _seen(lower, share, start + c)),
                )
            if u > 0:
                safe[start + v * width + u - 1] = min(
                    columns_before, min(columns_here, columns_next)
                )
            columns_before, columns_here = columns_here, columns_next


@kernel
def _seen(lower: Any, share: Any, cell: int) -> Any:
    """Depth up to which a cell sees through, -inf where too little of it is measured."""
    return lower[cell] if share[cell] >= _MEASURED else np.float32(-np.inf)


@kernel
def level_for(pyramid: Any, extent: float) -> int:
    """Lowest level whose cells are at least `extent` pixels wide."""
    level, cell = 0, 2.0
    while cell < extent and level < len(pyramid.starts) - 1:
        level += 1
        cell *= 2.0
    return level


@kernel
def all_see_past(
    pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int, depth: float
) -> bool:
    """Whether all cells of the pixels [u0, u1] x [v0, v1] are measured and see past a depth [m]."""
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            if pyramid.share[start + u] < 1.0 or pyramid.lower[start + u] <= depth:
                return False
    return True


@kernel
def most(values: Any, pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int) -> float:
    """Largest value of the cells that cover the pixels [u0, u1] x [v0, v1]."""
    largest = -np.inf
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            largest = max(largest, values[start + u])
    return largest
