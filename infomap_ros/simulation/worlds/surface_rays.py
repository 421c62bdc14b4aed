"""Straight lines against the triangles of a true surface, through its grid of cells.

Cells are walked in the order in which the line meets them (Amanatides and Woo, A Fast Voxel
Traversal Algorithm for Ray Tracing, Eurographics 1987, doi:10.2312/egtp.19871000); triangles are
cut after Moeller and Trumbore (J. Graphics Tools 2(1), 1997, doi:10.1080/10867651.1997.10487468).
"""

from __future__ import annotations

import numpy as np
from numba import njit

_PARALLEL = 1e-14


@njit(nogil=True, cache=True)
def first_hits(origins, ends, triangles, starts, members, low, shape, cell):  # type: ignore[no-untyped-def]
    """Share of the way from each origin to its end at which it first meets a triangle; inf = never.

    Args:
        origins: shape (N, 3).
        ends: shape (N, 3).
        triangles: shape (T, 3, 3).
        starts: first member of each cell, shape (cells + 1,).
        members: triangles of the cells.
        low: lowest corner of the grid.
        shape: number of cells, shape (3,).
        cell: edge length of a cell.
    """
    shares = np.empty(len(origins))
    for n in range(len(origins)):
        shares[n] = first_hit(
            origins[n], ends[n] - origins[n], triangles, starts, members, low, shape, cell
        )
    return shares


@njit(nogil=True, cache=True)
def seen_by_count(  # type: ignore[no-untyped-def]
    points, normals, cameras, limits, enough, tries, triangles, starts, members, low, shape, cell
):
    """How many of the cameras see each point of the surface, counted up to `enough`.

    `points` on the surface with outward `normals`, and `cameras`, are of shape (N, 3), (N, 3) and
    (M, 3); `limits` holds the smallest and largest distance, the smallest cosine of the angle of
    incidence, the lowest and highest sine of the direction's elevation, and how far a point is
    lifted off its surface. `tries` is the number of cameras within these limits that are asked at
    most. All that follows is as in `first_hits`.
    """
    nearest, farthest, cosine, lowest, highest, lift = limits
    counts = np.zeros(len(points), np.int64)
    origin, way = np.empty(3), np.empty(3)
    for n in range(len(points)):
        asked = 0
        stride = 7919  # so that neighbors in the list, which see alike, are not asked in a row
        for m in range(len(cameras)):
            c = (m * stride + n) % len(cameras)
            squared = incidence = 0.0
            for axis in range(3):
                origin[axis] = points[n, axis] + lift * normals[n, axis]
                way[axis] = cameras[c, axis] - origin[axis]
                squared += way[axis] * way[axis]
                incidence += way[axis] * normals[n, axis]
            if squared > farthest * farthest or squared < nearest * nearest:
                continue
            distance = np.sqrt(squared)
            elevation = -way[2] / distance
            if incidence < cosine * distance or elevation < lowest or elevation > highest:
                continue
            asked += 1
            if first_hit(origin, way, triangles, starts, members, low, shape, cell) > 1.0:
                counts[n] += 1
            if counts[n] >= enough or asked >= tries:
                break
    return counts


@njit(nogil=True, cache=True)
def first_hit(origin, way, triangles, starts, members, low, shape, cell):  # type: ignore[no-untyped-def]
    """As `first_hits` for one line from `origin` along `way`, both of shape (3,)."""
    entry, leave = 0.0, 1.0
    for axis in range(3):
        first, last = low[axis], low[axis] + shape[axis] * cell
        if way[axis] == 0.0:
            if origin[axis] < first or origin[axis] > last:
                return np.inf
            continue
        a, b = (first - origin[axis]) / way[axis], (last - origin[axis]) / way[axis]
        entry, leave = max(entry, min(a, b)), min(leave, max(a, b))
    if entry > leave:
        return np.inf
    index = np.empty(3, np.int64)
    step = np.zeros(3, np.int64)
    border, width = np.full(3, np.inf), np.full(3, np.inf)
    for axis in range(3):
        place = (origin[axis] + entry * way[axis] - low[axis]) / cell
        index[axis] = min(max(int(np.floor(place)), 0), shape[axis] - 1)
        if way[axis] != 0.0:
            step[axis] = 1 if way[axis] > 0.0 else -1
            side = low[axis] + (index[axis] + (1 if way[axis] > 0.0 else 0)) * cell
            border[axis] = (side - origin[axis]) / way[axis]
            width[axis] = cell / abs(way[axis])
    return _walk(origin, way, leave, index, step, border, width, triangles, starts, members, shape)


@njit(nogil=True, cache=True)
def _walk(  # type: ignore[no-untyped-def]
    origin, way, leave, index, step, border, width, triangles, starts, members, shape
):
    """Look at the triangles cell by cell until one is hit before its cell is left."""
    best = np.inf
    while True:
        bucket = (index[0] * shape[1] + index[1]) * shape[2] + index[2]
        for m in range(starts[bucket], starts[bucket + 1]):
            best = min(best, _cut(origin, way, triangles, members[m]))
        axis = 0
        if border[1] < border[axis]:
            axis = 1
        if border[2] < border[axis]:
            axis = 2
        if best <= border[axis] or border[axis] > leave:
            return best if best <= 1.0 else np.inf
        index[axis] += step[axis]
        if index[axis] < 0 or index[axis] >= shape[axis]:
            return np.inf
        border[axis] += width[axis]


@njit(nogil=True, cache=True)
def _cut(origin, way, triangles, t):  # type: ignore[no-untyped-def]
    """Share of the way at which the line meets triangle t, from either side; inf = never."""
    ax, ay, az = triangles[t, 0]
    ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
    vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
    px, py, pz = way[1] * vz - way[2] * vy, way[2] * vx - way[0] * vz, way[0] * vy - way[1] * vx
    determinant = ux * px + uy * py + uz * pz
    if abs(determinant) < _PARALLEL:
        return np.inf
    inverse = 1.0 / determinant
    sx, sy, sz = origin[0] - ax, origin[1] - ay, origin[2] - az
    a = (sx * px + sy * py + sz * pz) * inverse
    if a < 0.0 or a > 1.0:
        return np.inf
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    b = (way[0] * qx + way[1] * qy + way[2] * qz) * inverse
    if b < 0.0 or a + b > 1.0:
        return np.inf
    share = (vx * qx + vy * qy + vz * qz) * inverse
    return share if share >= 0.0 else np.inf
