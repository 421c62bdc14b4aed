"""What counts as known: small worlds whose surfaces can be counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.progress import count_surface, measure_progress
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN, VoxelMap, VoxelMapConfig

START = np.array([10, 10, 5])
SIZE = 0.1  # [m]


def floor(known: slice) -> np.ndarray:
    """A floor of 20 x 20 voxels at z = 2, the air above it seen, known for some x."""
    states = np.full((20, 20, 8), UNKNOWN, np.uint8)
    states[known, :, 2] = OCCUPIED
    states[known, :, 3:] = FREE
    return states


def test_complete_floor_is_known() -> None:
    assert count_surface(floor(slice(None)), START, SIZE) == (400, 0)


def test_columns_without_surface_are_missing() -> None:
    known, missing = count_surface(floor(slice(0, 14)), START, SIZE)
    assert known == 14 * 20
    assert missing == 6 * 20


def test_what_a_closed_wall_hides_is_not_missing() -> None:
    states = floor(slice(0, 14))
    states[13, :, :] = OCCUPIED
    known, missing = count_surface(states, START, SIZE)
    assert known == 13 * 20 + 20 * 5  # the floor, and the wall's face above it
    assert missing == 0


@pytest.mark.parametrize(("width", "opens"), [(1, False), (2, False), (4, True)])
def test_gap_in_the_wall_opens_what_is_behind(width: int, opens: bool) -> None:
    """Gaps of up to 0.2 m are noise: one sees nothing through them, nor goes."""
    states = floor(slice(0, 14))
    states[13, :, :] = OCCUPIED
    states[13, 7 : 7 + width, 3:] = UNKNOWN
    assert (count_surface(states, START, SIZE)[1] >= 6 * 20) == opens


def test_what_is_behind_a_low_wall_is_missing() -> None:
    states = floor(slice(0, 14))
    states[13, :, 2:5] = OCCUPIED
    assert count_surface(states, START, SIZE)[1] >= 6 * 20


def test_hole_in_a_wall_counts_with_its_rim_and_what_is_behind_it() -> None:
    states = floor(slice(None))
    states[13:, :, :] = UNKNOWN
    states[13, :, 2:] = OCCUPIED
    states[13, 5:13, 3:] = UNKNOWN  # 8 wide and up to the top
    known, missing = count_surface(states, START, SIZE)
    assert known == 13 * 20 + 12 * 5
    assert missing == 2 * 3 * 5 + 6 * 20


def test_air_that_was_not_seen_beside_a_wall_is_not_missing_surface() -> None:
    states = floor(slice(0, 14))
    states[13, :, :] = OCCUPIED
    states[9:13, :, 6:] = UNKNOWN
    states[13, :, 6:] = UNKNOWN  # the wall's top neither
    known, missing = count_surface(states, START, SIZE)
    assert known == 13 * 20 + 20 * 3
    assert missing == 0  # where the wall goes on, unseen air is before it


def test_unknown_space_above_free_space_is_not_missing_surface() -> None:
    states = floor(slice(None))
    states[:, :, 6:] = UNKNOWN  # sky in which no ray ended
    assert count_surface(states, START, SIZE) == (400, 0)


def test_false_match_that_floats_in_the_air_goes_on_nowhere() -> None:
    states = floor(slice(None))
    states[:, :, 6:] = UNKNOWN
    states[9, 9:12, 6] = OCCUPIED
    known, missing = count_surface(states, START, SIZE)
    assert (known, missing) == (403, 0)


def test_nothing_known_counts_as_nothing() -> None:
    states = np.full((5, 5, 5), UNKNOWN, np.uint8)
    known, missing = count_surface(states, np.array([2, 2, 2]), SIZE)
    assert known == 0
    assert missing == 25


def seen_wall() -> VoxelMap:
    """A wall at z = 2 in front of a camera at the origin, seen twice."""
    camera = PinholeCamera(width=80, height=60, fx=50.0, fy=50.0, cx=39.5, cy=29.5)
    u, v = np.meshgrid(np.arange(80), np.arange(60))
    points = np.stack([(u - 39.5) / 50.0, (v - 29.5) / 50.0, np.ones(u.shape)], axis=-1) * 2.0
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, default_sigma=0.01))
    for _ in range(2):
        voxel_map.integrate(points, make_transform(np.eye(3), (0.03, 0.04, 0.05)), camera=camera)
    return voxel_map


def test_sigma_and_voxels_are_those_of_the_region() -> None:
    voxel_map = seen_wall()
    everything = measure_progress(voxel_map, ((-3, -3, -1), (3, 3, 3)), (0, 0, 0.5), 0.01)
    half = measure_progress(voxel_map, ((0, -3, -1), (3, 3, 3)), (0.5, 0, 0.5), 0.01)
    assert everything.surface_voxels == voxel_map.surface_voxels
    assert 0 < half.surface_voxels < everything.surface_voxels
    assert everything.known_voxels == half.known_voxels == voxel_map.known_voxels
    assert everything.entropy_bits == voxel_map.entropy_bits(((-3, -3, -1), (3, 3, 3)))
    assert 1e-4 < everything.mean_sigma < 1e-2
    assert 0.0 < everything.known_fraction < 1.0


def test_as_much_of_the_surface_is_precise_as_of_its_voxels() -> None:
    voxel_map, region = seen_wall(), ((-3, -3, -1), (3, 3, 3))
    _, _, covariances = voxel_map.gaussians()
    sigmas = np.sqrt(np.linalg.eigvalsh(covariances)[:, 0])
    limit = 1.001 * float(np.median(sigmas))
    share = float((sigmas <= limit).mean())
    every, some, none = (
        measure_progress(voxel_map, region, (0, 0, 0.5), sigma) for sigma in (1.0, limit, 1e-6)
    )
    assert every.precise_fraction == every.known_fraction == some.known_fraction
    assert some.precise_fraction == pytest.approx(share * some.known_fraction)
    assert 0.3 < share < 0.9
    assert none.precise_fraction == 0.0


def test_empty_map_is_wholly_unknown() -> None:
    progress = measure_progress(VoxelMap(), ((-1, -1, -1), (1, 1, 1)), (0, 0, 0), 0.01)
    assert progress.known_fraction == 0.0
    assert np.isnan(progress.mean_sigma)
    assert progress.precise_fraction == 0.0


@pytest.mark.parametrize(
    "region", [((0, 0, 0), (1, 1, np.inf)), ((0, 0, 0), (1, 0, 1)), (0, 0, 0), "box"]
)
def test_impossible_region_is_named(region: object) -> None:
    with pytest.raises(InvalidInputError, match="region"):
        measure_progress(VoxelMap(), region, (0, 0, 0), 0.01)
