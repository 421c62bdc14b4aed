"""The planner of views: what it does when no view can be reached, and after one could not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.exploration.robot import FailedView, KnownPlace, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_choice import ViewChoice
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera, Polygon, StereoRig, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.state import (
    VoxelStates,
    information_of,
    put_states,
    unknown_states,
)
from infomap_ros.motion.keep_out import KeepOut
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ReachResult
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.views.next_best_view import NextBestViewConfig
from infomap_ros.views.ranking.rating import RatingConfig

CAMERA = PinholeCamera(160, 120, 110.0, 110.0, 79.5, 59.5)
TASK = TaskConfig(region_low=(-1.4, -1.4, -0.3), region_high=(1.4, 1.4, 1.0))
ROUNDS = 3


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    description = read_description(find_share("config/rover.urdf"))
    return RobotModel.from_urdf(description, "left_camera_optical_frame", "base_link")


@pytest.fixture
def half_known() -> VoxelMap:
    """Nothing is known where x < -0.5 m."""
    return box_of_voxels(known_from=-10, sigma=0.001)


def box_of_voxels(known_from: int, sigma: float) -> VoxelMap:
    """Even ground at z = 0 in a box of 3 x 3 m, seen up to 1.3 m, known from a voxel along x.

    Args:
        known_from: index of the first known voxel along x; the box begins at -30.
        sigma: of the ground, upright [m].
    """
    voxel_map = VoxelMap()
    size, first = voxel_map.config.voxel_size, np.int32((known_from, -30, -1))
    indices = np.indices((30 - known_from, 60, 27), np.int32).reshape(3, -1).T + first
    quanta = np.where(indices[:, 2] < 0, 20, -20).astype(np.int32)
    ground = indices[:, 2] == -1
    covariances = np.tile(np.diag((0.02, 0.02, sigma)) ** 2, (len(indices), 1, 1))
    gaussians = information_of(indices, ground, (indices + 0.5) * size, covariances, size)
    known = np.ones(len(indices), bool)
    put_states(voxel_map._storage, VoxelStates(indices, known, quanta, gaussians))
    return voxel_map


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The views that are asked for, of a robot that reaches none of them."""
    views: list[np.ndarray] = []

    def refuse(self: WholeBodyReach, T_map_camera: np.ndarray) -> ReachResult:
        views.append(T_map_camera)
        return ReachResult("the road is closed")

    monkeypatch.setattr(WholeBodyReach, "reach", refuse)
    return views


def planner_of(
    robot: RobotModel,
    task: TaskConfig = TASK,
    thorough: float = 1.0,
    choice: NextBestViewConfig | None = None,
) -> ViewPlanner:
    return ViewPlanner(
        robot,
        StereoRig(CAMERA, CAMERA, 0.1),
        task,
        ViewPlannerConfig(
            choice=choice or NextBestViewConfig(),
            arm_views=40,
            rounds=ROUNDS,
            threads=1,
            thorough=thorough,
        ),
    )


def standing(robot: RobotModel) -> RobotState:
    joints = {joint.name: 0.0 for joint in robot.joints}
    T_map_base = make_transform(np.eye(3), (0.3, 0.0, 0.09))
    T_base_camera = robot.forward_kinematics(joints, robot.camera_frame)
    return RobotState(T_map_base, T_map_base @ T_base_camera, 1e-6 * np.eye(6), joints)


def test_draws_others_when_no_view_can_be_reached(robot, half_known, tried):
    choice = planner_of(robot).choose(half_known, standing(robot))
    assert choice.pose is None and choice.route is None
    assert "the road is closed" in choice.reason
    one_round = NextBestViewConfig().selection.attempts
    assert one_round < len(tried) <= ROUNDS * one_round


def test_views_that_were_not_reached_are_not_tried_again(robot, half_known, tried):
    planner = planner_of(robot)
    planner.choose(half_known, standing(robot))
    first = len(tried)
    choice = planner.choose(half_known, standing(robot))
    again = [v for v in tried[first:] if any(np.array_equal(v, old) for old in tried[:first])]
    assert not again
    assert any("unreachable before" in reason for reason in choice.explanation["rejections"])


@pytest.mark.parametrize(("wanted", "looks"), [(0.05, False), (0.002, True)])
def test_looks_again_at_surfaces_that_are_not_precise_enough(robot, wanted, looks):
    """All is known, with the ground within 2 cm."""
    voxel_map = box_of_voxels(known_from=-30, sigma=0.02)
    task = dataclasses.replace(TASK, surface_sigma=wanted)
    choice = planner_of(robot, task).choose(voxel_map, standing(robot))
    assert (choice.pose is not None) == looks


