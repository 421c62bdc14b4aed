"""Maps without a common frame: found, or refused where they can lie in two ways or in none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    Box,
    PinholeCamera,
    PlacedSolid,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.noisy_scans import AnalyticScene
from infomap_ros.team.merging import NamedMap, aligned_maps, merge_maps
from infomap_ros.team.registration import register_maps

pytest.importorskip("kiss_matcher")
pytest.importorskip("small_gicp")

CAMERA = PinholeCamera(96, 72, 60.0, 60.0, 47.5, 35.5)
CONFIG = VoxelMapConfig(voxel_size=0.08, max_range=6.0)
FLOOR = (0.0, 0.0, 1.0, 0.0)
T_A_B = make_transform(Rotation.from_euler("zyx", (2.1, 0.05, -0.04)).as_matrix(), (3.0, -7.0, 0.4))


def room(width: float, depth: float, *boxes: tuple[float, ...]) -> AnalyticScene:
    """Four walls about (0, 0) and boxes (x, y, z, side x, side y, side z, yaw)."""
    walls = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]
    halves = [width / 2, width / 2, depth / 2, depth / 2]
    planes = [FLOOR, *((*n, -half) for n, half in zip(walls, halves, strict=True))]
    solids = [
        PlacedSolid(
            Box(box[3:6]),  # type: ignore[arg-type]
            make_transform(Rotation.from_euler("z", box[6]).as_matrix(), box[:3]),
            f"box {number}",
        )
        for number, box in enumerate(boxes)
    ]
    return AnalyticScene(np.array(planes), solids)


def looks(scene: AnalyticScene, xs: tuple[float, ...], *places: FloatArray) -> VoxelMap:
    """Map of looks all around from places along the x axis, 1.2 m above the floor.

    Args:
        scene: what is seen.
        xs: of the places [m].
        places: T_map_world, more than one where the map holds the scene more than once.
    """
    voxel_map, rng = VoxelMap(CONFIG), np.random.default_rng(len(xs))
    for x in xs:
        for yaw in np.arange(8) * np.pi / 4.0:
            forward = np.array([np.cos(yaw), np.sin(yaw), -0.35])
            forward /= np.linalg.norm(forward)
            right = np.cross(forward, (0.0, 0.0, 1.0))
            right /= np.linalg.norm(right)
            turn = np.stack([right, np.cross(forward, right), forward], axis=1)
            pose = make_transform(turn, (x, 0.1, 1.2))
            depth = scene.depth_image(pose, CAMERA)
            points = CAMERA.back_project(depth * rng.normal(1.0, 0.003, depth.shape))
            for T_map_world in places:
                voxel_map.integrate(points, T_map_world @ pose, camera=CAMERA)
    return voxel_map


FURNISHED = room(
    7.0, 4.4,
    (1.2, 1.5, 0.4, 1.4, 0.7, 0.8, 0.2), (-1.6, -1.3, 0.6, 0.5, 1.1, 1.2, 0.0),
    (2.9, -0.9, 0.9, 0.4, 0.9, 1.8, 0.0), (-2.6, 1.4, 0.3, 0.8, 0.8, 0.6, 0.7),
    (0.3, -1.7, 0.25, 0.6, 0.4, 0.5, -0.4),
)  # fmt: skip


def test_a_map_is_found_in_another_one() -> None:
    first = looks(FURNISHED, (-1.5, 0.0), np.eye(4))
    second = looks(FURNISHED, (0.2, 1.4), invert_transform(T_A_B))
    ((moved, found),) = aligned_maps([NamedMap("a", first), NamedMap("b", second)])
    turn = Rotation.from_matrix(T_A_B[:3, :3] @ found.T_first_second[:3, :3].T).as_rotvec()
    error = np.append(T_A_B[:3, 3] - found.T_first_second[:3, 3], turn)
    at_room = error[:3] - np.cross(turn, T_A_B[:3, 3])  # the middle of the room is the origin
    assert np.linalg.norm(at_room) < 0.25 * CONFIG.voxel_size
    assert np.linalg.norm(turn) < 0.01
    assert error @ np.linalg.solve(found.covariance, error) < 16.8  # 99 % of chi squared of 6
    whole, agreement = merge_maps([NamedMap("a", first), moved], has_common_frame=True)
    assert agreement.contradicted < 0.01 * agreement.compared
    assert whole.known_voxels > 1.05 * first.known_voxels
    assert whole.sessions == tuple(sorted({*first.sessions, *second.sessions}))


def test_what_is_found_does_not_depend_on_the_frame() -> None:
    first = looks(FURNISHED, (-1.0, 1.0), np.eye(4))
    second = looks(FURNISHED, (0.0,), np.eye(4))
    third = looks(FURNISHED, (0.0,), invert_transform(T_A_B))
    one, other = (register_maps(first, voxel_map) for voxel_map in (second, third))
    np.testing.assert_allclose(
        other.T_first_second @ invert_transform(T_A_B), one.T_first_second, atol=0.03
    )


def test_a_room_that_looks_alike_both_ways_is_refused() -> None:
    plain = room(
        6.0, 4.0, (1.5, 1.0, 0.5, 1.0, 0.6, 1.0, 0.0), (-1.5, -1.0, 0.5, 1.0, 0.6, 1.0, 0.0)
    )
    first = looks(plain, (-0.5, 0.5), np.eye(4))
    second = looks(plain, (-0.4, 0.6), invert_transform(T_A_B))
    with pytest.raises(InvalidInputError, match=r"in two ways.* 180 degrees apart"):
        register_maps(first, second)


def test_a_room_of_which_there_are_two_is_refused() -> None:
    aside = make_transform(np.eye(3), (20.0, 0.0, 0.0))
    first = looks(FURNISHED, (-1.5, 0.0, 1.5), np.eye(4), aside)
    second = looks(FURNISHED, (-0.5, 1.0), invert_transform(T_A_B))
    with pytest.raises(InvalidInputError, match=r"in two ways.* 20\.0 m and 0 degrees apart"):
        register_maps(first, second)


def test_other_rooms_are_refused() -> None:
    first = looks(FURNISHED, (-1.5, 0.0, 1.5), np.eye(4))
    other = room(
        4.6, 5.8, (1.0, -1.6, 0.7, 1.2, 0.5, 1.4, 0.5), (-1.2, 1.9, 0.3, 0.9, 1.3, 0.6, 1.0)
    )
    second = looks(other, (-0.7, 0.7), np.eye(4))
    with pytest.raises(InvalidInputError, match="b: and those before it"):
        aligned_maps([NamedMap("a", first), NamedMap("b", second)])


def test_maps_that_cannot_be_joined_are_refused_before_they_are_registered() -> None:
    """Also by those that would be reached last."""
    coarse = VoxelMap(VoxelMapConfig(voxel_size=0.2))
    empty = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    with pytest.raises(InvalidInputError, match=r"voxels of 0\.1 m and 0\.2 m"):
        aligned_maps([NamedMap("a", empty), NamedMap("b", empty), NamedMap("c", coarse)])


def test_a_map_of_next_to_nothing_is_refused() -> None:
    whole = looks(FURNISHED, (0.0,), np.eye(4))
    with pytest.raises(InvalidInputError, match="has 0 surface voxels"):
        register_maps(whole, VoxelMap(CONFIG))
