"""Views that close the holes of the mapped surface, when the volume calls for none any more.

The information of eq. (11) counts what views tell about volume. A strip of floor behind a table, or
the underside of its top, is a sheet one voxel thick: a hundredth of what a view into open unknown
space tells, and not worth a meter of way by that measure, while the task asks for surface. Here a
view counts the voxels of missing surface that it is expected to show, and a full view is one that
shows nothing but missing surface from half the camera's range.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.exploration.surface.missing_surface import MissingSurface, missing_surface
from infomap_ros.exploration.surface.surface_sight import sight_weights, sums_in_view
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.observation_value import observed_share
from infomap_ros.views.information.voxel_gains import VoxelGains
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_STEEPEST = 1.2  # [rad] between line of sight and normal
_STEP = 0.5  # [voxels] of the table of what is told from a distance
_PROPOSED = 600  # views that are proposed
_NEAREST, _FARTHEST = 0.5, 2.2  # [m] from which they look
_CONE = 0.9  # [rad] about the normal within which they stand
_WELL_SEEN = 0.3  # least weight of a look that counts when it was in vain
_ELEVATION = 1.2  # [rad], steepest glance of theirs


class SurfaceCompletion:
    """What views show of the missing surface, and views that would show much of it.

    Implements `views.options.InformationSource`, `views.strategy.Strategy` and `ProposesViews`.

    Args:
        sensor: what the camera tells from afar.
        look_limit: a voxel that is still missing after so many looks from next to it, squarely, is
            given up; a look from some way off or askance counts less, one from afar nothing. Each
            look in vain takes its share of the hope that the next one shows the voxel.
    """

    unit = "voxels of missing surface"
    requires_positive_utility = True

    def __init__(self, sensor: InformationConfig, look_limit: float) -> None:
        self.config, self._look_limit = sensor, look_limit
        odds = sensor.hiding_probability / (1.0 - sensor.hiding_probability)
        self._hiding = float(np.log(odds)) / LOG_ODDS_QUANTUM
        self._looks: dict[int, float] = {}
        self._noted = 0  # so many of the views taken have been counted
        self._missing = MissingSurface(
            np.empty((0, 3), np.int64), np.empty((0, 3)), np.empty((0, 3))
        )
        self._hopes = np.empty(0)  # that a look shows what is missing, 0 to 1

    def prepare(self, situation: Situation) -> int:
        """Find what is missing; returns how much of it is not given up.

        What the views that were taken have in sight was looked at in vain.
        """
        region = np.stack([situation.region.low, situation.region.high])
        missing = missing_surface(situation.voxel_map, region, situation.position)
        keys = pack_all(missing.voxels)
        self._missing, self._hopes = missing, np.ones(len(missing))
        for seen in self._in_view(situation, situation.past_views[self._noted :]):
            for at in np.flatnonzero(seen >= _WELL_SEEN):
                self._looks[int(keys[at])] = self._looks.get(int(keys[at]), 0.0) + seen[at]
        self._noted = len(situation.past_views)
        hopes = 1.0 - np.array([self._looks.get(int(key), 0.0) for key in keys]) / self._look_limit
        rest = hopes > 0.0
        self._hopes = hopes[rest]
        self._missing = MissingSurface(
            missing.voxels[rest], missing.places[rest], missing.normals[rest]
        )
        return len(self._missing)

    def quick(
        self, situation: Situation, positions: FloatArray, rotations: FloatArray
    ) -> FloatArray:
        """Of all orientations (P, O, 3, 3) at positions (P, 3): (P, O)."""
        sums = np.zeros(rotations.shape[:2])
        weights = self._weights(situation, positions)
        sums_in_view(
            np.ascontiguousarray(positions),
            np.ascontiguousarray(rotations),
            self._missing.places,
            weights,
            _lens(situation),
            sums,
        )
        return sums

    def exact(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """Of views ``T_map_camera``, shape (M, 4, 4): (M,)."""
        return self.quick(situation, poses[:, :3, 3], poses[:, None, :3, :3])[:, 0]

    def gains(self, situation: Situation, poses: FloatArray) -> list[VoxelGains]:
        """Missing voxels that each view, (M, 4, 4), shows."""
        keys = pack_all(self._missing.voxels)
        order = np.argsort(keys)
        keys, seen = keys[order], self._in_view(situation, poses)[:, order]
        return [VoxelGains(keys[row > 0.0], row[row > 0.0]) for row in seen]

    def full_view(self, situation: Situation) -> float:
        """Voxels of a wall that fills the image, half the camera's range away."""
        camera, size = situation.camera, situation.voxel_map.config.voxel_size
        distance = 0.5 * situation.max_range
        area = (camera.width / camera.fx) * (camera.height / camera.fy) * distance**2
        return float(area / size**2)

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """The rating of eq. (11), with the missing surface for the information."""
        return Scores(ratings.ratings)

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """Views of missing places, each from somewhere before it, shape (E, 4, 4)."""
        if not len(self._missing):
            return np.empty((0, 4, 4))
        about = rng.integers(len(self._missing), size=_PROPOSED)
        ways = _within_cone(self._missing.normals[about], rng)
        ways *= rng.uniform(_NEAREST, _FARTHEST, (_PROPOSED, 1))
        poses = np.tile(np.eye(4), (_PROPOSED, 1, 1))
        poses[:, :3, 3] = self._missing.places[about] + ways
        elevations = np.arctan2(-ways[:, 2], np.hypot(ways[:, 0], ways[:, 1]))
        elevations = np.clip(elevations, -_ELEVATION, _ELEVATION)
        azimuths = np.arctan2(-ways[:, 1], -ways[:, 0])
        poses[:, :3, :3] = look_rotations(azimuths, elevations)
        _, inside = surroundings.in_box(poses[:, :3, 3])
        return np.asarray(poses[inside])

    def _in_view(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """Weight of each missing voxel in each view, (M, 4, 4) -> (M, N); 0 outside the image."""
        weights = self._weights(situation, poses[:, :3, 3])
        gaps = self._missing.places[None] - poses[:, None, :3, 3]
        local = np.einsum("mji,mnj->mni", poses[:, :3, :3], gaps)
        pixels = situation.camera.project(local)
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= -0.5) & (pixels < _size(situation) - 0.5)).all(axis=-1)
        return np.asarray(np.where(inside & (local[..., 2] > 0.0), weights, 0.0))

    def _weights(self, situation: Situation, positions: FloatArray) -> FloatArray:
        """How much of each missing voxel each position shows, (P, 3) -> (P, N)."""
        weights = np.zeros((len(positions), len(self._missing)))
        if not weights.size:
            return weights
        size = situation.voxel_map.config.voxel_size
        low = np.minimum(positions.min(axis=0), self._missing.places.min(axis=0))
        high = np.maximum(positions.max(axis=0), self._missing.places.max(axis=0))
        window = situation.voxel_map.window(low, high)
        sight_weights(
            window.quanta,
            self._hiding,
            positions / size - window.first,
            self._missing.places / size - window.first,
            self._missing.normals,
            self._shares(situation.voxel_map, situation.max_range),
            _STEP,
            float(np.cos(_STEEPEST)),
            weights,
        )
        return weights * self._hopes

    def _shares(self, voxel_map: VoxelMap, max_range: float) -> FloatArray:
        """Chance that a voxel is told from each distance of a table."""
        grid = voxel_map.config
        distances = np.arange(0.0, max_range / grid.voxel_size, _STEP) * grid.voxel_size
        shares = observed_share(distances, grid, self.config)
        return np.where(distances < self.config.min_range, 0.0, shares)


def _within_cone(axes: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Unit vectors within `_CONE` of unit vectors, shape (N, 3)."""
    offsets = rng.standard_normal(axes.shape)
    offsets -= (offsets * axes).sum(axis=1, keepdims=True) * axes
    offsets /= np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-9)
    angles = _CONE * np.sqrt(rng.random((len(axes), 1)))
    return np.asarray(np.cos(angles) * axes + np.sin(angles) * offsets)


def _size(situation: Situation) -> FloatArray:
    return np.array([situation.camera.width, situation.camera.height], np.float64)


def _lens(situation: Situation) -> tuple[float, ...]:
    camera = situation.camera
    numbers = camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height
    return tuple(map(float, numbers))
