"""Distance to the nearest obstacle, for every voxel of a box of the map.

The distance is exact and Euclidean: from the center of a voxel to the nearest point of the nearest
blocked voxel, a cube. Coordinates separate, so three passes of one-dimensional lower envelopes of
parabolas compute it in time linear in the number of voxels (Felzenszwalb and Huttenlocher 2012,
doi:10.4086/toc.2012.v008a019). In one dimension the cube of voxel j is nearest at one of its faces,
j - 1/2 or j + 1/2, so that the parabolas stand on the faces between voxels in place of the centers.

Two voxels that are blocked or not decide nothing about the space between their centers; distances
between cubes do, which is why `spheres_clear` is right for every sphere and not only on the grid.

Compiled kernels of `distance_field`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PlacedSolid, float_array, points_inside
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels.window import (
    OCCUPIED,
    UNCERTAIN,
    UNKNOWN,
    OccupancyThresholds,
    VoxelWindow,
)

FAR = 1e12
"""Square of the distance [voxels] of what is not there."""

_ROUNDING = 1e-5  # share by which a float32 distance and its use may be wrong, generously


class FieldArrays(NamedTuple):
    """A `DistanceField` as plain arrays, for kernels.

    Attributes:
        distances: float32, shape (nx, ny, nz) [m].
        first: voxel index of ``distances[0, 0, 0]``, shape (3,).
        voxel_size: [m].
        outside_is_free: whether nothing is in the way outside the box.
    """

    distances: NDArray[np.float32]
    first: NDArray[np.int64]
    voxel_size: float
    outside_is_free: bool


@njit(cache=True, nogil=True)
def transform(squares: Any, edge: Any) -> None:
    """Turn 0 where blocked and far elsewhere into squared distances [voxels], axis by axis.

    Lines along the first two axes are gathered for 16 neighbors along z at once, since a
    line of its own would use one number of every cache line that it touches.
    """
    nx, ny, nz = squares.shape
    longest = max(nx, ny, nz) + 1
    line, tops, standing, bounds = (
        np.empty(longest),
        np.empty(longest),
        np.empty(longest, np.int64),
        np.empty(longest + 1),
    )
    for i in range(nx):
        for j in range(ny):
            _one_line(squares[i, j], edge, line, tops, standing, bounds)
    gathered = np.empty((16, max(nx, ny)), np.float32)
    for i in range(nx):
        for k in range(0, nz, 16):
            _side_by_side(squares[i, :, k : k + 16], edge, gathered, line, tops, standing, bounds)
    for j in range(ny):
        for k in range(0, nz, 16):
            _side_by_side(squares[:, j, k : k + 16], edge, gathered, line, tops, standing, bounds)


@njit(cache=True, nogil=True)
def _side_by_side(
    lines: Any, edge: Any, gathered: Any, line: Any, tops: Any, standing: Any, bounds: Any
) -> None:
    """`_one_line` for the columns of a strip, shape (n, at most 16)."""
    n, width = lines.shape
    for i in range(n):
        for k in range(width):
            gathered[k, i] = lines[i, k]
    for k in range(width):
        _one_line(gathered[k, :n], edge, line, tops, standing, bounds)
    for i in range(n):
        for k in range(width):
            lines[i, k] = gathered[k, i]


@njit(cache=True, nogil=True)
def _one_line(values: Any, edge: Any, line: Any, tops: Any, standing: Any, bounds: Any) -> None:
    """Lower ``values[i]`` to the least of ``values[j] + (|i - j| - 1/2)^2`` over all j != i.

    Face m lies at m - 1/2, between voxels m - 1 and m, and has the lesser value of the two; beyond
    both ends is a voxel of value `edge`. The lower envelope of the parabolas that stand on the
    faces is built from left to right.

    Args:
        values: shape (n,), read and written.
        edge: value of the voxels beyond the ends.
        line: scratch for the values of the faces, at least n + 1 long.
        tops: scratch for the values of those in the envelope, at least n + 1 long.
        standing: scratch for their numbers, at least n + 1 long.
        bounds: scratch for where each begins, at least n + 2 long.
    """
    n = len(values)
    line[0], line[n] = min(edge, values[0]), min(edge, values[n - 1])
    lowest = min(line[0], line[n])
    for m in range(1, n):
        line[m] = min(values[m - 1], values[m])
        lowest = min(lowest, line[m])
    if lowest >= FAR:
        return
    last = -1
    for m in range(n + 1):
        if line[m] >= FAR:
            continue
        begin = -1.0
        while last >= 0:
            other = standing[last]
            begin = 0.5 * ((line[m] - tops[last]) / (m - other) + (m + other - 1))
            if begin > bounds[last]:
                break
            last -= 1
        if last < 0:
            begin = -1.0
        last += 1
        standing[last], tops[last], bounds[last] = m, line[m], begin
    bounds[last + 1] = math.inf
    at = 0
    for i in range(n):
        while bounds[at + 1] < i:
            at += 1
        offset = i - standing[at] + 0.5
        values[i] = min(values[i], tops[at] + offset * offset)


@njit(cache=True, nogil=True)
def clearance_bounds(
    distances: Any, first: Any, size: float, outside_is_free: bool, x: float, y: float, z: float
) -> tuple[float, float]:
    """Bounds between which the distance from a point to the nearest blocked voxel lies [m].

    It changes between two points by no more than they are apart, so its value at the center of
    the voxel that holds the point gives both. The first four arguments are those of `FieldArrays`.
    """
    nx, ny, nz = distances.shape
    u, v, w = x / size - first[0], y / size - first[1], z / size - first[2]
    a, b, c = min(max(u, 0.0), nx - 1e-9), min(max(v, 0.0), ny - 1e-9), min(max(w, 0.0), nz - 1e-9)
    beyond = abs(u - a) + abs(v - b) + abs(w - c)
    if beyond > 1e-6 and not outside_is_free:
        return 0.0, 0.0
    i, j, k = int(a), int(b), int(c)
    here = float(distances[i, j, k])
    if here == math.inf:
        return here, here
    if here == 0.0 and beyond <= 1e-6:
        return 0.0, 0.0
    du, dv, dw = a - i - 0.5, b - j - 0.5, c - k - 0.5
    off = size * math.sqrt(du * du + dv * dv + dw * dw)
    slack = _ROUNDING * (size + here)
    return max(here - off - slack, 0.0), here + off + size * beyond + slack


@njit(cache=True, nogil=True)
def _cube_square(x: float, y: float, z: float, i: int, j: int, k: int) -> float:
    """Squared distance from a point to the voxel (i, j, k), all in voxels."""
    dx, dy, dz = (
        max(i - x, x - i - 1.0, 0.0),
        max(j - y, y - j - 1.0, 0.0),
        max(k - z, z - k - 1.0, 0.0),
    )
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def nearest_blocked(
    distances: Any,
    first: Any,
    size: float,
    outside_is_free: bool,
    x: float,
    y: float,
    z: float,
    limit: float,
) -> float:
    """Exact distance from a point to the nearest blocked voxel, at most `limit` [m].

    Goes through the voxels within `limit` along z, and from each leaps over those that its own
    distance says are not blocked. The first four arguments are those of `FieldArrays`.
    """
    nx, ny, nz = distances.shape
    u, v, w = x / size - first[0], y / size - first[1], z / size - first[2]
    reach = limit / size
    best = reach * reach
    for i in range(math.floor(u - reach), math.floor(u + reach) + 1):
        for j in range(math.floor(v - reach), math.floor(v + reach) + 1):
            k, end = math.floor(w - reach), math.floor(w + reach)
            while k <= end:
                if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz):
                    if not outside_is_free:
                        best = min(best, _cube_square(u, v, w, i, j, k))
                    k += 1
                    continue
                here = distances[i, j, k] / size
                if here == 0.0:
                    best = min(best, _cube_square(u, v, w, i, j, k))
                    k += 1
                elif here < nz:
                    k += max(1, math.ceil(here + 0.5 - _ROUNDING * (1.0 + here)))
                else:
                    k = max(nz, k + 1)
    return size * math.sqrt(best)


@njit(cache=True, nogil=True)
def sphere_clear(
    distances: Any,
    first: Any,
    size: float,
    outside_is_free: bool,
    x: float,
    y: float,
    z: float,
    radius: float,
) -> bool:
    """Whether a sphere touches no blocked voxel.

    The bounds decide, or where they do not, the voxels around. The first four arguments are those
    of `FieldArrays`.
    """
    low, high = clearance_bounds(distances, first, size, outside_is_free, x, y, z)
    if low > radius:
        return True
    if high < radius:
        return False
    field = distances, first, size, outside_is_free
    return nearest_blocked(*field, x, y, z, radius * (1.0 + 1e-9)) >= radius


@njit(cache=True, nogil=True)
def fill_clear(
    distances: Any,
    first: Any,
    size: float,
    outside_is_free: bool,
    centers: Any,
    radii: Any,
    clear: Any,
) -> None:
    """`sphere_clear` for many spheres, shapes (N, 3) and (N,)."""
    field = distances, first, size, outside_is_free
    for n in range(len(centers)):
        x, y, z = centers[n, 0], centers[n, 1], centers[n, 2]
        clear[n] = sphere_clear(*field, x, y, z, radii[n])


@njit(cache=True, nogil=True)
def fill_clearances(
    distances: Any,
    first: Any,
    size: float,
    outside_is_free: bool,
    points: Any,
    limit: float,
    found: Any,
) -> None:
    """`nearest_blocked` for many points, shape (N, 3)."""
    field = distances, first, size, outside_is_free
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        low, high = clearance_bounds(*field, x, y, z)
        found[n] = limit
        if low < limit:
            found[n] = nearest_blocked(*field, x, y, z, min(high, limit))


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Distance to the nearest blocked voxel, for the voxels of a box.

    Attributes:
        distances: from each voxel's center to the nearest blocked voxel, 0 for a blocked voxel,
            infinite where nothing is blocked, float32, shape (nx, ny, nz) [m].
        first: voxel index of ``distances[0, 0, 0]``, shape (3,).
        voxel_size: edge of a voxel [m].
        outside_is_free: whether nothing is in the way outside the box; else all of it is blocked.
    """

    distances: NDArray[np.float32]
    first: NDArray[np.int64]
    voxel_size: float
    outside_is_free: bool = False

    @property
    def arrays(self) -> FieldArrays:
        """The same as plain arrays."""
        return FieldArrays(
            self.distances, self.first, float(self.voxel_size), bool(self.outside_is_free)
        )

    def clearances(self, points: ArrayLike, limit: float) -> FloatArray:
        """Exact distances from points to the nearest blocked voxel.

        Args:
            points: shape (N, 3) [m, map].
            limit: greatest distance that is looked for [m].

        Returns:
            Shape (N,) [m], 0 in a blocked voxel, `limit` where nothing is nearer.

        Raises:
            InvalidInputError: `points` has another shape.
        """
        rows = _points(points)
        found = np.empty(len(rows))
        fill_clearances(*self.arrays, rows, float(limit), found)
        return found

    def spheres_clear(self, centers: ArrayLike, radii: ArrayLike) -> NDArray[np.bool_]:
        """Which spheres touch no blocked voxel.

        Args:
            centers: shape (N, 3) [m, map].
            radii: one for all, or shape (N,) [m].

        Returns:
            Shape (N,); False for a sphere that leaves the box where outside is not free.

        Raises:
            InvalidInputError: `centers` has another shape.
        """
        rows = _points(centers)
        sizes = np.broadcast_to(float_array(radii, "radii"), len(rows))
        clear = np.empty(len(rows), np.bool_)
        fill_clear(*self.arrays, rows, np.ascontiguousarray(sizes), clear)
        return clear