@pytest.mark.parametrize(("weight", "looks"), [(1.0, False), (2.0, True)])
def test_looks_again_where_a_place_of_interest_is_not_precise_enough(robot, weight, looks):
    """All is known, with the ground within 2 cm, which suffices everywhere else."""
    voxel_map = box_of_voxels(known_from=-30, sigma=0.02)
    task = dataclasses.replace(
        TASK,
        surface_sigma=0.05,
        interest_sigma=0.002,
        interests=(0.9, 0.0, 0.0, 0.6, weight),
        known_fraction=0.9,
    )
    planner = planner_of(robot, task)
    choice = planner.choose(voxel_map, standing(robot))
    assert (choice.pose is not None) == looks
    assert choice.progress.precise_fraction > 0.9
    assert choice.progress.interest_fraction == (0.0 if looks else 1.0)
    assert planner.is_done(choice.progress) != looks
    if looks:  # at what it looks
        origin, direction = choice.pose[:3, 3], choice.pose[:3, 2]
        ground = origin + direction * (origin[2] / -direction[2])
        assert np.linalg.norm(ground[:2] - (0.9, 0.0)) < 0.6


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("interests", {"interests": (1.0, 0.0, 0.0, 0.5)}),
        ("interests", {"interests": (1.0, 0.0, 0.0, -0.5, 2.0)}),
        ("interests", {"interests": (1.0, 0.0, 0.0, 0.5, -1.0)}),
        ("interest_sigma", {"surface_sigma": 0.01, "interest_sigma": 0.02}),
    ],
)
def test_impossible_places_of_interest_are_named(name, values):
    with pytest.raises(ConfigError, match=name):
        TaskConfig(**values)


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("keep_out", {"keep_out": ("stairs: 0 0 1 0",)}, "2 corners"),
        ("keep_out", {"keep_out": ("stairs: 0 0 1 0 1",)}, "5 numbers are not pairs"),
        ("keep_out", {"keep_out": ("stairs: 0 0 1 0 1 nan",)}, "not finite"),
        ("keep_out", {"keep_out": ("stairs: 0 0 1 1 1 0 0 1",)}, "crosses or touches itself"),
        ("keep_out", {"keep_out": ("stairs: 0 0 1 0 1 wide",)}, "wide"),
        ("keep_out", {"keep_out": ("0 0 1 0 1 1",)}, "has no name"),
        ("keep_out", {"keep_out": ("a: 0 0 1 0 1 1", "a: 2 0 3 0 3 1")}, "the same name"),
        ("geofence", {"geofence": (0.0, 0.0, 1.0, 0.0)}, "2 corners"),
        ("geofence", {"geofence": (0.0, 0.0, 1.0, 0.0, 1.0)}, "5 numbers"),
        ("geofence", {"geofence": (0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0)}, "touches itself"),
        ("geofence", {"geofence": (0.0, 0.0, 1.0, float("nan"), 1.0, 0.0)}, "finite"),
    ],
)
def test_what_is_no_region_is_refused_with_the_reason(name, values, problem):
    with pytest.raises(ConfigError, match=f"'{name}'.*{problem}"):
        TaskConfig(**values)


def test_the_base_stays_within_the_fence_and_the_arm_looks_beyond_it(robot, half_known):
    """Where the fence leaves no room to drive, the reasons say so, and the arm looks around."""
    task = dataclasses.replace(TASK, geofence=(-0.3, -0.6, 0.9, -0.6, 0.9, 0.6, -0.3, 0.6))
    free = planner_of(robot).choose(half_known, standing(robot))
    assert free.route is not None
    choice = planner_of(robot, task).choose(half_known, standing(robot))
    assert any(
        "outside or next to geofence 'of the task'" in why
        for why in choice.explanation["rejections"]
    )
    if choice.route is not None and choice.route.moves_base:
        assert (np.abs(choice.route.base_path[:, :2] - (0.3, 0.0)) < 0.6).all()


def test_a_base_that_stands_in_a_region_is_told_and_can_drive_out(robot, half_known):
    """It is driven to where it has stood before; that is the first drive after a region is set."""
    planner, state = planner_of(robot), standing(robot)
    region = Polygon.of([(0.1, -0.3), (0.8, -0.3), (0.8, 0.3), (0.1, 0.3)], "puddle")
    planner.motion.keep_out = KeepOut((region,))
    home = KnownPlace("home", (-0.2, 1.1, 0.0), state.joints)
    choice = planner.route_to(half_known, state, home)
    assert choice.route is not None, choice.reason
    assert planner.motion.stands_wrongly == "in or next to keep-out region 'puddle'"
    np.testing.assert_allclose(choice.route.base_path[-1, :2], (-0.2, 1.1), atol=0.05)
    near = region.signed_distance(choice.route.base_path[:, :2])
    assert near[0] < 0.0 < near[-1]
    assert (np.diff(np.sign(near)) >= 0).all(), "it goes in again"
    assert planner.motion.route_problem(half_known, state) == ""
    planner.motion.keep_out = KeepOut()
    planner.route_to(half_known, state, home)
    assert planner.motion.stands_wrongly == ""


