"""Teammates are cut from scans: no voxel of them is left, and little else is lost."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.team import teammate_places
from infomap_ros.exploration.team.teammate_places import TeamBodies, on_bodies
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PoseRecord,
    invert_transform,
    make_transform,
    perturb_transform,
    points_inside,
    transform_points,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.mapping import OCCUPIED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import body_extent
from infomap_ros.team.agents import Agent

CAMERA = PinholeCamera(64, 48, 48.0, 48.0, 31.5, 23.5)
COVARIANCES = np.broadcast_to(np.float32(1e-6) * np.eye(3, dtype=np.float32), (48, 64, 3, 3))
WALL, FLOOR = 4.0, -0.08  # x of a wall, z of the floor [m]
# Level, looking along x from 0.7 m above the floor.
LOOKING = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.0, 0.0, 0.62))
MS = 1_000_000
Joints = dict[str, float]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(find_share("config/rover.urdf"), base_frame="base_link")


def place(milliseconds: float) -> tuple[np.ndarray, float]:
    """Where the teammate truly is: it drives a curve at up to 0.5 m/s; and how its arm stands."""
    t = milliseconds / 1000.0
    yaw = 0.6 * t
    rotation = np.array(
        [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]]
    )
    return make_transform(rotation, (1.9, -0.5 + 0.4 * t, 0.0)), 0.5 * np.sin(t)


def joints_of(robot: RobotModel, angle: float) -> Joints:
    return {joint.name: angle if "arm" in joint.name else 0.0 for joint in robot.joints}


def told(
    robot: RobotModel,
    milliseconds: int,
    version: int,
    error: float = 0.0,
    sigma: float | None = None,
) -> Agent:
    """What the teammate tells of itself.

    Args:
        error: of its pose along x and y [m].
        sigma: standard deviation that it claims [m]; that error, if it is not given.
    """
    base, angle = place(milliseconds)
    base = perturb_transform(base, [error, error, 0.0, 0.0, 0.0, 0.0])
    joints = joints_of(robot, angle)
    radius, bottom, top = body_extent(robot, joints)
    claimed = max(error, 0.002) if sigma is None else sigma
    covariance = np.diag([claimed**2] * 3 + [1e-6] * 3)
    return Agent(
        2, 1, version, milliseconds * MS, milliseconds * MS, base, base, covariance, CAMERA, 4.0,
        joints=joints, radius=radius, bottom=bottom, top=top, base_frame="base_link",
    )  # fmt: skip


def true_body(robot: RobotModel, milliseconds: float) -> list[PlacedSolid]:
    base, angle = place(milliseconds)
    solids = robot.solids_in("base_link", joints_of(robot, angle))
    return [PlacedSolid(s.solid, base @ s.transform, s.name) for s in solids]


def distance_to(points: np.ndarray, solids: list[PlacedSolid]) -> np.ndarray:
    """Distance of points, (N, 3), to the nearest solid, negative inside, (N,)."""
    gaps = [
        s.solid.signed_distance((points - s.transform[:3, 3]) @ s.transform[:3, :3]) for s in solids
    ]
    return np.min(gaps, axis=0)


def scan_of(solids: list[PlacedSolid]) -> np.ndarray:
    """What the camera measures of wall, floor and solids, by sphere tracing, (48, 64, 3)."""
    rays = CAMERA.back_project(np.ones((48, 64))).astype(np.float64).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    directions = (rays / lengths[:, None]) @ LOOKING[:3, :3].T
    origin = LOOKING[:3, 3]
    with np.errstate(divide="ignore"):
        ends = np.stack(
            [(WALL - origin[0]) / directions[:, 0], (FLOOR - origin[2]) / directions[:, 2]]
        )
    end = np.where(ends > 0.0, ends, np.inf).min(axis=0)
    depth = np.zeros(len(rays))
    for _ in range(40 if solids else 0):
        depth += np.maximum(distance_to(origin + depth[:, None] * directions, solids), 0.0)
        depth = np.minimum(depth, end)
    depth = depth if solids else end
    return (rays / lengths[:, None] * depth[:, None]).reshape(48, 64, 3).astype(np.float32)


def pose_at(milliseconds: int) -> PoseRecord:
    return PoseRecord(milliseconds * MS, "map", LOOKING, 1e-6 * np.eye(6))


@cache
def seen_at(robot: RobotModel, time: int) -> tuple[np.ndarray, np.ndarray]:
    """The scan at a time, and which of its points are not on the teammate, (N,)."""
    solids = true_body(robot, time)
    points = scan_of(solids)
    in_map = points.reshape(-1, 3) @ LOOKING[:3, :3].T + LOOKING[:3, 3]
    return points, distance_to(in_map, solids) > 0.03


def occupied_near(voxel_map: VoxelMap, robot: RobotModel, times: list[int]) -> int:
    """Occupied voxels within 5 cm of where the teammate ever was, but for floor and wall."""
    window = voxel_map.window(np.array([0.5, -2.0, FLOOR + 0.08]), np.array([WALL - 0.2, 2.0, 1.5]))
    centers = window.centers_of(np.argwhere(window.states() == OCCUPIED))
    near = [distance_to(centers, true_body(robot, t)) < 0.05 for t in times]
    return int(np.any(near, axis=0).sum()) if len(centers) else 0


SCANS = [130, 260, 430, 590, 750, 910]
TOLD = list(range(0, 1200, 200))


def mapped(
    robot: RobotModel, bodies: TeamBodies | None, times: list[int]
) -> tuple[VoxelMap, float]:
    """The map after scans, and the share of points of wall and floor that were kept."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=5.0))
    kept, all_others = 0, 0
    for time in times:
        points, others = seen_at(robot, time)
        if bodies is not None:
            found = bodies.bodies_in(pose_at(time))
            mask = on_bodies(points, COVARIANCES, found, BodyFilterConfig())
            points = np.where(mask[..., None], np.float32(np.nan), points)
        kept += int((np.isfinite(points[..., 0]).ravel() & others).sum())
        all_others += int(others.sum())
        voxel_map.integrate(points, LOOKING, camera=CAMERA)
        voxel_map.integrate(points, LOOKING, camera=CAMERA)
    return voxel_map, kept / all_others


