"""The worlds that are explored: closed, passable, and the same for the same seed."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import transform_points
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import (
    SCENES,
    build_scene,
    describe_scene,
    make_world,
)
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier

WORLDS = ("mars", "office", "cave")
SMALL = {"texture_size": 64, "size": 5.0}


def _hits(world: World, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance along each ray, -1 where nothing is hit."""
    data, geom = world.new_data(), np.zeros(1, np.int32)
    return np.array(
        [
            mujoco.mj_ray(world.model, data, origin, d, None, True, -1, geom, None)
            for d in directions
        ]
    )


def _directions(count: int, rng: np.random.Generator) -> np.ndarray:
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.fixture(scope="module", params=WORLDS)
def named(request: pytest.FixtureRequest) -> tuple[str, World]:
    return request.param, make_world(request.param, 3, **SMALL)


def test_the_start_is_clear_and_inside_the_region(named: tuple[str, World]) -> None:
    world = named[1]
    x, y, _ = world.start
    column = np.array([(x, y, z) for z in np.arange(0.3, 1.1, 0.05)])
    assert ((column > world.region[0]) & (column < world.region[1])).all()
    bearings = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    level = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(24)])
    for height in (0.15, 0.5, 0.9):
        reach = _hits(world, np.array((x, y, float(world.terrain.height((x, y))) + height)), level)
        assert (reach[reach >= 0.0] > 0.6).all()


def test_no_level_way_leads_out_of_the_region(named: tuple[str, World]) -> None:
    world = named[1]
    x, y, _ = world.start
    bearings = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    level = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(90)])
    reach = _hits(world, np.array((x, y, 0.3)), level)
    ends = np.array((x, y)) + reach[:, None] * level[:, :2]
    assert (reach > 0.0).all()
    assert (np.abs(ends) <= world.region[1, :2] + 0.6).all()


def test_the_cave_is_closed(rng: np.random.Generator) -> None:
    world = make_world("cave", 4, **SMALL)
    assert (_hits(world, np.array((0.0, 0.0, 0.8)), _directions(1000, rng)) > 0.0).all()


def test_mars_has_its_panel_and_passages_between_its_boulders() -> None:
    world = make_world("mars", 5, texture_size=64)
    names = [world.model.geom(index).name for index in range(world.model.ngeom)]
    assert "panel" in names
    boulders = [n for n in names if n.startswith("boulder_")]
    assert len(boulders) >= 4
    centers = np.array([world.model.geom(n).pos[:2] for n in boulders])
    sizes = np.array([world.model.geom_rbound[world.model.geom(n).id] for n in boulders])
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2) - sizes[:, None] - sizes
    assert apart[~np.eye(len(boulders), dtype=bool)].min() > 0.6


@pytest.mark.parametrize("name", WORLDS)
def test_same_seed_same_world(name: str) -> None:
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 3))
    first = make_world(name, 3, **SMALL).surface_distance(points)
    described = describe_scene(name, SCENES[name].config(seed=3, **SMALL))
    assert np.array_equal(first, build_scene(described).surface_distance(points))
    assert not np.array_equal(first, make_world(name, 4, **SMALL).surface_distance(points))


@pytest.mark.parametrize("name", WORLDS)
def test_the_size_of_textures_does_not_move_anything(name: str) -> None:
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 3))
    small, large = (
        make_world(name, 3, size=5.0, texture_size=size).surface_distance(points)
        for size in (64, 128)
    )
    assert np.array_equal(small, large)


def test_unknown_worlds_and_parameters_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"nowhere.*mars"):
        make_world("nowhere", 1)
    with pytest.raises(InvalidInputError, match="doors"):
        make_world("mars", 1, doors=2)
    with pytest.raises(ConfigError, match="ceiling"):
        make_world("cave", 1, ceiling=0.1)


@pytest.mark.parametrize("name", WORLDS)
def test_stereo_matches_the_textures(name: str, description: str) -> None:
    world = make_world(name, 2, texture_size=1024, size=5.0)
    camera = StereoCameraConfig(width=320, height=240)
    robot = Simulator(world, description, SimulatorConfig(camera=camera))
    robot.follow_arm_trajectory(["arm_pan_joint"], [[0.9]], [0.5])
    while robot.is_moving:
        robot.step(0.2)
    rectifier = StereoRectifier(*robot.calibrations)
    pair = robot.capture()
    robot.close()
    cloud = StereoRangeSensor(rectifier.rig, StereoConfig()).measure(
        *rectifier.rectify(pair.left, pair.right)
    )
    left = rectifier.rig.left
    pixels = np.stack(np.meshgrid(np.arange(30, 320, 5), np.arange(5, 240, 5)), axis=-1)
    rays = np.dstack([(pixels - (left.cx, left.cy)) / left.fx, np.ones(pixels.shape[:2])])
    ends = transform_points(robot.true_camera_pose(), 4.0 * rays.reshape(-1, 3))
    starts = np.broadcast_to(robot.true_camera_pose()[:3, 3], ends.shape)
    depth = 4.0 * world.surface.first_hits(starts, ends)
    measured = cloud.range_image[pixels[..., 1], pixels[..., 0]].ravel()
    in_range = np.isfinite(depth)
    assert np.isfinite(measured[in_range]).mean() > 0.8
    both = in_range & np.isfinite(measured)
    error = np.abs(measured - depth)[both] / depth[both] ** 2
    assert np.median(error) < 0.006  # 0.25 px: z^2 / (f b) times that
