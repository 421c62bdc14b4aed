"""Small holes of the ground filled, and how rough and stepped it is.

Occupancy as the terrain needs it: dense cubes of about the terrain's resolution, no specks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.voxels.block_kernels import quanta_of
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, BLOCK_SIDE, BLOCK_VOXELS, UNSEEN, unpack
from infomap_ros.mapping.voxels.queries import is_surface, voxel_of
from infomap_ros.mapping.voxels.surface_kernels import ROW_SIZE, read_block

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


NEVER_SEEN, OPEN, SUSPECT, SOLID = 0, 1, 2, 3
"""States of a cube by its most occupied voxel: nothing speaks for or against it; seen through; hit
once; hit again and again. A surface's weak hits behind it make nothing open."""

_FLATTEST = 0.2  # share of a Gaussian's information along z from which it is ground (about 63 deg)
_BELOW = 1  # cubes below the uppermost solid one in which a surface is still that of its top
_SMEARED = 3  # cubes that doubtful poses may have made solid above a surface


@njit(cache=True, nogil=True)
def gather_cubes(
    blocks: Any, first: Any, ratio: int, occupied: float, confirmed: float, cubes: Any
) -> None:
    """State of cubes of `ratio`^3 voxels.

    Args:
        blocks: a `BlockArrays`.
        first: index of cube (0, 0, 0) of the array, shape (3,).
        ratio: voxels along the edge of a cube.
        occupied: evidence above which a voxel was hit [quanta].
        confirmed: evidence above which it was hit repeatedly [quanta].
        cubes: receives the states, uint8, shape (nx, ny, nz); zero before.
    """
    places = np.empty((3, BLOCK_SIDE), np.int64)
    for slot in range(blocks.counts[BLOCK_COUNT]):
        if blocks.kind[slot] == UNSEEN:
            continue
        corner, inside = unpack(blocks.keys[slot]), True
        for axis in range(3):
            for n in range(BLOCK_SIDE):
                places[axis, n] = (corner[axis] * BLOCK_SIDE + n) // ratio - first[axis]
            size = cubes.shape[axis]
            inside = inside and places[axis, BLOCK_SIDE - 1] >= 0 and places[axis, 0] < size
        if inside:
            _gather_block(blocks, slot, places, occupied, confirmed, cubes)


@njit(cache=True, nogil=True)
def _gather_block(
    blocks: Any, slot: int, places: Any, occupied: float, confirmed: float, cubes: Any
) -> None:
    """Enter a block's voxels into the cubes whose indices `places` holds per axis."""
    nx, ny, nz = cubes.shape
    kind, base, row = blocks.kind[slot], blocks.base[slot], blocks.plane[slot]
    narrow, wide = blocks.narrow, blocks.wide
    for c in range(BLOCK_SIDE):
        k = places[2, c]
        if not 0 <= k < nz:
            continue
        for b in range(BLOCK_SIDE):
            j = places[1, b]
            if not 0 <= j < ny:
                continue
            for a in range(BLOCK_SIDE):
                i = places[0, a]
                local = a | (b << 3) | (c << 6)
                known, value = quanta_of(kind, base, row, narrow, wide, local)
                if known and 0 <= i < nx:
                    state = NEVER_SEEN
                    if value > confirmed:
                        state = SOLID
                    elif value > occupied:
                        state = SUSPECT
                    elif value < 0:
                        state = OPEN
                    cubes[i, j, k] = max(cubes[i, j, k], state)


@njit(cache=True, nogil=True)
def drop_specks(cubes: Any, largest: int) -> None:
    """Open the cubes that were hit in connected groups (26 neighbors) of at most `largest`."""
    if largest <= 0:
        return
    members = np.empty((largest + 1, 3), np.int64)
    nx, ny, nz = cubes.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if cubes[i, j, k] >= SUSPECT:
                    count = _group(cubes, i, j, k, members)
                    if count <= largest:
                        for n in range(count):
                            cubes[members[n, 0], members[n, 1], members[n, 2]] = OPEN


@njit(cache=True, nogil=True)
def _group(cubes: Any, i: int, j: int, k: int, members: Any) -> int:
    """Members of the group of a cube that was hit, as many as fit; their number."""
    nx, ny, nz = cubes.shape
    members[0, 0], members[0, 1], members[0, 2] = i, j, k
    count, next_one = 1, 0
    while next_one < count:
        x, y, z = members[next_one]
        next_one += 1
        for a in range(max(x - 1, 0), min(x + 2, nx)):
            for b in range(max(y - 1, 0), min(y + 2, ny)):
                for c in range(max(z - 1, 0), min(z + 2, nz)):
                    if cubes[a, b, c] < SUSPECT or _is_member(members, count, a, b, c):
                        continue
                    members[count, 0], members[count, 1], members[count, 2] = a, b, c
                    count += 1
                    if count == len(members):
                        return count
    return count