def heard(
    robot: RobotModel, error: float = 0.0, described: bool = True, sigma: float | None = None
) -> TeamBodies:
    bodies = TeamBodies()
    for version, time in enumerate(TOLD, 1):
        bodies.receive(told(robot, time, version, error, sigma))
    if described:
        bodies.describe(2, robot)
    return bodies


@pytest.mark.parametrize("times", [[430] * 4, SCANS], ids=["standing", "moving"])
def test_a_teammate_in_view_leaves_no_voxel(robot: RobotModel, times: list[int]) -> None:
    before, _ = mapped(robot, None, times)
    after, kept = mapped(robot, heard(robot), times)
    assert occupied_near(before, robot, times) > 30
    assert occupied_near(after, robot, times) == 0
    assert kept > 0.95


def test_nor_does_one_whose_pose_is_wrong_by_what_it_says(robot: RobotModel) -> None:
    after, kept = mapped(robot, heard(robot, error=0.05), SCANS)
    assert occupied_near(after, robot, SCANS) == 0
    assert kept > 0.8
    wrong, _ = mapped(robot, heard(robot, error=0.05, sigma=1e-4), SCANS)
    assert occupied_near(wrong, robot, SCANS) > 0, "it is the covariance that does it"


def test_nor_does_one_whose_solids_are_not_known(robot: RobotModel) -> None:
    after, kept = mapped(robot, heard(robot, described=False), SCANS)
    assert occupied_near(after, robot, SCANS) == 0
    assert kept > 0.5


def test_nor_does_one_that_was_last_heard_a_while_ago(robot: RobotModel) -> None:
    """It has told where it was at 0 and 200 ms, and drives on."""
    bodies = TeamBodies()
    bodies.describe(2, robot)
    for version, time in enumerate((0, 200), 1):
        bodies.receive(told(robot, time, version))
    after, _ = mapped(robot, bodies, SCANS)
    assert occupied_near(after, robot, SCANS) == 0


