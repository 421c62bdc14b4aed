from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.simulation.worlds import textures
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.rocks import boulder
from infomap_ros.simulation.worlds.scenes import (
    SceneConfig,
    build_scene,
    describe_scene,
    rover_rocks,
)
from infomap_ros.simulation.worlds.terrain import rough_terrain


def _ray(world: World, origin: np.ndarray, direction: np.ndarray) -> float:
    """Distance that MuJoCo finds to anything but the robot."""
    data = world.new_data()
    geom = np.zeros(1, np.int32)
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    model = world.model
    return float(mujoco.mj_ray(model, data, origin, direction, groups, True, -1, geom, None))


def test_terrain_height_is_what_mujoco_hits(rng: np.random.Generator) -> None:
    from infomap_ros.simulation.worlds.builder import SceneBuilder

    terrain = rough_terrain(3.0, 0.1, 0.1, 0.02, rng)
    builder = SceneBuilder(terrain)
    builder.add_ground_material("ground", textures.ground(64, rng), 1.0)
    builder.add_terrain("ground")
    world = builder.compile()
    for x, y in rng.uniform(-2.9, 2.9, (100, 2)):
        hit = _ray(world, np.array((x, y, 5.0)), np.array((0.0, 0.0, -1.0)))
        assert 5.0 - hit == pytest.approx(float(terrain.height((x, y))), abs=2e-6)


def test_surface_is_where_rays_of_mujoco_end(world: World, rng: np.random.Generator) -> None:
    ends = []
    while len(ends) < 200:
        origin = rng.uniform((-1.0, -1.0, 0.6), (1.0, 1.0, 1.4))
        direction = rng.normal(size=3) * (1.0, 1.0, 0.5)
        direction /= np.linalg.norm(direction)
        hit = _ray(world, origin, direction)
        if hit >= 0.0:
            ends.append(origin + hit * direction)
    np.testing.assert_allclose(world.surface_distance(np.array(ends)), 0.0, atol=2e-5)


def test_boulder_is_closed_and_outward(rng: np.random.Generator) -> None:
    vertices, faces = boulder((0.4, 0.3, 0.2), rng, 3)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->i", normals, a + b + c).min() > 0.0
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-12)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert (np.ptp(vertices, axis=0) <= (0.44, 0.33, 0.22)).all()


@pytest.mark.parametrize("make", [textures.ground, textures.rock, textures.bricks, textures.crate])
def test_textures_have_contrast_at_every_scale(make, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
    gray = make(256, rng).mean(axis=2)
    while len(gray) >= 16:
        assert np.abs(np.diff(gray, axis=1)).mean() > 3.0
        gray = 0.25 * (gray[::2, ::2] + gray[1::2, ::2] + gray[::2, 1::2] + gray[1::2, 1::2])


def test_ground_texture_tiles_without_a_seam(rng: np.random.Generator) -> None:
    gray = textures.ground(256, rng).mean(axis=2)
    inside = np.abs(np.diff(gray, axis=1)).mean()
    assert np.abs(gray[:, 0] - gray[:, -1]).mean() < 1.5 * inside


def test_same_seed_same_world_other_seed_other_world(small_scene: SceneConfig) -> None:
    scene = dataclasses.replace(small_scene, boulders=2, stones=2, texture_size=64)
    first, again = rover_rocks(scene), rover_rocks(scene)
    other = rover_rocks(dataclasses.replace(scene, seed=scene.seed + 1))
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 3))
    assert np.array_equal(first.surface_distance(points), again.surface_distance(points))
    assert not np.array_equal(first.surface_distance(points), other.surface_distance(points))
    assert np.array_equal(first.model.tex_data, again.model.tex_data)


def test_a_described_scene_can_be_built_again(small_scene: SceneConfig, world: World) -> None:
    again = build_scene(describe_scene("rover_rocks", small_scene))
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 3))
    assert np.array_equal(again.surface_distance(points), world.surface_distance(points))


@pytest.mark.parametrize("text", ["", "{}", '{"scene": "nowhere", "config": {}}', "[1]"])
def test_a_malformed_scene_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match="rover_rocks"):
        build_scene(text)


def test_impossible_parameters_are_refused() -> None:
    with pytest.raises(ConfigError, match="size"):
        SceneConfig(size=1.0)
