"""Where to look from a place: towards what is unknown, and all around."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.sampling import coarse_views
from infomap_ros.views.sampling.surroundings import BoolArray, Surroundings

_ROWS, _COLUMNS = 12, 24  # directions are told apart by 15 degrees
_LEVEL_COLUMNS = 72  # and by 5 where all have the same elevation


@dataclass(frozen=True)
class OrientationConfig:
    """Configuration of the viewing directions of a candidate.

    Raises:
        ConfigError: a value is out of its range, or the limits of the elevation cross.
    """

    directed: int = setting(
        4,
        "Directions per position towards the periphery of the known and uncertain voxels in sight.",
        low=0,
        high=64,
    )
    spread: int = setting(
        2, "Further directions per position, spread evenly around.", low=0, high=64
    )
    lowest_elevation: float = setting(
        -1.2, "Lowest elevation of the optical axis.", unit="rad", low=-1.571, high=1.571
    )
    highest_elevation: float = setting(
        0.7, "Highest elevation of the optical axis.", unit="rad", low=-1.571, high=1.571
    )
    targets_per_position: ClassVar[int] = 300
    """At most so many cells are looked for from one position."""

    @property
    def bins(self) -> tuple[int, int]:
        """Elevations and azimuths by which directions are told apart."""
        is_level = self.lowest_elevation == self.highest_elevation
        return (1, _LEVEL_COLUMNS) if is_level else (_ROWS, _COLUMNS)

    def __post_init__(self) -> None:
        check_config(self)
        if self.lowest_elevation > self.highest_elevation:
            raise ConfigError(
                "lowest_elevation", self.lowest_elevation, "at most highest_elevation"
            )
        if self.directed + self.spread < 1:
            raise ConfigError("directed", self.directed, "at least 1 together with spread")


def look_rotations(azimuths: FloatArray, elevations: FloatArray) -> FloatArray:
    """Rotations of optical frames that look along directions with a level horizon.

    Args:
        azimuths: of the optical axis about z of the map, from x, shape (N,) [rad].
        elevations: above the horizontal plane, shape (N,) [rad].

    Returns:
        ``R_map_camera``, shape (N, 3, 3): x right and level, y down, z along the axis.
    """
    sin_a, cos_a = np.sin(azimuths), np.cos(azimuths)
    sin_e, cos_e = np.sin(elevations), np.cos(elevations)
    right = np.stack([sin_a, -cos_a, np.zeros_like(sin_a)], axis=-1)
    down = np.stack([cos_a * sin_e, sin_a * sin_e, -cos_e], axis=-1)
    forward = np.stack([cos_a * cos_e, sin_a * cos_e, sin_e], axis=-1)
    return np.stack([right, down, forward], axis=-1)


def choose_orientations(
    surroundings: Surroundings,
    camera: PinholeCamera,
    max_range: float,
    positions: FloatArray,
    config: OrientationConfig,
    rng: np.random.Generator,
) -> FloatArray:
    """Viewing directions for each position.

    Args:
        surroundings: the known space.
        camera: whose field of view is to be filled.
        max_range: how far it sees [m].
        positions: shape (P, 3) [m, map].
        config: how many, and within which elevations.
        rng: turns the evenly spread ones.

    Returns:
        ``R_map_camera``, shape (P, directed + spread, 3, 3); the directed ones come first. Where
        fewer directions than `directed` have anything in sight, spread ones take their place.
    """
    count = config.directed + config.spread
    azimuths, elevations = _spread(len(positions), count, config, rng)
    if config.directed > 0:
        sums = _targets_by_direction(surroundings, max_range, positions, config)
        found_a, found_e, useful = _best_directions(sums, camera, config)
        azimuths[:, : config.directed][useful] = found_a[useful]
        elevations[:, : config.directed][useful] = found_e[useful]
    return look_rotations(azimuths, elevations)


def _spread(
    positions: int, count: int, config: OrientationConfig, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Azimuths and elevations, shape (positions, count) each, stratified and shuffled."""
    turn = rng.uniform(-math.pi, math.pi, (positions, 1))
    azimuths = turn + 2.0 * math.pi * np.arange(count) / count
    strata = rng.permuted(np.tile(np.arange(count), (positions, 1)), axis=1)
    share = (strata + rng.random((positions, count))) / count
    low, high = config.lowest_elevation, config.highest_elevation
    return azimuths, low + share * (high - low)


def _targets_by_direction(
    surroundings: Surroundings, max_range: float, positions: FloatArray, config: OrientationConfig
) -> FloatArray:
    """Number of voxels worth looking at in sight, shape (P, rows * columns)."""
    size, window = surroundings.voxel_size, surroundings.window
    sums = np.zeros((len(positions), *config.bins))
    coarse_views.gather_directions(
        surroundings.states,
        positions / size - window.first,
        surroundings.targets.places / size - window.first,
        surroundings.targets.counts.astype(np.float64),
        max_range / size,
        config.targets_per_position,
        sums,
    )
    return sums.reshape(len(positions), sums.shape[1] * sums.shape[2])


def _bin_directions(config: OrientationConfig) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation of the middle of each bin, shape (rows * columns,)."""
    rows, columns = config.bins
    elevations = ((np.arange(rows) + 0.5) / rows - 0.5) * math.pi
    if rows == 1:
        elevations[:] = config.lowest_elevation
    azimuths = ((np.arange(columns) + 0.5) / columns - 0.5) * 2.0 * math.pi
    return np.tile(azimuths, rows), np.repeat(elevations, columns)


def _best_directions(
    sums: FloatArray, camera: PinholeCamera, config: OrientationConfig
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The `directed` views that hold most, one after the other without what is already in view.

    Returns:
        Azimuths, elevations [rad] and whether anything is in view, shape (P, directed) each.
    """
    bin_azimuths, bin_elevations = _bin_directions(config)
    axes = np.clip(bin_elevations, config.lowest_elevation, config.highest_elevation)
    rotations = look_rotations(bin_azimuths, axes)
    forward = look_rotations(bin_azimuths, bin_elevations)[..., 2]
    in_view = _in_view(camera, np.einsum("kji,bj->kbi", rotations, forward))
    left = sums.copy()
    best = np.empty((len(sums), config.directed), np.int64)
    useful = np.empty(best.shape, np.bool_)
    for turn in range(config.directed):
        seen = left @ in_view.T
        best[:, turn] = seen.argmax(axis=1)
        useful[:, turn] = seen.max(axis=1, initial=0.0) > 0.0
        left *= ~in_view[best[:, turn]]
    return bin_azimuths[best], axes[best], useful


def _in_view(camera: PinholeCamera, directions: FloatArray) -> BoolArray:
    """Which directions, (K, B, 3) in each camera's frame, fall into the image, (K, B) bool."""
    pixels = camera.project(directions)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.array([camera.width, camera.height]) - 0.5)
    return np.asarray(inside.all(axis=-1))