def distance_field(
    window: VoxelWindow,
    *,
    thresholds: OccupancyThresholds | None = None,
    unknown_is_free: bool = False,
    doubtful_is_free: bool = False,
    known_free: Sequence[PlacedSolid] = (),
    own_points: ArrayLike = (),
    obstacles: Sequence[PlacedSolid] = (),
) -> DistanceField:
    """Distance to the nearest voxel that is not free.

    Voxels that are occupied or uncertain are blocked, and those never observed unless
    `unknown_is_free`.

    Args:
        window: voxels of the map.
        thresholds: when a voxel counts as free.
        unknown_is_free: voxels never observed, and all outside the window, are not in the way.
        doubtful_is_free: inside the window only occupied voxels are in the way.
        known_free: space that is known to be free although it was never seen, such as that which
            the robot's body fills [map]. Voxels whose centers lie in it are free unless the map
            says that they are occupied.
        own_points: points within the robot, shape (K, 3) [m, map]: the voxels that hold them are
            free whatever was observed there, as nothing else can be in that place.
        obstacles: space that is blocked whatever was observed there, such as that which another
            robot fills [map].

    Raises:
        InvalidInputError: `own_points` has another shape.
    """
    states = window.states(thresholds)
    doubtful = (states == UNCERTAIN) & (not doubtful_is_free)
    if not (unknown_is_free or doubtful_is_free):
        doubtful |= states == UNKNOWN
    if known_free and doubtful.any():
        _mark(doubtful, window, known_free, False)
    blocked = doubtful | (states == OCCUPIED)
    _mark(blocked, window, obstacles, True)
    points = float_array(own_points, "own_points")
    if points.size:
        places = window.positions_of(_points(points))
        blocked[tuple(places[window.contains(places)].T)] = False
    return field_of_blocked(blocked, window.first, window.voxel_size, unknown_is_free)


