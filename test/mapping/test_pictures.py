"""Pictures show the surface from where it can be seen."""

from __future__ import annotations

import matplotlib.image
import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.pictures import (
    _below_ceiling,
    _open_side,
    _raster,
    _surface,
    _View,
    draw_map_views,
)

CAMERA = PinholeCamera(80, 60, 40.0, 40.0, 39.5, 29.5)


def looking(direction: np.ndarray, position: tuple[float, float, float]) -> np.ndarray:
    """T_map_camera that looks along a direction with z up."""
    right = np.cross(direction, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    return make_transform(np.stack([right, np.cross(direction, right), direction], 1), position)


def wall_map(direction: tuple[float, float, float]) -> VoxelMap:
    """A wall 2 m ahead of a camera at the origin."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    points = CAMERA.back_project(np.full((60, 80), 2.0, np.float32))
    pose = looking(np.array(direction), (0.0, 0.0, 1.0))
    for _ in range(2):
        voxel_map.integrate(points, pose, camera=CAMERA)
    return voxel_map


@pytest.mark.parametrize(
    ("direction", "title"),
    [
        ((1, 0, 0), "from -x"),
        ((-1, 0, 0), "from +x"),
        ((0, 1, 0), "from -y"),
        ((0, -1, 0), "from +y"),
    ],
)
def test_wall_is_drawn_from_the_side_of_the_camera(direction, title):
    voxel_map = wall_map(direction)
    assert _open_side(voxel_map, _surface(voxel_map).points).title == title


@pytest.mark.parametrize("view", [_View(1, 2, 0, -1, ""), _View(0, 2, 1, 1, "")])
def test_right_is_right_as_the_viewer_sees_it(view):
    """Against the cross product of looking direction and up."""
    looking_along = np.zeros(3)
    looking_along[view.towards] = -view.sign
    right = np.cross(looking_along, [0.0, 0.0, 1.0])
    points = np.array([-right, right, [0.0, 0.0, 1.0]])
    image = _raster(points, view, 1.0, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(image[0, [0, -1]], [1.0, 2.0])
    assert image[1, 1] == 3.0


def test_nearest_point_hides_the_others():
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    from_plus = _raster(points, _View(1, 2, 0, 1, ""), 1.0, points[:, 0])
    from_minus = _raster(points, _View(1, 2, 0, -1, ""), 1.0, points[:, 0])
    assert (from_plus.item(), from_minus.item()) == (2.0, 0.0)


def test_ceiling_is_cut_from_the_view_from_above():
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    points = CAMERA.back_project(np.full((60, 80), 1.3, np.float32))
    down = make_transform([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0, 0, 1.3])
    up = make_transform([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [0, 0, 1.3])
    for pose in (down, up):
        voxel_map.integrate(points, pose, camera=CAMERA)
    surface = _surface(voxel_map)
    below, note = _below_ceiling(surface, 0.1)
    assert np.ptp(surface.points[:, 2]) > 2.0
    assert np.ptp(below.points[:, 2]) < 0.6
    assert "below 2" in note or "below 1.9" in note


def test_wall_is_not_taken_for_a_ceiling():
    surface = _surface(wall_map((1, 0, 0)))
    assert _below_ceiling(surface, 0.05)[1] == ""


def test_picture_is_a_picture(tmp_path):
    draw_map_views(wall_map((1, 0, 0)), tmp_path / "map.png")
    pixels = matplotlib.image.imread(tmp_path / "map.png")
    assert pixels.shape[1] > 1000
    colored = np.ptp(pixels[..., :3], axis=-1) > 0.1
    assert colored.mean() > 0.02


def test_empty_map_cannot_be_drawn(tmp_path):
    with pytest.raises(InvalidInputError, match="no surface"):
        draw_map_views(VoxelMap(), tmp_path / "map.png")