@njit(cache=True, nogil=True)
def _is_member(members: Any, count: int, a: int, b: int, c: int) -> bool:
    for n in range(count):
        if members[n, 0] == a and members[n, 1] == b and members[n, 2] == c:
            return True
    return False


@njit(cache=True, nogil=True)
def refine_heights(
    blocks: Any, gaussians: Any, size: float, first: Any, ratio: int, cubes: Any, top: Any,
    heights: Any, sigmas: Any,
) -> None:  # fmt: skip
    """Replace heights of cubes by those of the surface Gaussians in them and one cube below.

    A Gaussian's height is its conditional mean of z at the middle of its voxel's column, so that
    a slope is read where the column is: with information matrix A and vector b about the voxel's
    center, z = b_z / A_zz with variance 1 / A_zz. Gaussians of a cell are weighted by A_zz, and
    their deviation is not divided by their number, as their errors are correlated.

    Scans from doubtful poses make voxels above a surface solid in which no surface comes to lie:
    each of them says where it lies, below. Where no surface is near the top of what is solid, be
    it upright, and one a few cubes below is known better than to a cube, that is the ground.

    Args:
        blocks: a `BlockArrays`.
        gaussians: a `SurfaceArrays`.
        size: edge of a voxel [m].
        first: index of cube (0, 0, 0), shape (3,).
        ratio: voxels along the edge of a cube.
        cubes: states, shape (nx, ny, nz).
        top: uppermost cube of the ground per cell, -1 for none, shape (nx, ny).
        heights: height of the ground [m, map], shape (nx, ny); changed.
        sigmas: its standard deviation [m], shape (nx, ny); changed.
    """
    nx, ny = top.shape
    depths = _SMEARED + 1
    weights, sums = np.zeros((nx, ny, depths)), np.zeros((nx, ny, depths))
    counts, has_surface = np.zeros((nx, ny, depths)), np.zeros((nx, ny), np.bool_)
    work, mean = np.empty(6), np.empty(3)
    locals_, other = np.empty(BLOCK_VOXELS, np.int64), np.empty(ROW_SIZE, np.float32)
    records = np.empty((BLOCK_VOXELS, ROW_SIZE), np.float32)
    for slot in range(blocks.counts[BLOCK_COUNT]):
        for row in range(read_block(gaussians, slot, 0.5 * size, locals_, records, other)):
            voxel = slot * BLOCK_VOXELS + locals_[row]
            x, y, z = voxel_of(blocks, voxel)
            i, j = x // ratio - first[0], y // ratio - first[1]
            if not (0 <= i < nx and 0 <= j < ny) or top[i, j] < 0:
                continue
            below, information = top[i, j] - (z // ratio - first[2]), records[row]
            if not -1 <= below < depths or not is_surface(
                blocks, voxel, information, 0.5 * size, work, mean
            ):
                continue
            has_surface[i, j] = has_surface[i, j] or below <= _BELOW
            along_z = np.float64(information[5])
            if below < 0 or along_z < _FLATTEST * (information[0] + information[3] + along_z):
                continue
            offset = min(max(information[8] / along_z, -size), size)
            weights[i, j, below] += along_z
            sums[i, j, below] += along_z * ((z + 0.5) * size + offset)
            counts[i, j, below] += 1.0
    for i in range(nx):
        for j in range(ny):
            _refine(cubes[i, j], top[i, j], weights[i, j], sums[i, j], counts[i, j],
                    has_surface[i, j], i, j, heights, sigmas)  # fmt: skip


@njit(cache=True, nogil=True)
def _refine(
    column: Any, top: int, weights: Any, sums: Any, counts: Any, has_surface: bool, i: int, j: int,
    heights: Any, sigmas: Any,
) -> None:  # fmt: skip
    """Height of one cell, from sums over the Gaussians of the cubes from `top` downwards."""
    weight = weights[: _BELOW + 1].sum()
    if weight > 0.0:
        heights[i, j] = sums[: _BELOW + 1].sum() / weight
        sigmas[i, j] = np.sqrt(counts[: _BELOW + 1].sum() / weight)
        return
    for below in range(_BELOW + 1, len(weights)):
        if has_surface or top < below or column[top - below + 1] < SUSPECT:
            return
        if weights[below] > 0.0:
            sigma = np.sqrt(counts[below] / weights[below])
            if sigma < sigmas[i, j]:
                heights[i, j], sigmas[i, j] = sums[below] / weights[below], sigma
            return
