"""Maps that do not fit are noticed before they are merged, and can be moved to where they do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.replica import moved_map

CONFIG = VoxelMapConfig(voxel_size=0.1, max_range=4.0)
CAMERA = PinholeCamera(width=64, height=48, fx=50.0, fy=50.0, cx=31.5, cy=23.5)
SHIFT = make_transform(Rotation.from_euler("z", 0.1).as_matrix(), np.array([0.5, 0.3, -0.4]))


def seen_from(places: list[float], error: np.ndarray | None = None) -> VoxelMap:
    """A wall at z = 2.05 with a step of 0.6 m, mapped by a robot that is off by `error`.

    Its surfaces are in the middle of voxels: rounding does not decide to which they belong.
    """
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    for place in places:
        pose = np.eye(4)
        pose[0, 3] = place
        across = CAMERA.back_project(np.full((48, 64), 2.0))[..., 0] + place
        depth = np.where(across > 0, 1.45, 2.05)
        points = CAMERA.back_project(depth)
        own.integrate(points, pose if error is None else error @ pose, camera=CAMERA)
    return own


def introduce(first: VoxelMap, second: VoxelMap) -> TeamMember:
    """A robot with the first map that has heard all of the second, and compared them."""
    hearer, speaker = (TeamMember(robot, 1, 100, CONFIG) for robot in range(2))
    for member, own in ((hearer, first), (speaker, second)):
        member.begin(own)
    hearer.updates(first, 0.0)
    for step in range(20):
        for rows in speaker.updates(second, 0.1 * step):
            hearer.receive_update(rows, 0.1 * step)
    assert hearer.replica.aside == (1,)
    hearer.digests(3.0)
    return hearer


def test_maps_that_fit_are_merged() -> None:
    hearer = introduce(seen_from([0.0, 0.1, 0.2]), seen_from([0.3, 0.15]))

    assert hearer.contradictions == {}
    assert hearer.replica.aside == ()


@pytest.mark.parametrize("error", [SHIFT, np.linalg.inv(SHIFT)])
def test_a_map_that_lies_wrong_is_reported_and_not_merged(error: np.ndarray) -> None:
    first = seen_from([0.0, 0.1, 0.2])
    hearer = introduce(first, seen_from([0.3, 0.15, 0.1], error))

    assert hearer.contradictions.keys() == {1}
    assert hearer.replica.aside == (1,)
    assert hearer.replica.voxel_map.known_voxels == first.known_voxels


def test_a_moved_map_fits_again() -> None:
    wrong = seen_from([0.3, 0.15, 0.1], SHIFT)

    hearer = introduce(seen_from([0.0, 0.1, 0.2]), moved_map(wrong, np.linalg.inv(SHIFT)))

    assert hearer.contradictions == {}


def test_surfaces_and_free_space_move_with_the_transform() -> None:
    source = seen_from([0.0, 0.1])

    moved = moved_map(source, SHIFT)

    means = transform_points(SHIFT, source.gaussians()[1])
    distances = np.linalg.norm(moved.gaussians()[1][:, None] - means[None], axis=2).min(axis=1)
    assert distances.max() < 1e-4
    assert len(moved.gaussians()[1]) > 0.9 * len(means)
    indices, odds = source.voxels()
    free = (indices[odds < -2.5] + 0.5) * 0.1
    assert (moved.log_odds(transform_points(SHIFT, free)) < -1.0).mean() > 0.85


def test_after_a_move_others_follow_and_the_old_place_is_taken_back() -> None:
    hearer, speaker = (TeamMember(robot, 1, 100, CONFIG) for robot in range(2))
    wrong = seen_from([0.0], SHIFT)
    speaker.begin(wrong)
    for rows in speaker.updates(wrong, 0.0):
        hearer.receive_update(rows, 0.0)
    right = moved_map(wrong, np.linalg.inv(SHIFT))

    speaker.replace(right)
    for step in range(1, 20):
        for rows in speaker.updates(right, 0.5 * step):
            hearer.receive_update(rows, 0.5 * step)
    hearer.digests(20.0)

    assert hearer.replica.voxel_map.known_voxels == right.known_voxels
    assert hearer.replica.hash() == speaker.replica.hash()
