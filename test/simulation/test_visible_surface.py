"""Ground truth of what can be seen: rays against MuJoCo, a closed room, a box, and a map."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError, SimulationError
from infomap_ros.geometry import (
    PoseRecord,
    invert_transform,
    make_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.simulation.exploring.truth import TrueSurface, audit_pose
from infomap_ros.simulation.exploring.visible_surface import (
    ReachableViewsConfig,
    VisibleSurfaceConfig,
    covered,
    map_errors,
    reachable_cameras,
    standable_places,
    surface_coverage,
    visible_surface,
)
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

REACH = ReachableViewsConfig(spacing=0.4, max_cameras=150)
VISIBLE = VisibleSurfaceConfig(spacing=0.08)
BOX = np.array([(1.0, -0.25, 0.0), (1.5, 0.25, 0.5)])
ROOM = np.array([(-2.6, -2.6), (-1.8, -1.8)])  # closed, in a corner


@pytest.fixture(scope="module")
def yard() -> World:
    """Level ground, 4 x 4 m, with walls about it, a box, and a closed cell in one corner."""
    builder = SceneBuilder(Terrain(np.zeros((31, 31)), 3.0))
    builder.region = np.array([(-2.6, -2.6, -0.1), (2.6, 2.6, 1.5)])
    builder.add_ground_material("ground", np.full((64, 64, 3), 128, np.uint8), 1.0)
    builder.add_material("paint", np.full((64, 64, 3), 200, np.uint8))
    builder.add_terrain("ground")
    for index, (x, y) in enumerate(((2.7, 0), (-2.7, 0), (0, 2.7), (0, -2.7))):
        size = (0.2, 5.6, 3.0) if x else (5.6, 0.2, 3.0)
        builder.add_box(f"wall_{index}", size, make_transform(np.eye(3), (x, y, 0.0)), "paint")
    builder.add_box("cell_a", (0.1, 0.9, 3.0), make_transform(np.eye(3), (-1.75, -2.2, 0)), "paint")
    builder.add_box("cell_b", (0.9, 0.1, 3.0), make_transform(np.eye(3), (-2.2, -1.75, 0)), "paint")
    builder.add_box("box", (0.5, 0.5, 0.5), make_transform(np.eye(3), BOX.mean(axis=0)), "paint")
    return builder.compile()


def test_lines_end_where_mujoco_says(world: World, rng: np.random.Generator) -> None:
    model, data, geom = world.model, world.new_data(), np.zeros(1, np.int32)
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)  # all but the robot
    origins = rng.uniform((-3.0, -3.0, -0.2), (3.0, 3.0, 1.5), (300, 3))
    rays = rng.normal(size=(300, 3))
    rays *= 4.0 / np.linalg.norm(rays, axis=1, keepdims=True)
    expected = [
        mujoco.mj_ray(model, data, o, w, groups, True, -1, geom, None)
        for o, w in zip(origins, rays, strict=True)
    ]
    expected = np.array([h if 0.0 <= h <= 1.0 else np.inf for h in expected])
    shares = world.surface.first_hits(origins, origins + rays)
    above = origins[:, 2] > world.terrain.height(origins[:, :2])  # below ground MuJoCo sees none
    assert np.isfinite(expected[above]).sum() > 100
    np.testing.assert_allclose(shares[above], expected[above], atol=1e-5)


def test_lines_along_an_axis_and_of_no_length(yard: World) -> None:
    shares = yard.surface.first_hits(
        [(0, 0, 0.2), (0, 0, 0.2), (0, 0, 0.2), (9, 9, 9)],
        [(2, 0, 0.2), (0, 0, -0.2), (0, 0, 0.2), (9, 9, 0)],
    )
    np.testing.assert_allclose(shares, (0.5, 0.5, np.inf, np.inf))


def test_the_robot_stands_beside_the_box_and_not_in_the_cell(yard: World) -> None:
    places = standable_places(yard, REACH)
    assert len(places) > 60
    beyond = np.maximum(np.abs(places[:, :2] - BOX.mean(axis=0)[:2]) - 0.25, 0.0)
    assert np.linalg.norm(beyond, axis=1).min() > 0.3
    assert not (places[:, :2] < ROOM[1] + 0.3).all(axis=1).any()
    assert np.abs(places[:, :2]).max() < 2.6 - 0.3


def test_cameras_keep_their_distance(yard: World) -> None:
    cameras = reachable_cameras(yard, REACH)
    assert yard.surface_distance(cameras).min() > REACH.camera_clearance
    assert np.ptp(cameras[:, 2]) == pytest.approx(0.5)


def test_what_faces_the_yard_is_visible_and_what_is_hidden_is_not(yard: World) -> None:
    truth = visible_surface(yard, 4.0, VISIBLE, REACH)
    points = truth.points
    in_cell = (points[:, :2] < ROOM[1] - 0.01).all(axis=1)
    assert not in_cell.any()
    on_box = np.abs(np.abs(points - BOX.mean(axis=0)).max(axis=1) - 0.25) < 1e-6
    facing = truth.normals[on_box] @ np.vstack([np.eye(3), -np.eye(3)]).T > 0.9
    assert (facing.sum(axis=0)[:5] > 10).all()  # four sides and the top
    assert facing[:, 5].sum() == 0  # the underside
    below = (np.abs(points[:, :2] - BOX.mean(axis=0)[:2]) < 0.24).all(axis=1) & (points[:, 2] < 0.1)
    assert not below.any()


def test_a_short_range_sees_less(yard: World) -> None:
    cameras = np.array([(0.0, 0.0, 0.6), (0.1, 0.0, 0.6)])
    near = visible_surface(yard, 1.0, VISIBLE, cameras=cameras)
    assert np.linalg.norm(near.points - cameras[0], axis=1).max() < 1.15
    assert len(near.points) < 0.5 * len(visible_surface(yard, 4.0, VISIBLE, cameras=cameras).points)


def test_a_camera_beside_the_box_decides_like_a_plain_search(yard: World) -> None:
    camera = np.array([(0.4, 0.1, 0.4)])
    config = VisibleSurfaceConfig(spacing=0.15, views=1, steepest=1.57)
    seen = visible_surface(yard, 3.0, config, cameras=camera)
    points, normals = yard.surface.samples(0.15, np.random.default_rng(config.seed))
    inside = ((points >= yard.region[0]) & (points <= yard.region[1])).all(axis=1)
    data, geom, expected = yard.new_data(), np.zeros(1, np.int32), []
    for point, normal in zip(points[inside], normals[inside], strict=True):
        ray = camera[0] - point - 0.003 * normal
        distance = np.linalg.norm(ray)
        hit = mujoco.mj_ray(
            yard.model, data, camera[0], -ray / distance, None, True, -1, geom, None
        )
        expected.append(0.25 < distance < 3.0 and ray @ normal > 0.0 and hit > distance - 0.01)
    assert abs(sum(expected) - len(seen.points)) <= 0.02 * sum(expected)


def test_coverage_counts_what_the_map_holds(yard: World) -> None:
    truth = visible_surface(yard, 4.0, VISIBLE, REACH)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    assert surface_coverage(voxel_map, truth.points) == 0.0
    half = truth.points[truth.points[:, 0] > 0.0].astype(np.float32)
    spread = np.broadcast_to(np.eye(3, dtype=np.float32) * 1e-4, (len(half), 3, 3))
    voxel_map.integrate(
        half - np.float32((0, 0, 0.6)), make_transform(np.eye(3), (0, 0, 0.6)), spread
    )
    is_covered = covered(voxel_map, truth.points)
    assert is_covered[truth.points[:, 0] > 0.1].mean() > 0.97
    assert is_covered[truth.points[:, 0] < -0.1].mean() == 0.0
    with pytest.raises(InvalidInputError, match="points"):
        surface_coverage(voxel_map, np.zeros((0, 3)))


def test_map_errors_are_in_sigmas(yard: World, rng: np.random.Generator) -> None:
    plane = np.column_stack([rng.uniform(-0.9, 0.9, (20000, 2)), np.zeros(20000)])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    above = make_transform(np.eye(3), (0.0, 0.0, 0.6))
    noisy = (plane - np.array((0.0, 0.0, 0.58))).astype(np.float32)
    spread = np.broadcast_to(np.eye(3, dtype=np.float32) * 0.02**2, (len(noisy), 3, 3))
    pose_covariance = np.diag([0.006**2] * 3 + [1e-12] * 3)
    voxel_map.integrate(noisy, above, spread, pose_covariance)
    errors = map_errors(voxel_map, yard)
    np.testing.assert_allclose(errors.distances, 0.02, atol=1e-3)
    np.testing.assert_allclose(errors.normalized, errors.distances / errors.sigmas)
    assert errors.share_within(1.0) < errors.share_within(3.0) == 1.0
    assert errors.root_mean_square == pytest.approx(np.median(errors.normalized), rel=0.1)


def test_a_run_is_compared_in_the_frame_of_its_map(yard: World) -> None:
    """One point for each voxel of half the ground, thirds of it 0.5, 1.5 and 2.5 sigmas off."""
    sigma, T_world_map = 0.006, make_transform(np.diag([-1.0, -1.0, 1.0]), (0.3, 0.2, -0.025))
    grid = np.arange(-2.575, 2.6, 0.05)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid[grid < 0.0], indexing="ij"))
    offsets = sigma * np.array((0.5, 1.5, 2.5))[3 * np.arange(len(x)) // len(x)]
    ground = np.column_stack([x, y, offsets])
    points = transform_points(invert_transform(T_world_map), ground)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=10.0))
    spread = np.broadcast_to(sigma**2 * np.eye(3), (len(points), 3, 3))
    voxel_map.integrate(points, np.eye(4), spread)
    believed = PoseRecord(7, "map", np.eye(4), 0.5**2 * np.eye(6))
    error = [1.0, -1.0, 1.0, 0.3, 0.2, -0.1]
    poses = [audit_pose(believed, perturb_transform(np.eye(4), error))]

    truth = TrueSurface(yard, T_world_map, 4.0).compare(voxel_map, poses, 3)

    visible = visible_surface(yard, 4.0).points
    expected = ((np.abs(visible[:, 2]) < 0.04) & (visible[:, 1] < 0.0)).mean()
    assert truth.true_coverage == pytest.approx(expected, abs=0.02)
    within = (truth.within_1_sigma, truth.within_2_sigma, truth.within_3_sigma)
    np.testing.assert_allclose(within, (1 / 3, 2 / 3, 1.0), atol=0.02)
    assert truth.pose_nees == pytest.approx(4.0 * (3.0 + 0.14) / 6.0, abs=1e-3)
    assert truth.contacts == 3
    assert truth.figures()["map_error_median"] == pytest.approx(1.5 * sigma, abs=5e-4)


def test_an_empty_map_has_no_share_within_its_sigma(yard: World) -> None:
    truth = TrueSurface(yard, np.eye(4), 4.0).compare(VoxelMap(VoxelMapConfig()), [], 0)
    assert (truth.true_coverage, truth.within_1_sigma, truth.pose_nees) == (0.0, None, None)
    assert "coverage 0.0 %" in str(truth)


def test_of_many_points_some_are_kept_by_chance(yard: World) -> None:
    everything = visible_surface(yard, 4.0, VISIBLE, REACH)
    some = visible_surface(yard, 4.0, dataclasses.replace(VISIBLE, max_points=1500), REACH)
    assert 1000 < len(some.points) < 1500 < len(everything.points)
    on_ground = [(surface.points[:, 2] < 0.01).mean() for surface in (everything, some)]
    assert on_ground[0] == pytest.approx(on_ground[1], abs=0.05)


def test_a_world_without_bounds_is_refused(world: World) -> None:
    with pytest.raises(SimulationError, match="region"):
        standable_places(world)
