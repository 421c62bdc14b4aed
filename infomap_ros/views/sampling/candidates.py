"""Candidates for the next view: Fig. 7 up to the rating (doi:10.1177/0278364905051774)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray, check_transforms
from infomap_ros.mapping import FREE
from infomap_ros.views.sampling.orientations import (
    OrientationConfig,
    choose_orientations,
    look_rotations,
)
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

OUTSIDE_REGION = "too far from the region of the task"
OUTSIDE_HEIGHTS = "outside the heights that the camera can be brought to"
NOT_FREE = "not known to be free"
NO_ROOM = "no room for the camera"
NOT_CONNECTED = "not connected to the camera's place through known free space"
NOTHING_NEAR = "neither near the periphery of the known nor near an obstacle"
NEAR_TEAMMATE = "too near a teammate or its goal"

_OVERSAMPLED = 8  # positions drawn per position wanted, as some fail the tests


@dataclass(frozen=True)
class CandidateConfig:
    """Configuration of the candidates.

    Raises:
        ConfigError: a value is out of its range.
    """

    candidates: int = setting(
        1000, "Number of candidate views that pass the cheap tests.", low=1, high=1_000_000
    )
    local_share: float = setting(
        0.3,
        "Share of the positions that is drawn near the present one; the rest is drawn uniformly "
        "from the known free space.",
        low=0.0,
        high=1.0,
    )
    local_radius: float = setting(
        1.0, "What counts as near the present position.", unit="m", low=0.01, high=100.0
    )
    periphery_share: float = setting(
        0.0,
        "Share of the positions that is drawn within the camera's range of the periphery of the "
        "known and of uncertain voxels, all of these alike: where little is left to see, few of "
        "the positions that are drawn uniformly see it.",
        low=0.0,
        high=1.0,
    )
    periphery_distance: float = setting(
        0.75,
        "Farthest distance to the periphery of the known or an obstacle, as a share of the "
        "camera's range.",
        low=0.01,
        high=1.0,
    )
    teammate_clearance: float = setting(
        0.6,
        "Smallest distance of the camera to the body of a teammate and to the view that it is "
        "heading for.",
        unit="m",
        low=0.0,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Views that passed the cheap tests, and those that did not.

    Attributes:
        positions: camera positions that passed, shape (P, 3) [m, map].
        orientations: ``R_map_camera`` per position, shape (P, O, 3, 3).
        extra: single views that passed besides, shape (E, 4, 4): those of the arm alone and the
            previous goal.
        rejected: poses of those that did not pass, shape (R, 4, 4), with a level glance.
        reasons: why not, one per rejected pose.
    """

    positions: FloatArray
    orientations: FloatArray
    extra: FloatArray
    rejected: FloatArray
    reasons: tuple[str, ...]

    @property
    def poses(self) -> FloatArray:
        """``T_map_camera`` of all that passed, position by position, then the extra ones."""
        count = self.orientations.shape[1]
        poses = np.tile(np.eye(4), (len(self.positions) * count, 1, 1))
        poses[:, :3, :3] = self.orientations.reshape(-1, 3, 3)
        poses[:, :3, 3] = np.repeat(self.positions, count, axis=0)
        return np.concatenate([poses, self.extra])


