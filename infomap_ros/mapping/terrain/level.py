"""Which of the surfaces in a column of the map is the ground of the robot's level.

The ground grows from the robot outwards, always next where it changes least (Prim's order), and
takes in each column the surface nearest to the height of the neighbor from which it came, if it is
not far above or below it. So it follows ramps under ceilings and floors under tables, and a ceiling
under which no floor was seen is none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.terrain.cubes import OPEN, SOLID, SUSPECT

_GRAZED = 2  # cubes from the neighbor's ground to a surface above which nothing was seen
_UNKNOWN_COST = 2  # cubes of height change that growing across a column without ground counts as


@njit(cache=True, nogil=True)
def grow_level(
    cubes: Any, seed: Any, headroom: int, gap: int, climb: int, top: Any, level: Any
) -> None:
    """Find the ground of every column.

    Args:
        cubes: states, shape (nx, ny, nz).
        seed: cube of the robot's base or its ground, shape (3,): the ground there is the highest
            surface that is not above it.
        headroom: cubes above a surface that must not be solid.
        gap: unknown cubes above a surface that are tolerated.
        climb: cubes between the ground of neighbors; what is farther is another level.
        top: receives the uppermost cube of the ground, -1 where there is none, shape (nx, ny).
        level: receives the height at which ground was looked for [cubes], shape (nx, ny).
    """
    nx, ny, nz = cubes.shape
    top[:], level[:] = -1, -1
    starts, surfaces, climbs = _list_surfaces(cubes, headroom, gap, climb)
    capacity = 4 * nx * ny + 1
    cells, tops = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    levels, following = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    buckets = np.full(nz + 1, -1, np.int64)
    anchored = np.zeros(nx * ny, np.bool_)
    cells[0], levels[0], following[0] = seed[0] * ny + seed[1], seed[2], -1
    tops[0] = _surface_below(starts, surfaces, cells[0], seed[2], climbs[cells[0]])
    buckets[0], count, lowest = 0, 1, 0
    while lowest <= nz:
        entry = buckets[lowest]
        if entry < 0:
            lowest += 1
            continue
        buckets[lowest] = following[entry]
        cell = cells[entry]
        i, j = cell // ny, cell % ny
        if level[i, j] >= 0:
            continue
        top[i, j] = tops[entry]
        here = tops[entry] if tops[entry] >= 0 else levels[entry]
        level[i, j] = here
        anchored[cell] = anchored[cell] or tops[entry] >= 0
        for side in range(4):
            a, b = i + (side == 0) - (side == 1), j + (side == 2) - (side == 3)
            if not (0 <= a < nx and 0 <= b < ny) or level[a, b] >= 0:
                continue
            other = a * ny + b
            if anchored[cell]:
                anchored[other] = True
                surface = _surface_near(starts, surfaces, other, here, climbs[other])
            else:
                surface = _surface_below(starts, surfaces, other, here, climbs[other])
            cost = min(abs(surface - here), nz) if surface >= 0 else _UNKNOWN_COST
            cells[count], tops[count], levels[count] = other, surface, here
            following[count] = buckets[cost]
            buckets[cost] = count
            count += 1
            lowest = min(lowest, cost)


@njit(cache=True, nogil=True)
def _list_surfaces(cubes: Any, headroom: int, gap: int, climb: int) -> Any:
    """Where each column's surfaces begin, their uppermost cubes, upwards, and how far they may be.

    What was hit once is ground only where nothing else is: else it is noise above it. And where
    nothing was seen above, as above a floor at a grazing angle, only what continues the neighbor's
    ground is.
    """
    nx, ny, nz = cubes.shape
    climbs = np.full(nx * ny, climb, np.int64)
    starts = np.zeros(nx * ny + 1, np.int64)
    surfaces = np.empty(nx * ny, np.int64)
    count = 0
    for cell in range(nx * ny):
        i, j = cell // ny, cell % ny
        if count + nz > len(surfaces):
            more = np.empty(2 * len(surfaces) + nz, np.int64)
            more[:count] = surfaces[:count]
            surfaces = more
        for weakest, is_open in ((SOLID, True), (SUSPECT, True), (SOLID, False)):
            for k in range(nz - 1):
                if cubes[i, j, k] >= weakest and _is_surface_top(
                    cubes, i, j, k, headroom, gap, weakest, is_open
                ):
                    surfaces[count] = k
                    count += 1
            if count > starts[cell]:
                climbs[cell] = climb if is_open else min(climb, _GRAZED)
                break
        starts[cell + 1] = count
    return starts, surfaces, climbs


@njit(cache=True, nogil=True)
def _is_surface_top(
    cubes: Any, i: int, j: int, k: int, headroom: int, gap: int, weakest: int, is_open: bool
) -> bool:
    """Whether the cubes above cube k are no surface themselves, and seen open where asked for."""
    seen = not is_open
    for h in range(1, min(max(headroom, gap + 1), cubes.shape[2] - 1 - k) + 1):
        state = cubes[i, j, k + h]
        if h <= headroom and state >= weakest:
            return False
        if h <= gap + 1 and state == OPEN:
            seen = True
    return seen


@njit(cache=True, nogil=True)
def _surface_near(starts: Any, surfaces: Any, cell: int, level: int, climb: int) -> int:
    """Surface of a column nearest to a level, of two as near the lower; -1 for none near."""
    best = -1
    for n in range(starts[cell], starts[cell + 1]):
        if best < 0 or abs(surfaces[n] - level) < abs(best - level):
            best = surfaces[n]
    return best if abs(best - level) <= climb else -1


@njit(cache=True, nogil=True)
def _surface_below(starts: Any, surfaces: Any, cell: int, level: int, climb: int) -> int:
    """Highest surface of a column not above a level, else the lowest above it; -1 for none near."""
    best = -1
    for n in range(starts[cell], starts[cell + 1]):
        if best < 0 or surfaces[n] <= level:
            best = surfaces[n]
    return best if best <= level + climb else -1


@njit(cache=True, nogil=True)
def read_columns(
    cubes: Any, top: Any, level: Any, gap: int, floor: Any, overhead: Any, seen: Any, pit: Any
) -> None:
    """Read above the ground of each column, in cubes from the array's bottom.

    Args:
        cubes: states, shape (nx, ny, nz).
        top: uppermost cube of the ground, -1 where there is none, shape (nx, ny).
        level: where ground was looked for [cubes], shape (nx, ny).
        gap: cubes in a row that were not seen through, and count as seen.
        floor: receives the lower end of the open space, nz where there is none, shape (nx, ny).
        overhead: receives the lower end of the first solid cube above, nz + 1 where there is none.
        seen: receives the upper end of what was seen without a gap, shape (nx, ny).
        pit: receives whether a column without ground is no hole in what was seen: open space was
            seen well below the level, or something stands there.
    """
    nx, ny, nz = cubes.shape
    for i in range(nx):
        for j in range(ny):
            bottom = top[i, j] + 1
            pit[i, j] = False
            if top[i, j] < 0:
                bottom = _open_from(cubes, i, j, max(level[i, j], 0))
                deep = level[i, j] - 2
                pit[i, j] = bottom >= nz or (deep >= 0 and cubes[i, j, deep] == OPEN)
            floor[i, j] = bottom
            overhead[i, j], seen[i, j] = read_above(cubes, i, j, bottom, gap)
            if bottom >= nz:
                overhead[i, j], _ = read_above(cubes, i, j, max(level[i, j], 0), gap)


@njit(cache=True, nogil=True)
def _open_from(cubes: Any, i: int, j: int, level: int) -> int:
    """Lowest open cube from a level upwards with nothing solid between, nz for none."""
    nz = cubes.shape[2]
    for k in range(level, nz):
        if cubes[i, j, k] == SOLID:
            return nz
        if cubes[i, j, k] == OPEN:
            return k
    return nz


@njit(cache=True, nogil=True)
def read_above(cubes: Any, i: int, j: int, bottom: int, gap: int) -> tuple[int, int]:
    """First solid cube from `bottom` upwards (nz + 1 for none), and the end of what was seen."""
    nz = cubes.shape[2]
    seen, is_seen = bottom, True
    for k in range(bottom, nz):
        if cubes[i, j, k] == SOLID:
            if is_seen and k - seen <= gap:
                seen = k
            return k, seen
        if is_seen and cubes[i, j, k] == OPEN:
            if k - seen > gap:
                is_seen = False
            else:
                seen = k + 1
    return nz + 1, seen


@njit(cache=True, nogil=True)
def above_ground(cubes: Any, i: int, j: int, ground: int, headroom: int) -> int:
    """First cube above ground in cube `ground` and above what is solid within `headroom` of it."""
    nz = cubes.shape[2]
    bottom = min(max(ground + 1, 0), nz)
    for k in range(bottom, min(bottom + headroom, nz)):
        if cubes[i, j, k] == SOLID:
            bottom = k + 1
    return bottom
