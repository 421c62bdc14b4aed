"""What was looked at in vain: counted by nearness, forgotten when known, given up in a copy."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import pack
from infomap_ros.views.decision import UnproductiveLooks

SIZE = 0.05


def seen() -> VoxelMap:
    """A map with a surface at x = 1 and free space before it, about the x axis."""
    voxel_map = VoxelMap()
    points = np.array([(1.0, y, z) for y in np.linspace(-0.1, 0.1, 9) for z in (-0.05, 0.0, 0.05)])
    for _ in range(3):
        voxel_map.integrate(points, np.eye(4))
    return voxel_map


def keys_of(*indices: tuple[int, int, int]) -> np.ndarray:
    return np.array([pack(*index) for index in indices], np.int64)


def center(index: tuple[int, int, int]) -> np.ndarray:
    return (np.array([index]) + 0.5) * SIZE


NEAR, FAR = (-5, -20, 3), (-70, 2, -3)  # 1 m and 3.5 m from the origin, both unknown


def test_near_voxel_is_given_up_before_a_far_one() -> None:
    looks, voxel_map = UnproductiveLooks(1.5), seen()
    given_up = []
    for _ in range(8):
        looks.note(keys_of(NEAR, FAR), voxel_map, np.zeros(3), 4.0)
        copy = looks.without_them(voxel_map)
        given_up.append([bool(copy.is_known(center(index))[0]) for index in (NEAR, FAR)])
    weights = [1.0 - (np.linalg.norm(center(index)) / 4.0) ** 2 for index in (NEAR, FAR)]
    first = [next(i for i, row in enumerate(given_up, 1) if row[k]) for k in (0, 1)]
    assert first == [int(np.ceil(1.5 / weight)) for weight in weights]


def test_map_itself_stays_as_it_was_and_the_copy_differs_nowhere_else() -> None:
    looks, voxel_map = UnproductiveLooks(0.5), seen()
    before = voxel_map.voxels()
    looks.note(keys_of(NEAR), voxel_map, np.zeros(3), 4.0)
    copy = looks.without_them(voxel_map)
    for mine, theirs in zip(before, voxel_map.voxels(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert copy.known_voxels == voxel_map.known_voxels + 1
    assert copy.probability(center(NEAR))[0] < 1e-6
    np.testing.assert_array_equal(copy.log_odds((before[0] + 0.5) * SIZE), before[1])
    assert copy.surface_voxels == voxel_map.surface_voxels


def test_voxel_that_becomes_known_is_forgotten() -> None:
    looks, voxel_map = UnproductiveLooks(0.5), seen()
    looks.note(keys_of(NEAR, FAR), voxel_map, np.zeros(3), 4.0)
    aside = make_transform(np.eye(3), center(NEAR)[0] - (0.5, 0.0, 0.0))
    voxel_map.integrate([(1.0, 0.0, 0.0)], aside)  # a ray through it
    assert voxel_map.is_known(center(NEAR))[0]
    evidence = voxel_map.log_odds(center(NEAR))
    np.testing.assert_array_equal(looks.without_them(voxel_map).log_odds(center(NEAR)), evidence)
    looks.note(keys_of(), voxel_map, np.zeros(3), 4.0)
    assert len(looks) == 1


def test_given_up_voxels_can_be_asked_for() -> None:
    looks, voxel_map = UnproductiveLooks(0.5), seen()
    assert not looks.are_given_up(keys_of(NEAR, FAR)).any()
    looks.note(keys_of(NEAR, FAR), voxel_map, np.zeros(3), 4.0)
    np.testing.assert_array_equal(looks.are_given_up(keys_of(FAR, NEAR)), [False, True])


def test_known_voxels_are_never_counted() -> None:
    looks, voxel_map = UnproductiveLooks(), seen()
    looks.note(keys_of((10, 0, 0)), voxel_map, np.zeros(3), 4.0)
    assert len(looks) == 0
    assert looks.without_them(voxel_map) is voxel_map
