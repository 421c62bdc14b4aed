"""Small holes of the ground filled, and how rough and stepped it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

SURE = 1.0
"""Standard deviations by which ground counts as lower than it seems, where it is in the way."""
CUBE_SIGMA = 1.0 / math.sqrt(12.0)
"""Deviation of ground known to its cube [edges]; more excuses nothing: a stone is no ramp."""
STEP_LENGTH = 0.1
"""Along which a difference in height is a step, whatever the cells [m]: about a wheel's radius."""

_RING = 5  # known cells around a hole without which nothing is said of it


@njit(cache=True, nogil=True)
def fill_holes(
    heights: Any, sigmas: Any, forbidden: Any, largest: int, tolerance: float, filled: Any
) -> None:
    """Fill groups (4 neighbors) of at most `largest` cells without ground by interpolation.

    A hole is filled when every cell around it has ground, these fit one plane within `tolerance`,
    and no cell of the hole is forbidden. Its deviation is then the larger of the plane's worst
    misfit and the largest deviation around.

    Args:
        heights: of the ground [m], NaN where unknown, shape (nx, ny); changed.
        sigmas: deviations [m]; changed.
        forbidden: cells that are known not to be ground, bool.
        largest: cells.
        tolerance: [m].
        filled: receives which cells were filled, bool.
    """
    nx, ny = heights.shape
    members = np.empty((largest + 1, 2), np.int64)
    ring = np.empty((8 * (largest + 1), 2), np.int64)
    filled[:] = False
    if largest <= 0:
        return
    for i in range(nx):
        for j in range(ny):
            if not math.isnan(heights[i, j]) or forbidden[i, j]:
                continue
            count = _hole(heights, forbidden, i, j, members)
            if count < 0:
                continue
            around = _ring(heights, members, count, ring)
            if around >= _RING:
                _fill(heights, sigmas, members[:count], ring[:around], tolerance, filled)


@njit(cache=True, nogil=True)
def _hole(heights: Any, forbidden: Any, i: int, j: int, members: Any) -> int:
    """Cells of the hole at (i, j); -1 where it is too large, at the border, or forbidden."""
    nx, ny = heights.shape
    members[0, 0], members[0, 1] = i, j
    count, next_one = 1, 0
    while next_one < count:
        x, y = members[next_one, 0], members[next_one, 1]
        next_one += 1
        if not (0 < x < nx - 1 and 0 < y < ny - 1) or forbidden[x, y]:
            return -1
        for a in range(x - 1, x + 2):
            for b in range(y - 1, y + 2):
                if not math.isnan(heights[a, b]) or _is_in(members, count, a, b):
                    continue
                if count == len(members) - 1:
                    return -1
                members[count, 0], members[count, 1] = a, b
                count += 1
    return count


@njit(cache=True, nogil=True)
def _is_in(cells: Any, count: int, a: int, b: int) -> bool:
    found = False
    for n in range(count):
        found |= cells[n, 0] == a and cells[n, 1] == b
    return found


@njit(cache=True, nogil=True)
def _ring(heights: Any, members: Any, count: int, ring: Any) -> int:
    """Cells with ground next to a hole (8 neighbors); their number."""
    found = 0
    for n in range(count):
        x, y = members[n, 0], members[n, 1]
        for a in range(x - 1, x + 2):
            for b in range(y - 1, y + 2):
                if not math.isnan(heights[a, b]) and not _is_in(ring, found, a, b):
                    ring[found, 0], ring[found, 1] = a, b
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _fill(
    heights: Any, sigmas: Any, members: Any, ring: Any, tolerance: float, filled: Any
) -> None:
    x0, y0 = members[0, 0], members[0, 1]
    design, values = np.ones((len(ring), 3)), np.empty(len(ring))
    worst = 0.0
    for n in range(len(ring)):
        design[n, 1], design[n, 2] = ring[n, 0] - x0, ring[n, 1] - y0
        values[n] = heights[ring[n, 0], ring[n, 1]]
        worst = max(worst, sigmas[ring[n, 0], ring[n, 1]])
    plane = np.linalg.lstsq(design, values)[0]
    misfit = np.max(np.abs(design @ plane - values))
    if misfit > tolerance:
        return
    for n in range(len(members)):
        x, y = members[n, 0], members[n, 1]
        heights[x, y] = plane[0] + plane[1] * (x - x0) + plane[2] * (y - y0)
        sigmas[x, y] = max(worst, misfit)
        filled[x, y] = True


