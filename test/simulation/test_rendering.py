from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from infomap_ros.errors import SimulationError
from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.worlds.builder import World

# Neither square pixels nor a centered principal point, so that each of them matters.
CAMERA = PinholeCamera(160, 120, 110.0, 125.0, 70.3, 64.8)
POSE = make_transform(
    np.column_stack(
        [(0.0, -1.0, 0.0), (-0.2873479, 0.0, -0.9578263), (0.9578263, 0.0, -0.2873479)]
    ),
    (-0.4, 0.1, 0.9),
)


@pytest.fixture(scope="module")
def renderer(world: World) -> Iterator[Renderer]:
    with Renderer(world.model, CAMERA.width, CAMERA.height) as made:
        yield made


def test_depth_lies_on_the_surface(world: World, renderer: Renderer) -> None:
    data = world.new_data()
    data.qpos[:3] = (0.0, 0.0, -5.0)  # the robot out of sight, below the ground
    mujoco.mj_forward(world.model, data)
    points = CAMERA.back_project(renderer.depth(data, POSE, CAMERA)).reshape(-1, 3)
    points = transform_points(POSE, points[np.isfinite(points[:, 2])])
    distance = world.surface_distance(points)
    assert len(points) > 5000
    assert distance.max() < 1e-4


def test_pixel_centers_are_where_the_camera_model_says(world: World, renderer: Renderer) -> None:
    data = world.new_data()
    depth = renderer.depth(data, POSE, CAMERA)
    geoms = renderer.geom_ids(data, POSE, CAMERA)
    drawn = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    rng = np.random.default_rng(5)
    compared = 0
    pixels = rng.integers((1, 1), (CAMERA.width - 1, CAMERA.height - 1), (150, 2))
    for u, v in pixels:
        if len(np.unique(geoms[v - 1 : v + 2, u - 1 : u + 2])) > 1:
            continue  # a ray through an edge may fall on either side
        ray = np.array(((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0))
        hit = np.zeros(1, np.int32)
        length = mujoco.mj_ray(
            world.model, data, POSE[:3, 3].copy(), POSE[:3, :3] @ ray, drawn, True, -1, hit, None
        )
        expected = np.nan if length < 0.0 else length
        # Half a pixel is 2 to 10 mm on the ground; the depth buffer resolves less than 0.4 mm.
        assert np.isclose(depth[v, u], expected, atol=4e-4, equal_nan=True)
        assert geoms[v, u] == hit[0]
        compared += 1
    assert compared > 100


def test_color_is_textured_and_the_sky_is_not(world: World, renderer: Renderer) -> None:
    view = renderer.view(world.new_data(), POSE, CAMERA)
    sky = np.isnan(view.depth)
    assert sky.any()
    assert view.color[sky].std(axis=0).max() < 10.0
    assert view.color[~sky].std(axis=0).min() > 15.0


def test_another_image_size_is_refused(world: World, renderer: Renderer) -> None:
    with pytest.raises(SimulationError, match="160x120"):
        renderer.color(world.new_data(), POSE, CAMERA.scaled(0.5))