def find_candidates(
    situation: Situation,
    surroundings: Surroundings,
    rng: np.random.Generator,
    config: CandidateConfig | None = None,
    orientations: OrientationConfig | None = None,
    extra: ArrayLike = (),
) -> Candidates:
    """Draw camera positions from the known free space, test them, and look around from each.

    The present position is always among them: to turn is cheap.

    Args:
        situation: what is known.
        surroundings: its known space, from `survey`.
        rng: draws the positions.
        config: how many, and what is near.
        orientations: how many views per position.
        extra: single views ``T_map_camera`` to be tested as well, shape (E, 4, 4).

    Returns:
        At least the present position's views unless it is outside region or heights; fewer than
        asked for where the known free space gives no more.
    """
    settings, directions = config or CandidateConfig(), orientations or OrientationConfig()
    wanted = -(-settings.candidates // (directions.directed + directions.spread))
    accepted, rejected, reasons = _draw(situation, surroundings, rng, settings, wanted)
    here = situation.position[None]
    against = _tests(situation, surroundings, here, settings, camera_is_there=True)
    if not against[0]:
        accepted = np.concatenate([here, accepted])[:wanted]
    else:
        rejected, reasons = np.concatenate([here, rejected]), [*against, *reasons]
    views = check_transforms(
        np.reshape(np.asarray(extra, dtype=np.float64), (-1, 4, 4)), "extra views"
    )
    verdicts = _tests(situation, surroundings, views[:, :3, 3], settings)
    stands = np.array([not verdict for verdict in verdicts], np.bool_)
    low, high = np.clip(
        (directions.lowest_elevation, directions.highest_elevation), *situation.elevations
    )
    directions = replace(directions, lowest_elevation=float(low), highest_elevation=float(high))
    looks = choose_orientations(
        surroundings, situation.camera, situation.max_range, accepted, directions, rng
    )
    rejected_poses = _level_poses(rejected, situation.T_map_camera)
    return Candidates(
        accepted,
        looks,
        views[stands],
        np.concatenate([rejected_poses, views[~stands]]),
        (*reasons, *(verdict for verdict in verdicts if verdict)),
    )


def _draw(
    situation: Situation,
    surroundings: Surroundings,
    rng: np.random.Generator,
    settings: CandidateConfig,
    wanted: int,
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Positions that pass, those that do not, and why not."""
    accepted, rejected = np.empty((0, 3)), np.empty((0, 3))
    reasons: list[str] = []
    for share, source in _sources(situation, surroundings, rng, settings, wanted):
        missing = round(wanted * share) - len(accepted)
        drawn = rng.permutation(source[_sample(len(source), _OVERSAMPLED * missing, rng)])
        drawn = _lifted(situation, surroundings.centers(drawn))
        against = _tests(situation, surroundings, drawn, settings)
        passed = np.array([not reason for reason in against], np.bool_)
        enough = np.searchsorted(np.cumsum(passed), missing) + 1
        drawn, passed = drawn[:enough], passed[:enough]
        accepted = np.concatenate([accepted, drawn[passed]])
        rejected = np.concatenate([rejected, drawn[~passed]])
        reasons += [reason for reason in against[:enough] if reason]
    return accepted, rejected, reasons


def _sample(size: int, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    return np.asarray(rng.choice(size, min(max(count, 0), size), replace=False), dtype=np.int64)


def _sources(
    situation: Situation,
    surroundings: Surroundings,
    rng: np.random.Generator,
    settings: CandidateConfig,
    wanted: int,
) -> Iterator[tuple[float, NDArray[Any]]]:
    """Where to draw from, and the share of the positions that should then have been found.

    The last one makes up for what the tests took from the others.

    Yields:
        That share, and flat indices of voxels in the box, shape (N,), or points, shape (N, 3).
    """
    yield settings.local_share, surroundings.reached_near(settings.local_radius)
    share = min(settings.local_share + settings.periphery_share, 1.0)
    if share > settings.local_share:
        yield share, _near_periphery(situation, surroundings, rng, _OVERSAMPLED * wanted)
    if share < 1.0:
        sides = zip(surroundings.first, surroundings.reached.shape, strict=True)
        box = surroundings.states[tuple(slice(a, a + n) for a, n in sides)]
        in_band = _height_band(situation, surroundings)
        yield 1.0, np.flatnonzero((box == FREE) & in_band)
        yield 1.0, np.flatnonzero(surroundings.reached & in_band)


def _near_periphery(
    situation: Situation, surroundings: Surroundings, rng: np.random.Generator, count: int
) -> NDArray[np.int64]:
    """Voxels of the box that are reached, each within range of something to look at."""
    targets = surroundings.targets
    if not len(targets.counts):
        return np.empty(0, np.int64)
    share = targets.counts / targets.counts.sum()
    about = targets.places[rng.choice(len(share), count, p=share)]
    offsets = rng.normal(size=(count, 3)) * (1.0, 1.0, 0.0 if situation.is_planar else 1.0)
    offsets *= (
        situation.max_range
        * rng.random((count, 1))
        / np.linalg.norm(offsets, axis=1, keepdims=True)
    )
    places, inside = surroundings.in_box(about + offsets)
    places = places[inside]
    places = places[surroundings.reached[tuple(places.T)]]
    return np.unique(np.ravel_multi_index(tuple(places.T), surroundings.reached.shape))


def _height_band(situation: Situation, surroundings: Surroundings) -> NDArray[np.bool_]:
    """Voxels of the box at heights that the camera can be brought to; broadcasts to its shape."""
    nx, ny, nz = surroundings.reached.shape
    columns = surroundings.centers(np.arange(nx * ny) * nz)
    z = surroundings.centers(np.arange(nz))[:, 2]
    low, high = _band(situation)
    if situation.ground_height is None:
        return np.asarray((z >= low) & (z <= high))
    above = z - situation.ground_height(columns[:, :2]).reshape(nx, ny, 1)
    return np.asarray((above >= low) & (above <= high))


def _band(situation: Situation) -> tuple[float, float]:
    """The heights that the camera can be brought to, with one voxel between them at least."""
    low, high = situation.heights
    spare = max(0.5 * (situation.voxel_map.config.voxel_size - (high - low)), 0.0)
    return low - spare, high + spare


def _lifted(situation: Situation, points: FloatArray) -> FloatArray:
    """Points, (N, 3) [m, map], of the band brought to heights that the camera can have."""
    heights, (low, high) = situation.heights_of(points), _band(situation)
    in_band = (heights >= low) & (heights <= high)
    lift = np.where(in_band, np.clip(heights, *situation.heights) - heights, 0.0)
    return points + lift[:, None] * (0.0, 0.0, 1.0)


def _tests(
    situation: Situation,
    surroundings: Surroundings,
    points: FloatArray,
    settings: CandidateConfig,
    camera_is_there: bool = False,
) -> list[str]:
    """The first test that each position fails, "" where it passes all."""
    places, inside = surroundings.in_box(points)
    within = np.where(inside[:, None], places, 0)
    room, reached = (
        inside & (camera_is_there | grid[tuple(within.T)])
        for grid in (surroundings.has_room, surroundings.reached)
    )
    heights, (low, high) = situation.heights_of(points), _band(situation)
    near = np.linalg.norm(points - situation.position, axis=1) <= settings.local_radius
    # Near the camera the arm may reach over ground that is not known.
    in_band = ((heights >= low) & (heights <= high)) | (np.isnan(heights) & near)
    gap = settings.periphery_distance * situation.max_range
    tests = (
        (situation.region.contains(points, situation.max_range), OUTSIDE_REGION),
        (in_band, OUTSIDE_HEIGHTS),
        (surroundings.states_at(points) == FREE, NOT_FREE),
        (room, NO_ROOM),
        (reached, NOT_CONNECTED),
        (surroundings.gaps(points) <= gap, NOTHING_NEAR),
        (_clear_of_team(situation, points, settings.teammate_clearance), NEAR_TEAMMATE),
    )
    reasons = np.full(len(points), "", object)
    for passed, reason in reversed(tests):
        reasons[~passed] = reason
    return list(reasons)


def _clear_of_team(situation: Situation, points: FloatArray, clearance: float) -> NDArray[np.bool_]:
    clear = np.ones(len(points), np.bool_)
    for mate in situation.teammates:
        for place, radius in mate.places():
            clear &= np.linalg.norm(points - place, axis=1) >= clearance + radius
    return clear


def _level_poses(positions: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """Poses that look level into the present direction, (N, 3) -> (N, 4, 4)."""
    axis = T_map_camera[:3, 2]
    azimuth = np.array([np.arctan2(axis[1], axis[0])])
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = look_rotations(azimuth, np.zeros(1))[0]
    poses[:, :3, 3] = positions
    return poses
