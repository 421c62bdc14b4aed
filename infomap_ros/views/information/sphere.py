"""Directions around a position in cells of nearly equal width: the faces of a cube, bent.

A direction lies on the face that its largest component names; the other two, divided by it, are in
[-1, 1] and are stretched by w(u) = u (1.2 - 0.2 u^2), which makes a cell at the middle of a face as
wide, seen from the center, as one at its edge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray

_STRETCH = 1.2


def cells_per_edge(spacing: float) -> int:
    """Cells along the edge of a face so that none is wider than `spacing` [rad].

    An odd number: level directions lie in the middle of a row of cells, and are cast level.
    """
    return math.ceil(2.0 / _STRETCH / spacing) // 2 * 2 + 1


def cell_middles(cells: int) -> FloatArray:
    """Coordinates u of the middles of `cells` cells along an edge, shape (cells,)."""
    w = (np.arange(cells) + 0.5) * (2.0 / cells) - 1.0
    u = w.copy()
    for _ in range(20):
        error = u * (_STRETCH - (_STRETCH - 1.0) * u * u) - w
        u -= error / (_STRETCH - 3.0 * (_STRETCH - 1.0) * u * u)
    return np.asarray(u)


@kernel
def _cell_along(u: float, cells: int) -> int:
    w = u * (_STRETCH - (_STRETCH - 1.0) * u * u)
    return min(int((w + 1.0) * 0.5 * cells), cells - 1)


@kernel
def cell_of(direction: Any, cells: int) -> int:
    """Cell in which a direction lies; there are ``6 cells^2``."""
    x, y, z = direction
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, scale, u, v = (0 if x > 0.0 else 1), 1.0 / ax, y, z
    elif ay >= az:
        face, scale, u, v = (2 if y > 0.0 else 3), 1.0 / ay, z, x
    else:
        face, scale, u, v = (4 if z > 0.0 else 5), 1.0 / az, x, y
    row = face * cells + _cell_along(u * scale, cells)
    return row * cells + _cell_along(v * scale, cells)


@kernel
def cell_direction(cell: int, middles: Any) -> tuple[float, float, float]:
    """Unit vector through the middle of a cell; `middles` as of `cell_middles`."""
    cells = len(middles)
    u, v = middles[cell // cells % cells], middles[cell % cells]
    face = cell // (cells * cells)
    length = 1.0 / math.sqrt(1.0 + u * u + v * v)
    side = length if face % 2 == 0 else -length
    u, v = u * length, v * length
    if face < 2:
        return side, u, v
    if face < 4:
        return v, side, u
    return u, v, side
