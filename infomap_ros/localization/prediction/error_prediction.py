"""How well the camera's pose will be known at the end of paths not yet gone: LE of eq. (11).

Along a path the pose errors grow as odometry drifts, and fiducials that are in sight hold them:
those whose place is known tie the pose to the map, others tie the poses of the path to each other
(visual odometry). Sujan and Dubowsky 2005, eq. (11) and sec. 2.5, doi:10.1177/0278364905051774.

What a prediction of pose errors starts from: paths, and what is known of the fiducials.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import StereoRig, check_covariance, check_transform, float_array
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.prediction import kernels
from infomap_ros.mapping import VoxelMap

FLOOR = 1e-8
"""Smallest variance: (0.1 mm)^2, (0.1 mrad)^2."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths whose ends are judged; what is seen from them is as if they were straight.

    Attributes:
        ends: ``T_map_camera`` at the ends, shape (M, 4, 4).
        lengths: shape (M,) [m]; drift follows them.

    Raises:
        InvalidInputError: shapes do not fit.
    """

    ends: FloatArray
    lengths: FloatArray

    def __post_init__(self) -> None:
        ends, lengths = float_array(self.ends, "ends"), float_array(self.lengths, "lengths")
        if lengths.ndim != 1 or ends.shape != (len(lengths), 4, 4):
            raise InvalidInputError("paths", f"ends {ends.shape} with lengths {lengths.shape}")
        object.__setattr__(self, "ends", ends)
        object.__setattr__(self, "lengths", lengths)


def checked_points(positions: ArrayLike, covariances: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Fiducials' positions (N, 3) and covariances (N, 3, 3) as arrays.

    Raises:
        InvalidInputError: shapes do not fit, or a number is not finite.
    """
    points = float_array(positions, "fiducial positions").reshape(-1, 3)
    spreads = float_array(covariances, "fiducial covariances").reshape(-1, 3, 3)
    if len(points) != len(spreads):
        raise InvalidInputError("fiducials", f"{len(points)} positions, {len(spreads)} covariances")
    if not (np.isfinite(points).all() and np.isfinite(spreads).all()):
        raise InvalidInputError("fiducials", "hold NaN or infinity")
    return points, spreads


def shared_variance(before: FloatArray, spreads: FloatArray) -> float:
    """Variance of position that pose and fiducials have in common, at most [m^2].

    Both were estimated together, so a shift of the whole map is an error of all of them, which no
    sighting of them makes smaller: the smallest variance of any in any direction stands for it.
    """
    blocks = np.concatenate([before[None, :3, :3], spreads])
    return max(0.0, float(np.linalg.eigvalsh(blocks)[:, 0].min()))


def own_informations(spreads: FloatArray, shared: float) -> FloatArray:
    """Inverse of what each fiducial's covariance (N, 3, 3) holds beyond the shared variance."""
    own = spreads - shared * np.eye(3) + FLOOR * np.eye(3)
    return np.asarray(np.linalg.inv(own)) if len(own) else spreads


# Fiducials where nothing is known yet: a camera that looks there will find some.
#
# What it will find is taken to be like what it knows: the known fiducials about a place, turned
# about the vertical, stand for those in directions that nobody has looked at. Where the map knows
# that there is nothing, or what there is, none are assumed.

_TURNS = 6  # of the known fiducials about the vertical


