"""The probabilistic voxel map."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CapacityError, ConfigError, InvalidInputError, MapFileError
from infomap_ros.geometry import (
    MotionClock,
    PinholeCamera,
    PoseUncertainty,
    check_transform,
    point_covariances,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import ray_casting
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM, VoxelMapConfig
from infomap_ros.mapping.files.map_file import read_map_file, write_map_file
from infomap_ros.mapping.scans import scan_input
from infomap_ros.mapping.scans.integration import IntegrationReport, ScanIntegrator
from infomap_ros.mapping.voxels import queries
from infomap_ros.mapping.voxels.changes import VoxelChanges, mark_changed, put_offset, take_changes
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, BLOCK_SIDE, unpack_all
from infomap_ros.mapping.voxels.state import MEMORY_ARRAY, storage_from_state, storage_state
from infomap_ros.mapping.voxels.storage import MapStorage
from infomap_ros.mapping.voxels.window import VoxelWindow, window_of

_ORIGIN_ARRAY, _SESSIONS_ARRAY = "origin", "sessions"  # in a map file


class DepthImage(NamedTuple):
    """Depth images of a map, shape (H, W) each; NaN where nothing is met.

    Attributes:
        depth: z in the optical frame, float32 [m].
        sigma: its standard deviation, without the error that the whole map shares, float32 [m].
    """

    depth: NDArray[np.float32]
    sigma: NDArray[np.float32]


class VoxelMap:
    """Sparse, unbounded map: occupancy everywhere it was looked, a Gaussian where a surface is.

    Voxel (i, j, k) is the cube from ``(i, j, k) * voxel_size`` to ``(i + 1, j + 1, k + 1) *
    voxel_size`` in the map frame [m]. Scans may come in any order: occupancy is the same to the
    bit, means of Gaussians within rounding; their covariances assume that clocks seldom go back.

    Attributes:
        origin: names the origin of the map frame, as in `PoseUncertainty`; 0 where not known.
        sessions: a number for each session whose scans are in the map, 64 bits of a hash of its
            first scan with a point; empty where not known.
    """

    def __init__(self, config: VoxelMapConfig | None = None) -> None:
        self.config = config or VoxelMapConfig()
        self._storage = MapStorage()
        self._clock = MotionClock()
        self._integrator = ScanIntegrator(self.config)
        self.origin = 0
        self.sessions: tuple[int, ...] = ()
        self._has_session = False

    def __repr__(self) -> str:
        size, known, surface = self.config.voxel_size, self.known_voxels, self.surface_voxels
        return f"VoxelMap(voxel_size={size:g}, {known} known voxels, {surface} on surfaces)"

    def integrate(
        self,
        points: ArrayLike,
        T_map_sensor: ArrayLike,
        covariances: ArrayLike | None = None,
        pose_covariance: ArrayLike | PoseUncertainty | None = None,
        camera: PinholeCamera | None = None,
        error_correlation: float | None = None,
    ) -> IntegrationReport:
        """Add one scan.

        Args:
            points: shape (N, 3), or organized (H, W, 3), sensor frame [m]; NaN = no measurement.
            T_map_sensor: pose of the sensor (with a camera: of its optical frame), shape (4, 4).
            covariances: shape (..., 3, 3), or (..., 6) as (xx, xy, xz, yy, yz, zz), of the points
                in the sensor frame [m^2]. Without it every point has ``default_sigma``.
            pose_covariance: of the pose in its parts, see `pose_uncertainty`.
            camera: the camera whose pixels the points are. Free space is then found by projecting
                voxels into the image; without it by traversing the rays.
            error_correlation: of the range errors of neighboring points, in [0, 1]; replaces the
                configuration's value.

        Returns:
            What became of the points.

        Raises:
            InvalidInputError: an argument has a wrong shape or impossible content.
            CapacityError: the map would exceed ``memory_limit``, or the machine has no memory left;
                the map can be used and saved.
        """
        config = self.config
        correlation = config.error_correlation if error_correlation is None else error_correlation
        if not 0.0 <= correlation <= 1.0:
            raise InvalidInputError("error_correlation", f"is {correlation}, expected 0 to 1")
        known = self.pose_uncertainty(pose_covariance, T_map_sensor)
        given = points, T_map_sensor, covariances, known, camera
        scan = scan_input.checked_scan(*given, config.default_sigma)
        scan_input.check_within_limits(scan.transform, config.voxel_size)
        try:
            report = self._integrator.integrate(self._storage, scan, correlation)
        except CapacityError:
            raise
        except MemoryError as error:
            raise CapacityError("the machine has no memory left for a scan") from error
        if isinstance(pose_covariance, PoseUncertainty):
            put_offset(self._storage, pose_covariance.offset_at_origin(scan.transform[:3, 3]))
        if report.points_used and not self._has_session:
            self._has_session = True
            self.sessions = tuple(sorted({*self.sessions, _session_of(scan.points)}))
        return report

    def pose_uncertainty(
        self, pose_covariance: ArrayLike | PoseUncertainty | None, T_map_sensor: ArrayLike
    ) -> PoseUncertainty | None:
        """What `integrate` takes a pose's covariance for.

        One that does not come in parts, shape (6, 6), is drift by the clock of the motion.

        Raises:
            InvalidInputError: the pose or its covariance is none.
        """
        if pose_covariance is None or isinstance(pose_covariance, PoseUncertainty):
            return pose_covariance
        return self._clock.uncertainty(pose_covariance, T_map_sensor)

    def log_odds(self, points: ArrayLike) -> FloatArray:
        """Occupancy evidence at points, shape (N, 3) [m] -> (N,) [nats], 0 where unknown."""
        return np.asarray(self._quanta(points)[1] * LOG_ODDS_QUANTUM, dtype=np.float64)

    def probability(self, points: ArrayLike) -> FloatArray:
        """Probability of occupancy at points, shape (N, 3) [m] -> (N,), 0.5 where unknown."""
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(self.log_odds(points), -700.0, 700.0))))

    def is_known(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether the voxels at points, shape (N, 3) [m], were ever observed, shape (N,)."""
        return self._quanta(points)[0]

    def gaussians(self, relative: bool = False) -> tuple[NDArray[np.int32], FloatArray, FloatArray]:
        """Surface voxels.

        Args:
            relative: leave out the error that the whole map shares.

        Returns:
            Voxel indices (K, 3), means (K, 3) [m] and covariances (K, 3, 3) [m^2] in the map
            frame. The covariance says where the surface lies along its normal, and across it that
            the point may be anywhere in the voxel.
        """
        count = self.surface_voxels
        indices = np.empty((count, 3), np.int32)
        means, covariances = np.empty((count, 3)), np.empty((count, 3, 3))
        blocks, gaussians = self._storage.blocks, self._storage.gaussians
        queries.list_surface(blocks, gaussians, self.config.voxel_size, indices, means, covariances)
        if not relative and self.offset.any():
            covariances += point_covariances(self.offset, means)
        return indices, means, covariances

    @property
    def offset(self) -> FloatArray:
        """Covariance of the error that the whole map shares, at its origin, shape (6, 6)."""
        return self._storage.offset.copy()

    def voxels(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """All known voxels: indices (K, 3) and log-odds (K,) [nats]."""
        count = self.known_voxels
        indices, quanta = np.empty((count, 3), np.int32), np.empty(count, np.int32)
        queries.list_known(self._storage.blocks, indices, quanta)
        return indices, quanta.astype(np.float32) * np.float32(LOG_ODDS_QUANTUM)

    def window(self, low: ArrayLike, high: ArrayLike) -> VoxelWindow:
        """Dense copy of the voxels that the box from `low` to `high`, shape (3,) [m], touches.

        Raises:
            InvalidInputError: it is not a box, or too large for an array.
        """
        return window_of(self._storage.blocks, self.config.voxel_size, low, high)

    def cast_rays(
        self, origins: ArrayLike, directions: ArrayLike, max_range: float
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Cast rays until they meet the surface; see `surface_along`.

        Returns:
            Distance at which each ray meets the surface, `max_range` where it meets none, shape
            (N,) [m]; and whether it met one, shape (N,).
        """
        distances, _ = self.surface_along(origins, directions, max_range)
        hits = np.isfinite(distances)
        return np.where(hits, distances, max_range), hits

    def surface_along(
        self, origins: ArrayLike, directions: ArrayLike, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Where rays meet the surface, as the Gaussians tell it (`mapping.ray_casting`).

        An occupied voxel without a Gaussian stops rays where they enter it, as in a map of
        occupancy alone, unless there is a surface in a voxel beside it.

        Args:
            origins: shape (N, 3) or (3,) for all rays, map frame [m].
            directions: shape (N, 3), of any length but zero.
            max_range: [m].

        Returns:
            Distances and their standard deviations, without the error that the whole map shares,
            shape (N,) each [m]; NaN where a ray is more likely to meet nothing.

        Raises:
            InvalidInputError: shapes do not fit, values are not finite, a direction is zero, or a
                ray leaves the coordinate limits.
        """
        size = self.config.voxel_size
        starts, rays = scan_input.checked_rays(origins, directions, max_range, size)
        distances, sigmas = np.empty(len(rays)), np.empty(len(rays))
        arrays = self._storage.blocks, self._storage.gaussians
        found = distances, sigmas
        limits = float(max_range), size
        ray_casting.cast_to_surface(*arrays, starts, rays, *limits, *ray_casting.scratch(), *found)
        return distances, sigmas

    def render_depth(
        self, camera: PinholeCamera, T_map_camera: ArrayLike, max_range: float | None = None
    ) -> DepthImage:
        """What a depth camera would see of the map.

        Args:
            camera: the camera.
            T_map_camera: pose of its optical frame, shape (4, 4).
            max_range: surfaces farther than this from the camera are not seen [m]; without it that
                of the configuration.

        Raises:
            InvalidInputError: the pose is none, or leaves the coordinate limits.
        """
        pose = check_transform(T_map_camera, "T_map_camera")
        pixels = camera.back_project(np.ones((camera.height, camera.width))).astype(np.float64)
        rays = pixels.reshape(-1, 3) @ pose[:3, :3].T
        reach = self.config.max_range if max_range is None else max_range
        found = self.surface_along(pose[:3, 3], rays, reach)
        per_depth = np.linalg.norm(pixels, axis=2)
        depth, sigma = (each.reshape(per_depth.shape) / per_depth for each in found)
        return DepthImage(depth.astype(np.float32), sigma.astype(np.float32))

    def first_occupied(
        self, origins: ArrayLike, directions: ArrayLike, max_range: float
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Where rays enter the first occupied voxel (p > 0.5); arguments as of `surface_along`.

        Returns:
            Distances, `max_range` where a ray enters none, shape (N,) [m]; and whether it entered
            one, shape (N,).
        """
        size = self.config.voxel_size
        starts, rays = scan_input.checked_rays(origins, directions, max_range, size)
        distances, hits = np.empty(len(rays)), np.empty(len(rays), np.bool_)
        limits = float(max_range), 1.0 / size
        ray_casting.cast_to_voxels(self._storage.blocks, starts, rays, *limits, distances, hits)
        return distances, hits

    def entropy_bits(self, region: ArrayLike | None = None) -> float:
        """Sum of the voxels' entropies [bits] (eq. 5 of Sujan and Dubowsky 2005, per voxel).

        Args:
            region: box (low, high), shape (2, 3), map frame [m]: the voxels with their center in
                it, an unknown one counting 1 bit. Without it all known voxels.

        Raises:
            InvalidInputError: the region is not a box.
        """
        if region is None:
            low, high = np.full(3, -(2**40)), np.full(3, 2**40)
            blocks = self._storage.blocks
            return float(queries.total_entropy(blocks, LOG_ODDS_QUANTUM, low, high)[0])
        box = scan_input.checked_box(region, "region")
        low, high = np.ceil(box / self.config.voxel_size - 0.5).astype(np.int64)
        known_bits, known = queries.total_entropy(self._storage.blocks, LOG_ODDS_QUANTUM, low, high)
        return float(known_bits) + float(np.prod((high - low).astype(float))) - float(known)

    def memory_bytes(self) -> int:
        """Memory in use by the map [bytes]; scratch memory of `integrate` not included."""
        return self._storage.memory_bytes()

    @property
    def known_voxels(self) -> int:
        """Number of voxels that were ever observed."""
        return int(queries.count_known(self._storage.blocks))

    @property
    def surface_voxels(self) -> int:
        """Number of voxels that `gaussians` returns."""
        nothing = np.empty((0, 3), np.int32), np.empty((0, 3)), np.empty((0, 3, 3))
        blocks, gaussians = self._storage.blocks, self._storage.gaussians
        return int(queries.list_surface(blocks, gaussians, self.config.voxel_size, *nothing))

    def bounds(self) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """Smallest and largest voxel index of the blocks in use, shape (3,) each; None if empty."""
        count = int(self._storage.blocks.counts[BLOCK_COUNT])
        if count == 0:
            return None
        coordinates = unpack_all(self._storage.blocks.keys[:count])
        low = coordinates.min(axis=0) * BLOCK_SIDE
        return low, (coordinates.max(axis=0) + 1) * BLOCK_SIDE - 1

    def track_changes(self, enabled: bool) -> None:
        """Keep one more bit per voxel, so that `take_changes` knows what changed from now on."""
        blocks = self._storage.blocks
        rows = max(1, len(blocks.keys)) if enabled else 0
        self._storage.blocks = blocks._replace(dirty=np.zeros((rows, 8), np.uint64))

    def take_changes(self, limit: int = 1 << 20) -> VoxelChanges:
        """Up to `limit` voxels that changed and were not yet taken; others stay for the next call.

        A voxel has changed when its clipped evidence or its Gaussian has.

        Raises:
            InvalidInputError: changes are not tracked.
        """
        return take_changes(self._storage, self.config.voxel_size, limit)

    def mark_changed(self, first: int, blocks: int) -> int:
        """Count all voxels of some blocks as changed, for someone who does not know them.

        Args:
            first: number of the first block; blocks are numbered from 0 in the order in which
                they were first observed.
            blocks: how many.

        Returns:
            Number of blocks after them.

        Raises:
            InvalidInputError: changes are not tracked.
        """
        return mark_changed(self._storage, first, blocks)

    def reset(self) -> None:
        """Forget everything."""
        tracked = len(self._storage.blocks.dirty) > 0
        self._storage, self._clock = MapStorage(), MotionClock()
        self.sessions, self._has_session = (), False
        if tracked:
            self.track_changes(True)

    def state(self) -> dict[str, NDArray[Any]]:
        """The whole map as named arrays, for a map file."""
        return storage_state(self._storage)

    @classmethod
    def from_state(cls, config: VoxelMapConfig, state: Mapping[str, NDArray[Any]]) -> VoxelMap:
        """Rebuild a map from `state`.

        Raises:
            MapFileError: the arrays contradict each other.
        """
        restored = cls(config)
        restored._storage = storage_from_state(state)
        return restored

    def save(self, path: str | Path) -> None:
        """Write the map to one file, atomically. Scans that come later share no errors with it."""
        state = {name: array for name, array in self.state().items() if name != MEMORY_ARRAY}
        state[_ORIGIN_ARRAY] = np.array(self.origin, np.uint32)
        state[_SESSIONS_ARRAY] = np.array(self.sessions, np.uint64)
        write_map_file(Path(path), dataclasses.asdict(self.config), state)

    @classmethod
    def load(cls, path: str | Path) -> VoxelMap:
        """Read a map that `save` wrote.

        Raises:
            MapFileError: the file is missing, truncated, corrupt, or of an unknown version.
        """
        parameters, state = read_map_file(Path(path))
        try:
            config = VoxelMapConfig(**parameters)
        except (TypeError, ConfigError) as error:
            raise MapFileError(f"{path}: its configuration is not valid: {error}") from error
        loaded = cls.from_state(config, state)
        loaded.origin = int(state.get(_ORIGIN_ARRAY, np.zeros(())).max(initial=0))
        loaded.sessions = tuple(state.get(_SESSIONS_ARRAY, np.zeros(0, np.uint64)).ravel().tolist())
        return loaded

    def _quanta(self, points: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        places = scan_input.checked_points(points, "points")
        known, quanta = np.empty(len(places), np.bool_), np.empty(len(places), np.int32)
        scale = 1.0 / self.config.voxel_size
        queries.quanta_at_points(self._storage.blocks, places, scale, known, quanta)
        return known, quanta


def _session_of(points: NDArray[np.float32]) -> int:
    """Names a session by the points of its first scan: a bag that is mapped again has the same."""
    digest = hashlib.blake2b(np.ascontiguousarray(points).tobytes(), digest_size=8)
    return int.from_bytes(digest.digest(), "little")
