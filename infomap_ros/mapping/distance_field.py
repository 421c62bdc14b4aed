"""Distance to the nearest obstacle, for every voxel of a box of the map.

The distance is exact and Euclidean: from the center of a voxel to the nearest point of the nearest
blocked voxel, a cube. Coordinates separate, so three passes of one-dimensional lower envelopes of
parabolas compute it in time linear in the number of voxels (Felzenszwalb and Huttenlocher 2012,
doi:10.4086/toc.2012.v008a019). In one dimension the cube of voxel j is nearest at one of its faces,
j - 1/2 or j + 1/2, so that the parabolas stand on the faces between voxels in place of the centers.

Two voxels that are blocked or not decide nothing about the space between their centers; distances
between cubes do, which is why `spheres_clear` is right for every sphere and not only on the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PlacedSolid, float_array, points_inside
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.field_kernels import (
    FAR,
    FieldArrays,
    fill_clear,
    fill_clearances,
    transform,
)
from infomap_ros.mapping.voxels.window import (
    OCCUPIED,
    UNCERTAIN,
    UNKNOWN,
    OccupancyThresholds,
    VoxelWindow,
)


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
    in_the_way: Sequence[PlacedSolid] = (),
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
        in_the_way: space that is blocked whatever was observed there, such as that which another
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
    _mark(blocked, window, in_the_way, True)
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