def field_of_blocked(
    blocked: NDArray[np.bool_], first: ArrayLike, voxel_size: float, outside_is_free: bool = False
) -> DistanceField:
    """Distance to the nearest blocked voxel of a box.

    Args:
        blocked: shape (nx, ny, nz).
        first: voxel index of ``blocked[0, 0, 0]``, shape (3,).
        voxel_size: [m].
        outside_is_free: whether nothing is in the way outside the box; else the voxels around it
            count as blocked.

    Raises:
        InvalidInputError: `blocked` is not an array of three axes with at least one voxel.
    """
    if blocked.ndim != 3 or blocked.size == 0:
        raise InvalidInputError("blocked", f"shape {blocked.shape}, expected (nx, ny, nz)")
    squares = np.where(blocked, np.float32(0.0), FAR)
    edge = FAR if outside_is_free else np.float32(0.0)
    transform(squares, edge)
    distances = np.sqrt(squares, out=squares)
    distances[distances >= 0.5 * np.sqrt(FAR)] = np.inf
    distances *= np.float32(voxel_size)
    index = np.asarray(first, dtype=np.int64).copy()
    return DistanceField(distances, index, voxel_size, outside_is_free)


def _points(points: ArrayLike) -> NDArray[np.float64]:
    rows = np.ascontiguousarray(float_array(points, "points"))
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InvalidInputError("points", f"shape {rows.shape}, expected (N, 3)")
    return rows


def _mark(
    voxels: NDArray[np.bool_], window: VoxelWindow, solids: Sequence[PlacedSolid], value: bool
) -> None:
    """Set the voxels whose centers lie in solids, and are not set so, to a value."""
    for solid in solids:
        middle, reach = solid.transform[:3, 3], solid.solid.bounding_radius
        low, high = window.positions_of([middle - reach, middle + reach])
        low, high = np.clip(low, 0, voxels.shape), np.clip(high + 1, 0, voxels.shape)
        box = voxels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        places = np.argwhere(box != value)
        if len(places):
            inside = points_inside(window.centers_of(places + low), [solid])
            box[tuple(places[inside].T)] = value