@njit(cache=True, nogil=True)
def largest_steps(heights: Any, sigmas: Any, edge: float, steps: Any) -> None:
    """Largest step that is sure to be there [m]; NaN without ground; `edge` is that of a cell [m].

    To a neighbor within half of `STEP_LENGTH`, at least the 8 next ones, or from there to the one
    opposite: an edge that the map blurs. It is the difference in height less `SURE` deviations:
    ground that was seen from afar is no stairs for its noise. Coming nearer shows it better.
    """
    nx, ny = heights.shape
    largest = math.sqrt(2.0) * CUBE_SIGMA * edge
    cells = max(0.5 * STEP_LENGTH / edge, 1.5) + 1e-6
    reach = int(cells)
    for i in range(nx):
        for j in range(ny):
            here, step = heights[i, j], 0.0
            for a in range(max(-reach, -i), min(reach, nx - 1 - i) + 1):
                for b in range(max(-reach, -j), min(reach, ny - 1 - j) + 1):
                    if a * a + b * b > cells * cells:
                        continue
                    there, sigma = heights[i + a, j + b], sigmas[i + a, j + b]
                    # The root of the variances takes most of the time: only where it may matter.
                    rise = abs(there - here)
                    if rise > step:
                        deviation = min(math.hypot(sigma, sigmas[i, j]), largest)
                        step = max(step, rise - SURE * deviation)
                    k, m = i - a, j - b
                    if (a, b) > (0, 0) and 0 <= k < nx and 0 <= m < ny:  # each pair once
                        rise = abs(there - heights[k, m])
                        if rise > step:
                            deviation = min(math.hypot(sigma, sigmas[k, m]), largest)
                            share = min(1.0, 0.5 * STEP_LENGTH / (math.hypot(a, b) * edge))
                            step = max(step, (rise - SURE * deviation) * share)
            steps[i, j] = math.nan if math.isnan(here) else step


@njit(cache=True, nogil=True)
def plane_misfits(heights: Any, reach: int, rise: float, roughness: Any) -> None:
    """Root mean square distance in z from the plane that fits the cells within `reach` best [m].

    Cells that differ from the one in the middle by more than `rise` [m] belong to something else,
    a wall for example. NaN without ground; 0 with fewer than 4 cells, or all in one row.
    """
    nx, ny = heights.shape
    for i in range(nx):
        for j in range(ny):
            roughness[i, j] = math.nan
            if not math.isnan(heights[i, j]):
                roughness[i, j] = _misfit(heights, i, j, reach, rise)


@njit(cache=True, nogil=True)
def _misfit(heights: Any, i: int, j: int, reach: int, rise: float) -> float:
    nx, ny = heights.shape
    origin = heights[i, j]
    n, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    sxx, sxy, syy, sxz, syz, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(max(i - reach, 0), min(i + reach + 1, nx)):
        for b in range(max(j - reach, 0), min(j + reach + 1, ny)):
            z = heights[a, b] - origin
            if not abs(z) <= rise:
                continue
            x, y = float(a - i), float(b - j)
            n += 1.0
            sx, sy, sz = sx + x, sy + y, sz + z
            sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
            sxz, syz, szz = sxz + x * z, syz + y * z, szz + z * z
    sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    sxz, syz, szz = sxz - sx * sz / n, syz - sy * sz / n, szz - sz * sz / n
    determinant = sxx * syy - sxy * sxy
    if n < 4.0 or determinant < 1e-9:
        return 0.0
    slope_x = (syy * sxz - sxy * syz) / determinant
    slope_y = (sxx * syz - sxy * sxz) / determinant
    return math.sqrt(max(szz - slope_x * sxz - slope_y * syz, 0.0) / n)
