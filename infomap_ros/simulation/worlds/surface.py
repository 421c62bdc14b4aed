"""The true surface of a world as triangles: exact distance of any point, for tests of maps.

Straight lines against the triangles of a true surface, through its grid of cells.

Cells are walked in the order in which the line meets them (Amanatides and Woo, A Fast Voxel
Traversal Algorithm for Ray Tracing, Eurographics 1987, doi:10.2312/egtp.19871000); triangles are
cut after Moeller and Trumbore (J. Graphics Tools 2(1), 1997, doi:10.1080/10867651.1997.10487468).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray

_Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SurfacePart:
    """One body's surface.

    Attributes:
        name: of the body.
        vertices: shape (V, 3), world frame [m].
        faces: outward triangles, shape (F, 3).
    """

    name: str
    vertices: FloatArray
    faces: _Index


@dataclass(frozen=True, eq=False)
class SurfaceMatch:
    """The nearest surface of each of N points.

    Attributes:
        distances: shape (N,) [m], not negative; NaN for NaN points.
        points: nearest points on the surface, shape (N, 3) [m].
        normals: outward unit normals there, shape (N, 3).
        parts: index of the part, shape (N,); -1 for NaN points.
    """

    distances: FloatArray
    points: FloatArray
    normals: FloatArray
    parts: _Index


class SurfaceModel:
    """Exact nearest-surface queries on triangles, through a uniform grid.

    Args:
        parts: the bodies; their triangles may intersect each other.
        cell: edge length of the grid's cells [m]; affects speed alone.

    Raises:
        InvalidInputError: no triangle, or a vertex that is not finite.
    """

    def __init__(self, parts: Sequence[SurfacePart], cell: float = 0.1) -> None:
        corners = [part.vertices[part.faces] for part in parts]
        if not corners or not all(np.isfinite(c).all() for c in corners):
            raise InvalidInputError("surface parts", "need finite triangles")
        self.names = tuple(part.name for part in parts)
        self._triangles = np.ascontiguousarray(np.concatenate(corners))
        self._owner = np.repeat(np.arange(len(parts)), [len(c) for c in corners])
        self._cell = cell
        self._low = self._triangles.min(axis=(0, 1))
        self._shape = (
            np.floor((self._triangles.max(axis=(0, 1)) - self._low) / cell).astype(np.int64) + 1
        )
        self._starts, self._members = self._fill_grid()

    def distance(self, points: ArrayLike) -> FloatArray:
        """Distance to the nearest surface, never negative; (N, 3) [m] -> (N,) [m]."""
        return self.closest(points).distances

    def closest(self, points: ArrayLike) -> SurfaceMatch:
        """Find the nearest surface point of each point.

        Args:
            points: shape (N, 3), world frame [m]; NaN allowed.

        Raises:
            InvalidInputError: wrong shape.
        """
        queries = np.ascontiguousarray(points, dtype=np.float64)
        if queries.ndim != 2 or queries.shape[1] != 3:
            raise InvalidInputError("points", f"shape {queries.shape}, expected (N, 3)")
        nearest, found = _closest(queries, *self._grid)
        a, b, c = (self._triangles[found, k] for k in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals[found < 0] = np.nan
        distances = np.linalg.norm(queries - nearest, axis=1)
        return SurfaceMatch(
            distances, nearest, normals, np.where(found < 0, -1, self._owner[found])
        )

    def first_hits(self, origins: ArrayLike, ends: ArrayLike) -> FloatArray:
        """Where straight lines first meet the surface.

        Args:
            origins: shape (N, 3), world frame [m].
            ends: shape (N, 3), world frame [m].

        Returns:
            Share of the segment from origin to end, shape (N,); inf where nothing is met.
        """
        first = np.ascontiguousarray(origins, dtype=np.float64)
        last = np.ascontiguousarray(ends, dtype=np.float64)
        return np.asarray(first_hits(first, last, *self._grid))

    def count_views(
        self,
        points: FloatArray,
        normals: FloatArray,
        cameras: FloatArray,
        limits: tuple[float, ...],
        enough: int,
        tries: int,
    ) -> _Index:
        """How many cameras see each point; arguments as of `surface_rays.seen_by_count`."""
        return np.asarray(
            seen_by_count(points, normals, cameras, limits, enough, tries, *self._grid)
        )

    def samples(self, spacing: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Points spread over all triangles, one for about every `spacing` squared [m^2].

        Returns:
            Points, shape (N, 3) [m], and outward unit normals, shape (N, 3).
        """
        a, b, c = (self._triangles[:, k] for k in range(3))
        normals = np.cross(b - a, c - a)
        doubled = np.linalg.norm(normals, axis=1)
        expected = 0.5 * doubled / spacing**2
        counts = np.floor(expected + rng.uniform(size=len(expected))).astype(np.int64)
        owner = np.repeat(np.arange(len(counts)), counts)
        u, v = rng.uniform(size=(2, len(owner), 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        points = a[owner] + u * (b - a)[owner] + v * (c - a)[owner]
        return points, normals[owner] / doubled[owner, None]

    @property
    def _grid(self) -> tuple[FloatArray, _Index, _Index, FloatArray, _Index, float]:
        return self._triangles, self._starts, self._members, self._low, self._shape, self._cell

    def _fill_grid(self) -> tuple[_Index, _Index]:
        """List the triangles that may touch each cell, as starts and members."""
        first = ((self._triangles.min(axis=1) - self._low) / self._cell).astype(np.int64)
        last = ((self._triangles.max(axis=1) - self._low) / self._cell).astype(np.int64)
        return _bucket(first, last, self._shape)


@njit(nogil=True, cache=True)
def _bucket(first, last, shape):  # type: ignore[no-untyped-def]
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for sweep in range(2):
        if sweep == 1:
            starts = np.cumsum(starts)
            members = np.empty(starts[-1], np.int64)
            fill = starts[:-1].copy()
        for t in range(len(first)):
            for i in range(first[t, 0], last[t, 0] + 1):
                for j in range(first[t, 1], last[t, 1] + 1):
                    for k in range(first[t, 2], last[t, 2] + 1):
                        bucket = (i * shape[1] + j) * shape[2] + k
                        if sweep == 0:
                            starts[bucket + 1] += 1
                        else:
                            members[fill[bucket]] = t
                            fill[bucket] += 1
    return starts, members


@njit(nogil=True, cache=True)
def _closest(queries, triangles, starts, members, low, shape, cell):  # type: ignore[no-untyped-def]
    """Search shells of cells around each query until no farther shell can hold a nearer one."""
    nearest = np.full(queries.shape, np.nan)
    found = np.full(len(queries), -1, np.int64)
    center = np.empty(3, np.int64)
    best_point = np.empty(3)
    for n in range(len(queries)):
        query = queries[n]
        if not np.isfinite(query).all():
            continue
        for axis in range(3):
            index = np.floor((query[axis] - low[axis]) / cell)
            center[axis] = int(min(max(index, 0.0), shape[axis] - 1.0))
        best, chosen, shell = np.inf, -1, 0
        # A cell beyond shell s is at least s cells away from the query (or from its projection
        # onto the grid's box, which is nearer to all that the box holds).
        while shell == 0 or best > (shell - 1) * cell:
            best, chosen, inside = _search_shell(
                query, shell, center, triangles, starts, members, shape, best, chosen, best_point
            )
            if not inside:
                break
            shell += 1
        nearest[n] = best_point
        found[n] = chosen
    return nearest, found


@njit(nogil=True, cache=True)
def _search_shell(query, shell, center, triangles, starts, members, shape, best, chosen, nearest):  # type: ignore[no-untyped-def]
    """Look at the triangles of one cubic shell of cells; False when it is outside the grid."""
    inside = False
    for i in range(max(center[0] - shell, 0), min(center[0] + shell, shape[0] - 1) + 1):
        for j in range(max(center[1] - shell, 0), min(center[1] + shell, shape[1] - 1) + 1):
            rim = abs(i - center[0]) == shell or abs(j - center[1]) == shell
            step = 1 if rim or shell == 0 else 2 * shell
            for k in range(center[2] - shell, center[2] + shell + 1, step):
                if k < 0 or k >= shape[2]:
                    continue
                inside = True
                bucket = (i * shape[1] + j) * shape[2] + k
                for m in range(starts[bucket], starts[bucket + 1]):
                    s, t = _closest_on_triangle(query, triangles, members[m])
                    x, y, z = _on_triangle(triangles, members[m], s, t)
                    distance = np.sqrt(
                        (x - query[0]) ** 2 + (y - query[1]) ** 2 + (z - query[2]) ** 2
                    )
                    if distance < best:
                        best, chosen = distance, members[m]
                        nearest[0], nearest[1], nearest[2] = x, y, z
    return best, chosen, inside


@njit(nogil=True, cache=True)
def _on_triangle(triangles, t, v, w):  # type: ignore[no-untyped-def]
    """Point ``a + v (b - a) + w (c - a)`` of triangle t."""
    u = 1.0 - v - w
    x = u * triangles[t, 0, 0] + v * triangles[t, 1, 0] + w * triangles[t, 2, 0]
    y = u * triangles[t, 0, 1] + v * triangles[t, 1, 1] + w * triangles[t, 2, 1]
    z = u * triangles[t, 0, 2] + v * triangles[t, 1, 2] + w * triangles[t, 2, 2]
    return x, y, z


@njit(nogil=True, cache=True)
def _closest_on_triangle(p, triangles, t):  # type: ignore[no-untyped-def]
    """Coordinates (v, w) of the nearest point of triangle t.

    Regions of the three corners, the three edges and the face in turn: Ericson, Real-Time
    Collision Detection (2005), section 5.1.5.
    """
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for axis in range(3):
        a, b, c = triangles[t, 0, axis], triangles[t, 1, axis], triangles[t, 2, axis]
        d1 += (b - a) * (p[axis] - a)
        d2 += (c - a) * (p[axis] - a)
        d3 += (b - a) * (p[axis] - b)
        d4 += (c - a) * (p[axis] - b)
        d5 += (b - a) * (p[axis] - c)
        d6 += (c - a) * (p[axis] - c)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w
    return vb / (va + vb + vc), vc / (va + vb + vc)


_PARALLEL = 1e-14


@njit(nogil=True, cache=True)
def first_hits(origins, ends, triangles, starts, members, low, shape, cell):  # type: ignore[no-untyped-def]
    """Share of the segment from each origin to its end at which it meets a triangle; inf = never.

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
    origin, ray = np.empty(3), np.empty(3)
    for n in range(len(points)):
        asked = 0
        stride = 7919  # so that neighbors in the list, which see alike, are not asked in a row
        for m in range(len(cameras)):
            c = (m * stride + n) % len(cameras)
            squared = incidence = 0.0
            for axis in range(3):
                origin[axis] = points[n, axis] + lift * normals[n, axis]
                ray[axis] = cameras[c, axis] - origin[axis]
                squared += ray[axis] * ray[axis]
                incidence += ray[axis] * normals[n, axis]
            if squared > farthest * farthest or squared < nearest * nearest:
                continue
            distance = np.sqrt(squared)
            elevation = -ray[2] / distance
            if incidence < cosine * distance or elevation < lowest or elevation > highest:
                continue
            asked += 1
            if first_hit(origin, ray, triangles, starts, members, low, shape, cell) > 1.0:
                counts[n] += 1
            if counts[n] >= enough or asked >= tries:
                break
    return counts


@njit(nogil=True, cache=True)
def first_hit(origin, ray, triangles, starts, members, low, shape, cell):  # type: ignore[no-untyped-def]
    """As `first_hits` for one line from `origin` along `ray`, both of shape (3,)."""
    entry, leave = 0.0, 1.0
    for axis in range(3):
        first, last = low[axis], low[axis] + shape[axis] * cell
        if ray[axis] == 0.0:
            if origin[axis] < first or origin[axis] > last:
                return np.inf
            continue
        a, b = (first - origin[axis]) / ray[axis], (last - origin[axis]) / ray[axis]
        entry, leave = max(entry, min(a, b)), min(leave, max(a, b))
    if entry > leave:
        return np.inf
    index = np.empty(3, np.int64)
    step = np.zeros(3, np.int64)
    border, width = np.full(3, np.inf), np.full(3, np.inf)
    for axis in range(3):
        place = (origin[axis] + entry * ray[axis] - low[axis]) / cell
        index[axis] = min(max(int(np.floor(place)), 0), shape[axis] - 1)
        if ray[axis] != 0.0:
            step[axis] = 1 if ray[axis] > 0.0 else -1
            side = low[axis] + (index[axis] + (1 if ray[axis] > 0.0 else 0)) * cell
            border[axis] = (side - origin[axis]) / ray[axis]
            width[axis] = cell / abs(ray[axis])
    return _walk(origin, ray, leave, index, step, border, width, triangles, starts, members, shape)


@njit(nogil=True, cache=True)
def _walk(  # type: ignore[no-untyped-def]
    origin, ray, leave, index, step, border, width, triangles, starts, members, shape
):
    """Look at the triangles cell by cell until one is hit before its cell is left."""
    best = np.inf
    while True:
        bucket = (index[0] * shape[1] + index[1]) * shape[2] + index[2]
        for m in range(starts[bucket], starts[bucket + 1]):
            best = min(best, _cut(origin, ray, triangles, members[m]))
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
def _cut(origin, ray, triangles, t):  # type: ignore[no-untyped-def]
    """Share of the segment at which the line meets triangle t, from either side; inf = never."""
    ax, ay, az = triangles[t, 0]
    ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
    vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
    px, py, pz = ray[1] * vz - ray[2] * vy, ray[2] * vx - ray[0] * vz, ray[0] * vy - ray[1] * vx
    determinant = ux * px + uy * py + uz * pz
    if abs(determinant) < _PARALLEL:
        return np.inf
    inverse = 1.0 / determinant
    sx, sy, sz = origin[0] - ax, origin[1] - ay, origin[2] - az
    a = (sx * px + sy * py + sz * pz) * inverse
    if a < 0.0 or a > 1.0:
        return np.inf
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    b = (ray[0] * qx + ray[1] * qy + ray[2] * qz) * inverse
    if b < 0.0 or a + b > 1.0:
        return np.inf
    share = (vx * qx + vy * qy + vz * qz) * inverse
    return share if share >= 0.0 else np.inf