@pytest.mark.parametrize(
    ("thorough", "wanted", "looks"), [(1.0, 1.0, False), (0.05, 0.5, False), (0.05, 1.0, True)]
)
def test_little_is_worth_a_view_where_the_task_asks_for_it(robot, thorough, wanted, looks):
    """All is known but for a hole of 25 cm in the floor."""
    voxel_map = box_of_voxels(known_from=-30, sigma=0.001)
    hole = np.indices((5, 5, 1), np.int32).reshape(3, -1).T + np.int32((22, -2, -1))
    put_states(voxel_map._storage, unknown_states(hole))
    task = dataclasses.replace(TASK, known_fraction=wanted)
    choice = planner_of(robot, task, thorough).choose(voxel_map, standing(robot))
    assert (choice.pose is not None) == looks


@pytest.mark.parametrize(
    ("thorough", "wanted", "goes"), [(1.0, 1.0, False), (0.01, 0.1, False), (0.01, 1.0, True)]
)
def test_a_long_route_is_worth_it_where_the_task_asks_for_it(
    robot, half_known, thorough, wanted, goes
):
    """No view is worth its way where a meter costs five full views."""
    choice = NextBestViewConfig(rating=RatingConfig(distance_weight=5.0))
    task = dataclasses.replace(TASK, known_fraction=wanted)
    found = planner_of(robot, task, thorough, choice).choose(half_known, standing(robot))
    assert (found.pose is not None) == goes
    if goes:
        assert found.reason.startswith("largest_information")


def test_doubtful_pose_keeps_more_room_where_a_view_is_left_then(robot, half_known, monkeypatch):
    """Where none is, it goes on as with a sure pose, and nothing is held against the views."""
    state = dataclasses.replace(standing(robot), pose_covariance=0.03**2 * np.eye(6))
    chosen = planner_of(robot).choose(half_known, state)
    assert chosen.pose is not None
    reach, asked = WholeBodyReach.reach, []

    def refuse_if_wide(self: WholeBodyReach, T_map_camera: np.ndarray) -> ReachResult:
        asked.append(self.is_wider)
        return ReachResult("too narrow") if self.is_wider else reach(self, T_map_camera)

    monkeypatch.setattr(WholeBodyReach, "reach", refuse_if_wide)
    again = planner_of(robot).choose(half_known, state)
    assert again.pose is not None
    assert asked[0] and not asked[-1]
    assert not any("unreachable before" in why for why in again.explanation["rejections"])


def test_a_view_that_failed_is_not_chosen_at_once_nor_counted_as_a_look(
    robot, half_known, monkeypatch
):
    looks, select = list[int](), ViewChoice.select

    def watched(choice, situation, *rest, **more):
        looks.append(len(situation.past_views))
        return select(choice, situation, *rest, **more)

    monkeypatch.setattr(ViewChoice, "select", watched)
    planner = planner_of(robot)
    first = planner.choose(half_known, standing(robot))
    assert first.pose is not None and first.route is not None
    planner.failed(FailedView(first.pose, "a wheel turned in place"))
    second = planner.choose(half_known, standing(robot))
    assert any("a wheel turned" in reason for reason in second.explanation["rejections"])
    assert set(looks) == {1}


def test_a_look_that_failed_was_in_vain(robot, half_known):
    """As one into the sky, where nothing tells the pose: it is not promised the same again."""
    state, informations = standing(robot), []
    for reached in (False, True):
        planner = planner_of(robot)
        for _ in range(3):
            choice = planner.choose(half_known, state)
            assert choice.pose is not None
            planner.failed(FailedView(choice.pose, "no", reached))
        informations.append(choice.explanation["terms"]["information"])
    assert informations[1] < 0.8 * informations[0]


def test_a_planner_that_begins_anew_knows_what_views_have_told_in_vain(robot, half_known):
    """Unknown space that the past views had in sight is not promised again."""
    state = standing(robot)
    fresh = planner_of(robot).choose(half_known, state)
    assert fresh.pose is not None
    looks = np.tile(fresh.pose, (10, 1, 1))
    around = Surrounding(past_views=looks)
    again = planner_of(robot).choose(half_known, state, around)
    expected, known = (
        choice.explanation.get("terms", {}).get("information", 0.0) for choice in (fresh, again)
    )
    assert known < 0.5 * expected