def test_the_body_grows_with_the_time_for_which_its_place_is_not_known(
    robot: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(teammate_places, "_MAX_GROWTH", 0.3)
    bodies = TeamBodies()
    bodies.describe(2, robot)
    bodies.receive(told(robot, 0, 1))
    margins = [bodies.bodies_in(pose_at(time))[0].margin for time in (0, 200, 400, 600, 5000)]
    np.testing.assert_allclose(np.diff(margins), [0.14, 0.14, 0.02, 0.0], atol=1e-9)
    sure = [bodies.bodies_in(pose_at(time))[0].is_sure for time in (0, 200)]
    assert sure == [True, False]


def test_between_two_messages_its_place_is_interpolated(robot: RobotModel) -> None:
    (body,) = heard(robot).bodies_in(pose_at(430))
    expected = true_body(robot, 430)
    for solid, true in zip(body.solids, expected, strict=True):
        placed = LOOKING @ solid.transform
        np.testing.assert_allclose(placed[:3, 3], true.transform[:3, 3], atol=0.004)


def test_who_has_not_moved_was_there_all_the_time(robot: RobotModel) -> None:
    bodies = TeamBodies()
    bodies.describe(2, robot)
    bodies.receive(told(robot, 0, 1))
    bodies.receive(replace(told(robot, 3000, 2), since=1000 * MS))
    sure = [bodies.bodies_in(pose_at(time))[0].is_sure for time in (900, 1000, 2000, 3000, 3100)]
    assert sure == [False, True, True, True, False]
    bodies.check_known_at(2000 * MS, 2000 * MS, [2])


def test_a_scan_waits_for_what_may_still_be_told(robot: RobotModel) -> None:
    bodies = heard(robot)
    bodies.check_known_at(900 * MS, 900 * MS, [2])
    with pytest.raises(PoseUnavailableError, match="robot 2") as error:
        bodies.check_known_at(1100 * MS, 1500 * MS, [2])
    assert error.value.may_arrive
    bodies.check_known_at(1100 * MS, 1600 * MS, [2])
    bodies.check_known_at(1100 * MS, 1500 * MS, [])
    bodies.check_known_at(1100 * MS, 1500 * MS, [7])


def test_who_is_forgotten_is_not_cut(robot: RobotModel) -> None:
    bodies = heard(robot)
    bodies.keep([2, 3])
    assert len(bodies.bodies_in(pose_at(400))) == 1
    bodies.keep([3])
    assert bodies.bodies_in(pose_at(400)) == [] and not bodies.is_described(2)


def points_in(placed: PlacedSolid, rng: np.random.Generator) -> np.ndarray:
    """Points of a solid, in the frame in which it is placed."""
    points = rng.normal(size=(300, 3))
    points *= placed.solid.bounding_radius / np.linalg.norm(points, axis=1, keepdims=True)
    points *= rng.random((300, 1))
    points = points[placed.solid.signed_distance(points) <= 0.0]
    return transform_points(placed.transform, points)


def test_the_cylinder_holds_the_body_in_any_posture(robot: RobotModel) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        joints = {
            j.name: float(rng.uniform(max(j.lower, -3), min(j.upper, 3))) for j in robot.joints
        }
        radius, bottom, top = body_extent(robot, joints)
        for placed in robot.solids_in("base_link", joints):
            at = points_in(placed, rng)
            assert np.hypot(at[:, 0], at[:, 1]).max(initial=0.0) <= radius + 1e-9
            assert (at[:, 2] >= bottom - 1e-9).all() and (at[:, 2] <= top + 1e-9).all()


@pytest.mark.parametrize("milliseconds", [400, 600, 1400])
@pytest.mark.parametrize("error", [0.0, 0.05])
def test_it_is_within_its_cylinder_in_the_map(
    robot: RobotModel, milliseconds: int, error: float
) -> None:
    """Between two messages and 0.4 s after the last, with an error that it tells of."""
    cylinder, rng = heard(robot, error).about(milliseconds * MS), np.random.default_rng(3)
    points = np.concatenate([points_in(one, rng) for one in true_body(robot, milliseconds)])
    assert points_inside(points, cylinder, LocalizerConfig().body.margin).all()
    beside = points + np.array([0.0, 3.0, 0.0])
    assert len(cylinder) == 1 and not points_inside(beside, cylinder).any()


def test_who_is_silent_does_not_take_all_the_room(robot: RobotModel) -> None:
    (soon,), (late,) = (heard(robot).about(ms * MS) for ms in (1100, 60_000))
    assert 0.1 < late.solid.radius - soon.solid.radius < 0.25


def test_nothing_is_cut_where_no_teammate_is_in_view(robot: RobotModel) -> None:
    points = scan_of([])
    turned = LOOKING @ invert_transform(make_transform(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)))
    camera = replace(pose_at(400), transform=turned)
    found = heard(robot).bodies_in(camera)
    assert not on_bodies(points, None, found, BodyFilterConfig()).any()
