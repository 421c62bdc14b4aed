"""Whether fiducials look as they did when they were seen before."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.localization.fiducials.tracks import (
    look_the_same,
    moved_viewpoint,
    turns_since,
    viewpoint,
)

POINTS = np.array([[0.4, -0.3, 2.0], [-0.6, 0.2, 3.0]])  # in the map, before a camera at its origin


def about_the_first(vector: list[float], nearer: float = 1.0) -> np.ndarray:
    """Pose of a camera that went around the first point by a turn [rad], and nearer to it."""
    turn = Rotation.from_rotvec(vector).as_matrix()
    return make_transform(turn, POINTS[0] - turn @ POINTS[0] / nearer)


@pytest.mark.parametrize(
    ("T_map_camera", "same"),
    [
        (np.eye(4), True),
        (about_the_first([0.0, 0.0, 0.25]), True),  # rolled a little
        (about_the_first([0.0, 0.0, 0.5]), False),
        (about_the_first([0.0, 0.0, np.pi]), False),  # upside down
        (about_the_first([0.0, 0.25, 0.0]), True),  # a little from the side
        (about_the_first([0.0, 0.5, 0.0]), False),
        (about_the_first([0.0, 0.0, 0.0], nearer=1.2), True),
        (about_the_first([0.0, 0.0, 0.0], nearer=1.6), False),
        (about_the_first([0.0, 0.0, 0.0], nearer=0.6), False),
    ],
)
def test_a_point_looks_the_same_from_about_there_and_the_same_way_up(
    T_map_camera: np.ndarray, same: bool
) -> None:
    before = np.stack([viewpoint(np.eye(4))] * 2)
    assert look_the_same(POINTS, before, T_map_camera)[0] == same


def test_a_camera_that_turns_to_a_side_sees_the_same() -> None:
    before = np.stack([viewpoint(np.eye(4))] * 2)
    turned = make_transform(Rotation.from_rotvec([0.0, 0.6, 0.0]).as_matrix(), np.zeros(3))
    assert look_the_same(POINTS, before, turned).all()


@pytest.mark.parametrize("roll", [0.3, -1.2, 2.9])
def test_a_rolled_camera_sees_all_turned_the_other_way(roll: float) -> None:
    before = np.stack([viewpoint(np.eye(4))] * 2)
    rolled = make_transform(Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix(), np.zeros(3))
    np.testing.assert_allclose(turns_since(POINTS, before, rolled), -roll, atol=0.03)


def test_the_turn_is_that_of_what_was_below_in_the_image() -> None:
    """Against where a point goes that lay on a line of sight a little below, equally far."""
    first, second = np.eye(4), about_the_first([0.2, -0.15, 1.9], nearer=1.3)
    ray = POINTS[0] + [0.0, 1e-4, 0.0]
    below = ray * (POINTS[0] @ POINTS[0]) / (ray @ POINTS[0])
    inside = (np.stack([POINTS[0], below]) - second[:3, 3]) @ second[:3, :3]
    u, v = np.diff(inside[:, :2] / inside[:, 2:], axis=0)[0]
    turns = turns_since(POINTS[:1], viewpoint(first)[None], second)
    assert turns[0] == pytest.approx(np.arctan2(-u, v), abs=1e-3)


def test_viewpoints_follow_the_maps_frame() -> None:
    T_map_camera = about_the_first([0.2, -0.4, 0.9])
    T_new_old = about_the_first([-0.7, 0.1, 2.0], nearer=3.0)
    moved = moved_viewpoint(T_new_old, viewpoint(T_map_camera))
    np.testing.assert_allclose(moved, viewpoint(T_new_old @ T_map_camera), atol=1e-12)
    back = moved_viewpoint(invert_transform(T_new_old), moved)
    np.testing.assert_allclose(back, viewpoint(T_map_camera), atol=1e-12)