def unseen_points(
    place: FloatArray, known: FloatArray, voxel_map: VoxelMap, reach: float, count: int
) -> FloatArray:
    """Points that stand for the fiducials of unknown space about a place.

    Args:
        place: shape (3,) [m, map].
        known: positions of the known fiducials, shape (N, 3) [m, map].
        voxel_map: whose unknown voxels count.
        reach: fiducials farther away tell nothing of this place [m].
        count: at most so many.

    Returns:
        Shape (P, 3) [m, map].
    """
    around = known - place
    around = around[np.linalg.norm(around, axis=1) < reach]
    if not len(around) or not count:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)  # any will do; the same map gives the same ones
    some = around[rng.choice(len(around), min(len(around), max(count // _TURNS, 1)), replace=False)]
    angles = 2.0 * np.pi * (np.arange(_TURNS)[:, None] + rng.random(len(some))) / _TURNS
    turned = Rotation.from_rotvec(np.outer(angles.ravel(), [0.0, 0.0, 1.0]))
    points = place + turned.apply(np.tile(some, (_TURNS, 1)))
    is_unknown: NDArray[np.bool_] = ~voxel_map.is_known(points)
    return np.asarray(points[is_unknown])


@dataclass(frozen=True)
class ErrorPredictionConfig:
    """How paths and sightings are modeled.

    Raises:
        ConfigError: a value is out of its range.
    """

    waypoints: int = setting(
        5,
        "Camera poses on a path from which fiducials are looked at, its end included.",
        low=1,
        high=50,
    )
    fiducials: int = setting(
        60,
        "Of the known fiducials, so many are looked at; where there are more, each stands for "
        "several.",
        low=1,
        high=10_000,
    )

    def __post_init__(self) -> None:
        check_config(self)


__all__ = ["ErrorPrediction", "ErrorPredictionConfig"]

_FLOOR = FLOOR * np.eye(6)
_NEAREST = 0.3
"""Smallest depth at which a fiducial is measured [m]."""
_FARTHEST = 6.0
"""Largest depth at which a fiducial is tracked [m]."""
PIXEL_SIGMA = 0.5
"""Standard deviation of a tracked pixel [px]."""
_DISPARITY_SIGMA = 0.3
"""Standard deviation of a fiducial's disparity [px]."""
_SURFACE_POINTS = 40
"""So many points of the mapped surface stand for fiducials that will be found on the way."""
_UNSEEN_POINTS = 120
"""At most so many points stand for fiducials in unknown space: those that are known, turned about
the vertical."""
_BORDER = 10.0
"""So near to the edge of the image nothing is tracked: half a template [px]."""
_TOLERANCE = 6.0
"""A ray may end so far before a fiducial: along flat lines of sight it meets the voxels of the
fiducial's own surface early [voxels]."""
_CELL = 0.5
"""What hides a fiducial from a place hides it from all places in a cube of this size [m]."""


class ErrorPrediction:
    """Predicts pose covariances at the ends of paths, for many paths at once.

    Args:
        rig: the rectified stereo pair.
        config: of paths and sightings.
        motion: how far odometry and kinematics are trusted, as by the localizer.
    """

    def __init__(
        self,
        rig: StereoRig,
        config: ErrorPredictionConfig | None = None,
        motion: DeadReckoningConfig | None = None,
    ) -> None:
        self.config = config or ErrorPredictionConfig()
        self._motion = motion or DeadReckoningConfig()
        camera = rig.left
        size = (float(camera.width), float(camera.height))
        self._camera = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *size, _BORDER])
        pixel = PIXEL_SIGMA**-2
        inverse_depth = (camera.fx * rig.baseline / _DISPARITY_SIGMA) ** 2
        self._precisions = np.array([pixel, pixel, inverse_depth])

    def surface_points(self, voxel_map: VoxelMap) -> FloatArray:
        """Points of the mapped surface that stand for fiducials still to be found, (S, 3) [m]."""
        indices, means, _ = voxel_map.gaussians()
        means = means[np.lexsort(indices.T)]  # maps store the same voxels in different orders
        rng = np.random.default_rng(0)  # any points will do; the same map gives the same ones
        count = min(_SURFACE_POINTS, len(means))
        return np.asarray(means[rng.choice(len(means), count, replace=False)])

    def new_points(
        self, T_map_camera: FloatArray, known: FloatArray, voxel_map: VoxelMap
    ) -> FloatArray:
        """Places of fiducials still to be found, on the mapped surface and in unknown space.

        Args:
            T_map_camera: where the camera is, shape (4, 4).
            known: positions of the known fiducials, shape (N, 3) [m, map].
            voxel_map: what is known.

        Returns:
            Shape (S, 3) [m, map].
        """
        place = T_map_camera[:3, 3]
        unseen = unseen_points(place, known, voxel_map, _FARTHEST, _UNSEEN_POINTS)
        return np.concatenate([self.surface_points(voxel_map), unseen])

    def predict(
        self,
        T_map_camera: ArrayLike,
        covariance: ArrayLike,
        paths: Paths,
        fiducials: tuple[ArrayLike, ArrayLike],
        new_points: ArrayLike = (),
        voxel_map: VoxelMap | None = None,
    ) -> FloatArray:
        """Covariances of the camera's pose at the ends of paths.

        Args:
            T_map_camera: where the paths begin, shape (4, 4).
            covariance: of that pose, shape (6, 6), convention of `geometry.transforms`.
            paths: where they end.
            fiducials: positions of the known ones, shape (N, 3) [m, map], and their covariances,
                shape (N, 3, 3) [m^2].
            new_points: places of fiducials of which nothing is known yet, shape (S, 3) [m, map];
                see `new_points`.
            voxel_map: hides what is behind a surface.

        Returns:
            Shape (M, 6, 6).

        Raises:
            InvalidInputError: shapes do not fit, or a transform or covariance is impossible.
        """
        start, before = check_transform(T_map_camera), check_covariance(covariance, 6)
        known, spreads, share = _thinned(*checked_points(*fiducials), self.config.fiducials)
        new = float_array(new_points, "new_points").reshape(-1, 3)
        points = np.concatenate([known, new])
        shared = shared_variance(before, spreads)
        informations = np.zeros((len(points), 3, 3))
        informations[: len(known)] = own_informations(spreads, shared) / share
        before[:3, :3] -= shared * np.eye(3)
        centers, rotations, turns = self._waypoints(start, paths.ends)
        chain = self._chain(before, centers, paths.lengths, turns)
        sight = self._sight(centers, rotations, points, voxel_map)
        sight[:, 0, : len(known)] = False  # what the start tells of them is in the covariances
        weights = np.ones(len(points))
        weights[: len(known)] = 1.0 / share
        landmarks = points, informations, weights, sight
        after = self._at_the_ends(chain, centers, rotations, landmarks)
        after[:, :3, :3] += shared * np.eye(3)
        return after

    def _waypoints(
        self, start: FloatArray, ends: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Places on straight paths, the start first: centers, rotations; and whole turns (M,).

        Shapes (M, K, 3), (M, K, 3, 3), (M,), K one more than the waypoints.
        """
        shares = np.arange(self.config.waypoints + 1) / self.config.waypoints
        offsets = ends[:, :3, 3] - start[:3, 3]
        centers = start[:3, 3] + shares[:, None] * offsets[:, None]
        turns = Rotation.from_matrix(ends[:, :3, :3] @ start[:3, :3].T).as_rotvec().reshape(-1, 3)
        partial = Rotation.from_rotvec((shares[:, None] * turns[:, None]).reshape(-1, 3))
        rotations = partial.as_matrix() @ start[:3, :3]
        shape = (len(ends), len(shares), 3, 3)
        return centers, rotations.reshape(shape), np.linalg.norm(turns, axis=1)

    def _chain(
        self, before: FloatArray, centers: FloatArray, lengths: FloatArray, turns: FloatArray
    ) -> FloatArray:
        """Information of the poses of the path from the start and odometry, (M, 6 K, 6 K)."""
        count, places, _ = centers.shape
        motion, steps = self._motion, places - 1
        position = motion.position_per_meter**2 * lengths / steps
        turning = motion.rotation_per_meter**2 * lengths + motion.rotation_per_radian**2 * turns
        noise = np.repeat(np.stack([position, turning / steps], axis=1), 3, axis=1)
        precision = np.linalg.inv(noise[:, :, None] * np.eye(6) + _FLOOR)
        over = np.tile(np.eye(6), (count, 1, 1))
        over[:, :3, 3:] = -_skews(centers[:, 1] - centers[:, 0])  # all steps of a path are alike
        back = precision @ over
        chain = np.zeros((count, places, 6, places, 6))
        chain[:, 0, :, 0] = np.linalg.inv(before + _FLOOR)
        for k in range(1, places):
            chain[:, k, :, k] += precision
            chain[:, k - 1, :, k - 1] += over.transpose(0, 2, 1) @ back
            chain[:, k, :, k - 1] -= back
            chain[:, k - 1, :, k] -= back.transpose(0, 2, 1)
        return chain.reshape(count, 6 * places, 6 * places)

    def _sight(
        self,
        centers: FloatArray,
        rotations: FloatArray,
        points: FloatArray,
        voxel_map: VoxelMap | None,
    ) -> NDArray[np.bool_]:
        """Which points are seen from which waypoints, shape (M, K, N)."""
        sight = np.empty((*centers.shape[:2], len(points)), np.bool_)
        limits = np.array([_NEAREST, _FARTHEST])
        kernels.in_view(centers, rotations, points, self._camera, limits, sight)
        if voxel_map is None or not sight.any():
            return sight
        cells, index = np.unique(
            np.floor(centers.reshape(-1, 3) / _CELL).astype(np.int64),
            axis=0,
            return_inverse=True,
        )
        of_cell = np.zeros((len(cells), len(points)), np.bool_)
        np.logical_or.at(of_cell, np.ravel(index), sight.reshape(-1, len(points)))
        origins = np.empty((len(cells), 3))
        origins[np.ravel(index)] = centers.reshape(-1, 3)  # any place in the cell
        _hide(of_cell, origins, points, voxel_map)
        sight &= of_cell[np.ravel(index)].reshape(sight.shape)
        return sight

    def _at_the_ends(
        self,
        chain: FloatArray,
        centers: FloatArray,
        rotations: FloatArray,
        landmarks: tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]],
    ) -> FloatArray:
        """What is left of the poses when all but the last are eliminated, shape (M, 6, 6)."""
        information = np.empty((len(chain), 6, 6))
        kernels.end_information(
            chain, centers, rotations, *landmarks, self._camera, self._precisions, information
        )
        return np.asarray(np.linalg.inv(0.5 * (information + information.transpose(0, 2, 1))))


def _hide(
    sight: NDArray[np.bool_],
    origins: FloatArray,
    points: FloatArray,
    voxel_map: VoxelMap,
) -> None:
    """Clear what the map hides: of points (N, 3) from origins (C, 3), in `sight` (C, N)."""
    place, point = np.nonzero(sight)
    rays = points[point] - origins[place]
    distances = np.linalg.norm(rays, axis=1)
    reached, _ = voxel_map.first_occupied(origins[place], rays, float(distances.max()))
    sight[place, point] = reached >= distances - _TOLERANCE * voxel_map.config.voxel_size


def _thinned(
    positions: FloatArray, covariances: FloatArray, most: int
) -> tuple[FloatArray, FloatArray, float]:
    """At most so many of the fiducials, and which share of all they are."""
    count = len(positions)
    if count <= most:
        return positions, covariances, 1.0
    chosen = np.random.default_rng(0).choice(count, most, replace=False)  # any will do
    return positions[chosen], covariances[chosen], most / count


def _skews(vectors: FloatArray) -> FloatArray:
    """Cross-product matrices, (M, 3) -> (M, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
