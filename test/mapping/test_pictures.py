"""Pictures show the surface from where it can be seen."""

from __future__ import annotations

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.pictures import (
    _below_ceiling,
    _draw,
    _open_side,
    _raster,
    _sheet,
    _surface,
    _View,
    draw_map_views,
    map_from_above,
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
        ((1, 0, 0), "side view along +x"),
        ((-1, 0, 0), "side view along -x"),
        ((0, 1, 0), "side view along +y"),
        ((0, -1, 0), "side view along -y"),
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


def floor_map(height: float) -> VoxelMap:
    """Two floors beside each other, away from the origin, one `height` above the other."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    x, y = np.random.default_rng(1).uniform((3.0, -2.0), (4.0, 0.0), (20_000, 2)).T
    points = np.column_stack([x, y, np.where(y < -1.0, 0.025, height + 0.025)])
    for _ in range(2):
        sensor = np.array([3.5, -1.0, 3.0])
        points_there = (points - sensor).astype(np.float32)
        voxel_map.integrate(points_there, make_transform(np.eye(3), sensor))
    return voxel_map


def test_what_was_seen_less_often_is_drawn_all_the_same() -> None:
    """A floor of which one end was in view far longer than the other."""
    voxel_map, sensor = floor_map(0.0), np.array([3.5, -1.0, 3.0])
    x, y = np.random.default_rng(2).uniform((3.0, -1.5), (4.0, 0.0), (20_000, 2)).T
    points = np.column_stack([x, y, np.full_like(x, 0.025)])
    before = _surface(voxel_map)
    for _ in range(60):
        voxel_map.integrate((points - sensor).astype(np.float32), make_transform(np.eye(3), sensor))
    assert len(_surface(voxel_map).points) >= 0.99 * len(before.points) > 700


def test_a_flat_surface_has_the_color_of_its_height() -> None:
    """What the color bar says: the colormap's own values, no shading."""
    image = map_from_above(floor_map(0.9))
    ends = [np.rint(255 * np.array(matplotlib.colormaps["viridis"](end))[:3]) for end in (0.0, 1.0)]
    solid = image.pixels[image.pixels[..., 3] > 0][:, :3].astype(float)
    for end in ends:
        assert (np.abs(solid - end).max(axis=1) <= 3).mean() > 0.4, "half the map has this height"


@pytest.mark.parametrize("mirrored", [False, True])
def test_axes_are_those_of_the_map(mirrored: bool) -> None:
    """A point's pixel lies where the axes say that the point is."""
    surface = _surface(floor_map(0.9))
    view = _View(0, 2, 1, 1 if mirrored else -1, "side")
    axes = Figure().add_subplot()
    _draw(axes, surface, view, 0.05, surface.points[:, 2], Normalize(0, 1), "viridis", "z [m]")
    left, right, bottom, top = axes.images[0].get_extent()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")
    assert sorted((left, right)) == pytest.approx([3.0, 4.0], abs=0.051)
    assert (bottom, top) == pytest.approx((0.0, 0.95), abs=0.051)
    assert bool(left > right) == mirrored


def test_sheet_says_what_it_shows_and_where_the_camera_was(tmp_path) -> None:
    path = np.array([[3.1, -1.5, 1.0], [3.9, -0.5, 1.0]])
    voxel_map = floor_map(0.9)
    draw_map_views(voxel_map, tmp_path / "without.png", "rocks")
    draw_map_views(voxel_map, tmp_path / "with.png", "rocks", path)
    red = [
        int(((p[..., 0] > 0.8) & (p[..., 1] < 0.3) & (p[..., 2] < 0.3)).sum())
        for p in (matplotlib.image.imread(tmp_path / f"{name}.png") for name in ("without", "with"))
    ]
    assert red[1] > red[0] + 200


@pytest.mark.parametrize(("tall", "flat", "rows"), [(0.1, 0.05, 3), (0.3, 0.1, 3), (0.8, 0.2, 2)])
def test_what_is_long_lies_one_below_the_other(tall: float, flat: float, rows: int) -> None:
    _, axes = _sheet(tall, flat)
    tops = {round(one.get_position().y1, 3) for one in axes}
    assert len(tops) == rows


@pytest.mark.parametrize(("tall", "flat"), [(1.6, 0.1), (0.3, 0.7)])
def test_sigma_is_beside_the_view_that_shows_more(tall: float, flat: float) -> None:
    _, (top, side, sigma) = _sheet(tall, flat)
    beside, alone = (top, side) if tall > flat else (side, top)
    assert sigma.get_position().y1 == pytest.approx(beside.get_position().y1)
    assert alone.get_position().y1 < beside.get_position().y0


@pytest.mark.parametrize("limits", [(18.1, 32.1), (2.0, 130.0), (0.03, 4000.0)])
def test_the_scale_of_sigma_has_plain_numbers(limits: tuple[float, float]) -> None:
    surface = _surface(floor_map(0.9))
    axes = Figure().add_subplot()
    view, scale = _View(0, 1, 2, 1, "top"), LogNorm(*limits)
    _draw(axes, surface, view, 0.05, 1e3 * surface.sigmas, scale, "magma", "sigma [mm]")
    bar = axes.figure.axes[1]
    shown = [float(text.get_text()) for text in bar.get_yticklabels()]
    assert 2 <= len(shown) <= 20
    assert all(limits[0] <= value <= limits[1] for value in shown)
    assert bar.get_yticks() == pytest.approx(shown)


def test_picture_is_a_picture(tmp_path):
    draw_map_views(wall_map((1, 0, 0)), tmp_path / "map.png")
    pixels = matplotlib.image.imread(tmp_path / "map.png")
    assert pixels.shape[1] > 1000
    colored = np.ptp(pixels[..., :3], axis=-1) > 0.1
    assert colored.mean() > 0.02


def test_empty_map_cannot_be_drawn(tmp_path):
    with pytest.raises(InvalidInputError, match="no surface"):
        draw_map_views(VoxelMap(), tmp_path / "map.png")
