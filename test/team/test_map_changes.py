"""What has changed between two maps of a room, against what was moved in it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    Box,
    PinholeCamera,
    PlacedSolid,
    PoseUncertainty,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.noisy_scans import AnalyticScene, RangeNoise
from infomap_ros.team.map_changes import APPEARED, VANISHED, MapChanges, changes_between
from infomap_ros.team.merging import NamedMap
from infomap_ros.team.registration import Registration

from ..mapping.scenes import look_at

SIZE = 0.05
CAMERA = PinholeCamera(128, 96, 80.0, 80.0, 63.5, 47.5)
NOISE = RangeNoise(along=0.003, across=0.001)
WALLS = np.array(
    [
        (0.0, 0.0, 1.0, 0.0),
        *((1.0, 0.0, 0.0, -2.0), (-1.0, 0.0, 0.0, -2.0)),
        *((0.0, 1.0, 0.0, -1.6), (0.0, -1.0, 0.0, -1.6)),
    ]
)
TABLE = [(-1.3, -0.9, 0.35, 0.9, 0.6, 0.7)]  # x, y, z of the middle, and sides [m]
BOX = (0.9, 0.6, 0.2, 0.4, 0.4, 0.4)
MOVED_BOX = (0.9, -0.5, 0.2, 0.4, 0.4, 0.4)
CHAIR = [
    (-0.6, 0.8, 0.44, 0.42, 0.42, 0.06),
    (-0.6, 1.0, 0.7, 0.42, 0.05, 0.5),
    *((-0.6 + x, 0.8 + y, 0.2, 0.05, 0.05, 0.42) for x in (-0.18, 0.18) for y in (-0.18, 0.18)),
]
MISPLACED = 0.01, 0.001  # [m], [rad]


def room(*boxes: tuple[float, float, float, float, float, float]) -> AnalyticScene:
    solids = [
        PlacedSolid(Box(box[3:]), make_transform(np.eye(3), box[:3]), f"box {number}")
        for number, box in enumerate((*TABLE, *boxes))
    ]
    return AnalyticScene(WALLS, solids)


def looks(
    voxel_map: VoxelMap,
    scene: AnalyticScene,
    seed: int,
    T_map_world: FloatArray | None = None,
    offset: FloatArray | None = None,
    ends: tuple[float, float] = (-1.0, 1.0),
) -> VoxelMap:
    """Look all around from places along the room's middle.

    Args:
        voxel_map: to which the scans are added.
        scene: what is seen.
        seed: of places, directions and noise.
        T_map_world: where the world lies in the map.
        offset: covariance of that, which the map's scans share.
        ends: of the places along x [m].
    """
    rng = np.random.default_rng(seed)
    T = np.eye(4) if T_map_world is None else T_map_world
    for x in np.linspace(*ends, 5):
        place = np.array([x, 0.0, 1.3]) + rng.uniform(-0.1, 0.1, 3)
        for yaw in np.arange(10) * np.pi / 5.0 + rng.uniform(-0.2, 0.2):
            ahead = [np.cos(yaw), np.sin(yaw), -rng.uniform(0.2, 0.8)]
            pose = look_at(place, place + ahead)
            points, covariances = NOISE.measure(scene.depth_image(pose, CAMERA), CAMERA, rng)
            known = PoseUncertainty(
                1e-8 * np.eye(6), offset=np.zeros((6, 6)) if offset is None else offset
            )
            voxel_map.integrate(points, T @ pose, covariances, known, camera=CAMERA)
    return voxel_map


def new_map() -> VoxelMap:
    return VoxelMap(VoxelMapConfig(voxel_size=SIZE, max_range=6.0))


@cache
def monday() -> VoxelMap:
    return looks(new_map(), room(BOX, *CHAIR), 1)


@cache
def tuesday() -> VoxelMap:
    """The box was moved, the chair was removed."""
    return looks(new_map(), room(MOVED_BOX), 2)


def compared(old: VoxelMap, new: VoxelMap, where: Registration | None = None) -> MapChanges:
    return changes_between(NamedMap("old", old), NamedMap("new", new), where)


def changed_voxels(found: MapChanges) -> int:
    return len(found.appeared.points) + len(found.vanished.points)


def assert_about(box: FloatArray, truth: tuple[float, ...], of: tuple[float, ...]) -> None:
    """A box is that of the truth by a voxel, but for three above the floor.

    There the other map knows little to be free.
    """
    middle, sides = np.array(truth), np.array(of)
    low, high = middle - 0.5 * sides, middle + 0.5 * sides
    np.testing.assert_allclose(box[1], high, atol=1.01 * SIZE)
    np.testing.assert_allclose(box[0, :2], low[:2], atol=1.01 * SIZE)
    assert low[2] - 0.01 <= box[0, 2] <= low[2] + 3.01 * SIZE


def assert_box_and_chair(found: MapChanges) -> None:
    appeared = [each for each in found.objects if each.what == APPEARED]
    vanished = sorted(
        (each for each in found.objects if each.what == VANISHED), key=lambda each: each.box[0, 0]
    )
    assert len(appeared) == 1
    assert len(vanished) == 2
    assert_about(appeared[0].box, MOVED_BOX[:3], MOVED_BOX[3:])
    assert_about(vanished[0].box, (-0.6, 0.807, 0.475), (0.42, 0.435, 0.95))
    assert_about(vanished[1].box, BOX[:3], BOX[3:])
    for each in found.objects:
        assert each.probability >= 0.95


def test_what_was_moved_and_removed_is_found_and_nothing_else() -> None:
    found = compared(monday(), tuesday())
    assert_box_and_chair(found)
    assert found.scattered <= 3


def test_the_area_is_that_of_the_sides_above_the_floor() -> None:
    found = compared(monday(), tuesday())
    (box,) = (each for each in found.objects if each.what == APPEARED)
    # A top of 0.4 x 0.4 m and four sides, of which up to three voxels are too near to the floor.
    assert 0.16 + 4 * 0.4 * (0.4 - 3 * SIZE) - 0.1 <= box.surface <= 0.16 + 4 * 0.16


@pytest.mark.parametrize("seed", [3, 4])
def test_where_nothing_changed_nothing_is_found(seed: int) -> None:
    found = compared(monday(), looks(new_map(), room(BOX, *CHAIR), seed))
    assert changed_voxels(found) == 0
    for side in (found.appeared, found.vanished):
        assert side.compared >= 0.9 * side.surface_voxels


def misplaced(sigmas: tuple[float, float], seed: int) -> tuple[FloatArray, FloatArray]:
    """An error of these standard deviations along each axis, and its covariance."""
    rng = np.random.default_rng(seed)
    step, turn = sigmas[0] * rng.choice((-1.0, 1.0), 3), sigmas[1] * rng.choice((-1.0, 1.0), 3)
    error = make_transform(Rotation.from_rotvec(turn).as_matrix(), step)
    return error, np.diag([sigmas[0] ** 2] * 3 + [sigmas[1] ** 2] * 3)


def test_an_error_of_registration_is_no_change() -> None:
    for seed in (5, 6):
        error, covariance = misplaced(MISPLACED, seed)
        moved = looks(new_map(), room(BOX, *CHAIR), seed, error)
        where = Registration(np.eye(4), covariance, 0, 0, 0)
        assert changed_voxels(compared(monday(), moved, where)) == 0


def test_an_error_that_a_map_shares_is_no_change() -> None:
    error, covariance = misplaced(MISPLACED, 7)
    moved = looks(new_map(), room(BOX, *CHAIR), 7, error, covariance)
    moved.origin = 7
    other = looks(new_map(), room(BOX, *CHAIR), 1)
    assert changed_voxels(compared(other, moved)) == 0


def test_a_large_error_is_a_change_unless_its_covariance_says_so() -> None:
    error, covariance = misplaced((0.12, 0.005), 8)
    moved = looks(new_map(), room(BOX, *CHAIR), 8, error)
    assert changed_voxels(compared(monday(), moved)) > 100
    where = Registration(np.eye(4), covariance, 0, 0, 0)
    assert changed_voxels(compared(monday(), moved, where)) == 0


def test_what_moved_is_found_in_a_map_with_another_frame() -> None:
    turn = Rotation.from_euler("zyx", (2.1, 0.05, -0.04)).as_matrix()
    T_old_new = make_transform(turn, (3.0, -2.0, 0.4))
    new = looks(new_map(), room(MOVED_BOX), 2, invert_transform(T_old_new))
    covariance = np.diag([0.002**2] * 3 + [0.0005**2] * 3)
    # The covariance is that at the new frame's origin, 3.6 m away.
    assert_box_and_chair(compared(monday(), new, Registration(T_old_new, covariance, 0, 0, 0)))


def test_a_map_that_went_on_is_compared_by_what_it_saw_since() -> None:
    saved = looks(new_map(), room(BOX, *CHAIR), 1)
    resumed = VoxelMap.from_state(saved.config, saved.state())
    resumed.sessions, resumed.origin = saved.sessions, saved.origin
    looks(resumed, room(MOVED_BOX), 2)
    assert_box_and_chair(compared(saved, resumed))
    same = VoxelMap.from_state(saved.config, saved.state())
    same.sessions = saved.sessions
    looks(same, room(BOX, *CHAIR), 9)
    found = compared(saved, same)
    assert changed_voxels(found) == 0
    assert found.vanished.compared >= 0.9 * found.vanished.surface_voxels


def test_what_was_not_looked_at_is_not_compared() -> None:
    """Of a wall that the other map did not see it is not said that it vanished."""
    scene = room(BOX)
    old, new = new_map(), new_map()
    for voxel_map, targets, seed in ((old, (1.0, -1.0), 1), (new, (1.0,), 2)):
        rng = np.random.default_rng(seed)
        for target in targets:
            for side in np.linspace(-0.8, 0.8, 7):
                place = np.array([0.0, 0.3 * side, 1.2]) + rng.uniform(-0.05, 0.05, 3)
                pose = look_at(place, [2.0 * target, side, 0.5])
                points, covariances = NOISE.measure(scene.depth_image(pose, CAMERA), CAMERA, rng)
                voxel_map.integrate(points, pose, covariances, camera=CAMERA)
    found = compared(old, new)
    assert changed_voxels(found) == 0
    assert found.appeared.compared >= 0.9 * found.appeared.surface_voxels
    assert 0.3 <= found.vanished.compared / found.vanished.surface_voxels <= 0.7


def test_one_look_is_not_enough() -> None:
    """Neither as a surface nor as free space, from one place."""
    rng, pose = (
        np.random.default_rng(0),
        look_at(np.array([0.0, 0.0, 1.2]), np.array([0.9, -0.5, 0.2])),
    )
    once = new_map()
    points, covariances = NOISE.measure(room(MOVED_BOX).depth_image(pose, CAMERA), CAMERA, rng)
    once.integrate(points, pose, covariances, camera=CAMERA)
    assert changed_voxels(compared(monday(), once)) == 0


def test_maps_that_cannot_be_compared_are_refused() -> None:
    coarse = VoxelMap(VoxelMapConfig(voxel_size=0.2))
    with pytest.raises(InvalidInputError, match=r"old and new: have voxels of 0\.05 m and 0\.2 m"):
        compared(monday(), coarse)
    with pytest.raises(InvalidInputError, match="the same session"):
        compared(monday(), monday())
    other = looks(new_map(), room(), 11, ends=(0.0, 0.1))
    other.origin = 11
    first = VoxelMap.from_state(other.config, other.state())
    first.origin, first.sessions = 12, (12,)
    with pytest.raises(InvalidInputError, match="other origins"):
        compared(first, other)


def test_empty_maps_have_no_changes() -> None:
    found = compared(monday(), new_map())
    assert (changed_voxels(found), found.vanished.compared, found.objects) == (0, 0, ())
