"""Routes are watched while they are carried out, and end where the camera looks at its view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.exploration.loop import camera_error
from infomap_ros.exploration.robot import RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_motion import ViewMotion
from infomap_ros.exploration.view_planner import ViewPlannerConfig
from infomap_ros.geometry import Polygon, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.state import VoxelStates, information_of, put_states
from infomap_ros.motion.keep_out import KeepOut
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import Route
from infomap_ros.simulation.body.robot import read_description

TASK = TaskConfig()
BEGIN = make_transform(np.eye(3), (-1.2, 0.0, 0.09))
VIEW_FROM = np.array([0.0, 0.5, 0.4, -0.3])  # posture of the arm that has the view, base at x = 1


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    description = read_description(find_share("config/rover.urdf"))
    return RobotModel.from_urdf(description, "left_camera_optical_frame", "base_link")


@pytest.fixture
def yard() -> VoxelMap:
    """Even ground at z = 0, 5 x 3 m, seen up to 1.3 m."""
    voxel_map, first = VoxelMap(), np.int32((-50, -30, -1))
    indices = np.indices((100, 60, 27), np.int32).reshape(3, -1).T + first
    put(voxel_map, indices, indices[:, 2] < 0)
    return voxel_map


def put(voxel_map: VoxelMap, indices: FloatArray, solid: FloatArray) -> None:
    """Have voxels be known, as solid or free."""
    size = voxel_map.config.voxel_size
    quanta = np.where(solid, 20, -20).astype(np.int32)
    covariances = np.tile(np.diag((0.02, 0.02, 0.002)) ** 2, (len(indices), 1, 1))
    gaussians = information_of(indices, solid, (indices + 0.5) * size, covariances, size)
    known = np.ones(len(indices), bool)
    put_states(voxel_map._storage, VoxelStates(indices, known, quanta, gaussians))


def put_box(voxel_map: VoxelMap, middle: tuple[float, float, float], edge: float = 0.2) -> None:
    size = voxel_map.config.voxel_size
    low = np.floor((np.array(middle) - 0.5 * edge) / size).astype(np.int32)
    indices = np.indices([round(edge / size)] * 3, np.int32).reshape(3, -1).T + low
    put(voxel_map, indices, np.ones(len(indices), bool))


def state_of(robot: RobotModel, T_map_base: FloatArray, joints: Mapping[str, float]) -> RobotState:
    T_map_camera = T_map_base @ robot.forward_kinematics(joints, robot.camera_frame)
    return RobotState(T_map_base, T_map_camera, 1e-8 * np.eye(6), joints)


def resting(robot: RobotModel, q: FloatArray | None = None) -> dict[str, float]:
    joints = {joint.name: 0.0 for joint in robot.joints}
    return joints if q is None else {**joints, **robot.arm.by_name(q)}


class Trip:
    """A robot that has been sent to a view 2.2 m ahead."""

    def __init__(self, robot: RobotModel, yard: VoxelMap) -> None:
        self.robot, self.map = robot, yard
        self.motion = ViewMotion(robot, ViewPlannerConfig(), TASK)
        self.motion.begin(BEGIN)
        there = make_transform(np.eye(3), (1.0, 0.0, 0.09))
        self.view = there @ robot.arm.camera_pose(VIEW_FROM)
        state = state_of(robot, BEGIN, resting(robot))
        result = self.motion.reach(yard, state).reach(self.view)
        assert result.route is not None and result.route.moves_base, result.reason
        self.route: Route = result.route
        self.motion.send(yard, state, self.route)

    def problem_at(self, row: int) -> str:
        """What is wrong with the rest of the route where the base is on a pose of its path."""
        folded = resting(self.robot, self.route.arm_before.positions[-1])
        state = state_of(self.robot, self.route.base_poses[row], folded)
        return self.motion.route_problem(self.map, state)


@pytest.fixture
def trip(robot: RobotModel, yard: VoxelMap) -> Trip:
    return Trip(robot, yard)


def test_a_box_put_on_the_base_path_is_named_until_the_base_has_passed_it(trip: Trip) -> None:
    rows = len(trip.route.base_path)
    assert trip.problem_at(0) == ""
    middle = trip.route.base_path[rows // 2]
    put_box(trip.map, (middle[0], middle[1], 0.1))
    problem = trip.problem_at(1)
    assert problem.startswith("the base path is blocked at (")
    where = [float(text) for text in problem.split("(")[1].split(")")[0].split(",")]
    assert np.hypot(*(np.array(where) - middle[:2])) < 0.8


def test_a_region_set_across_the_base_path_is_named_until_it_is_taken_away(trip: Trip) -> None:
    x, y = trip.route.base_path[len(trip.route.base_path) // 2, :2]
    across = Polygon.of([(x, y - 0.2), (x + 0.1, y), (x, y + 0.2)], "tape")
    beside = Polygon.of([(x, y + 1.0), (x + 0.1, y + 1.0), (x, y + 1.2)], "flowers")
    assert trip.problem_at(0) == ""
    trip.motion.keep_out = KeepOut((beside,))
    assert trip.problem_at(0) == ""
    trip.motion.keep_out = KeepOut((beside, across))
    problem = trip.problem_at(0)
    assert problem.startswith("the base path is blocked at (")
    assert problem.endswith("the base would stand in or next to keep-out region 'tape'")
    trip.motion.keep_out = KeepOut((beside,))
    assert trip.problem_at(0) == ""
    trip.motion.keep_out = KeepOut((), (beside,))
    assert "outside or next to geofence 'flowers'" in trip.problem_at(0)


def test_a_box_behind_or_beside_the_base_blocks_nothing(trip: Trip) -> None:
    last = len(trip.route.base_path) - 1
    for row in range(0, last, 5):  # as the base goes along
        assert trip.problem_at(row) == ""
    put_box(trip.map, (-1.2, 0.0, 0.1))
    put_box(trip.map, (0.0, 1.3, 0.1))
    assert trip.problem_at(last) == ""


def test_what_the_map_puts_where_the_base_stands_blocks_it_only_if_it_does_not_leave_it(
    trip: Trip,
) -> None:
    row = len(trip.route.base_path) // 2
    heel = trip.route.base_poses[row] @ (-0.32, 0.0, 0.0, 1.0)  # 0.23 m behind it a wheel ends
    put_box(trip.map, (heel[0], heel[1], 0.1))
    assert trip.problem_at(row) == ""
    toe = trip.route.base_poses[row] @ (0.32, 0.0, 0.0, 1.0)
    put_box(trip.map, (toe[0], toe[1], 0.1))
    assert trip.problem_at(row).startswith("the base path is blocked at (")


def test_unchanged_surroundings_are_free_wherever_the_robot_is(trip: Trip) -> None:
    put_box(trip.map, (-2.3, -1.3, 0.8))
    for row in range(0, len(trip.route.base_path), 4):
        assert trip.problem_at(row) == ""


def test_a_box_put_where_the_arm_is_about_to_be_stops_it(trip: Trip) -> None:
    robot, base = trip.robot, trip.route.base_poses[-1]
    here = state_of(robot, base, resting(robot, trip.route.arm_after.positions[0]))
    plan = trip.motion.plan_arm(trip.map, here, trip.view)
    assert plan.route is not None and plan.reason == ""
    assert trip.motion.route_problem(trip.map, here) == ""
    camera = plan.route.T_map_camera[:3, 3]
    put_box(trip.map, (camera[0], camera[1], camera[2]), 0.1)
    problem = trip.motion.route_problem(trip.map, here)
    assert problem.startswith("the path of the arm is blocked: ")
    assert "with the map at (" in problem


@pytest.mark.parametrize(
    ("dx", "dy", "turn"), [(0.0, 0.0, 0.0), (0.1, 0.0, 0.15), (-0.05, 0.087, -0.15)]
)
def test_the_camera_reaches_its_view_from_where_the_base_has_stopped(
    trip: Trip, dx: float, dy: float, turn: float
) -> None:
    robot, off = trip.robot, np.eye(4)
    off[:3, :3] = Rotation.from_euler("z", turn).as_matrix()
    off[:2, 3] = dx, dy
    base = trip.route.base_poses[-1] @ off
    here = state_of(robot, base, resting(robot, trip.route.arm_after.positions[0]))
    as_planned = base @ robot.arm.camera_pose(trip.route.arm_after.positions[-1])
    away, turned = camera_error(as_planned, trip.view)
    assert (turned > TASK.view_angle_tolerance / 2) == (turn != 0.0)

    plan = trip.motion.plan_arm(trip.map, here, trip.view)

    assert plan.route is not None and plan.reason == ""
    end = base @ robot.arm.camera_pose(plan.route.arm_after.positions[-1])
    away, turned = camera_error(end, trip.view)
    assert away <= TASK.view_position_tolerance
    assert turned <= TASK.view_angle_tolerance


def test_where_the_arm_does_not_reach_a_short_drive_is_planned_once(trip: Trip) -> None:
    robot = trip.robot
    base = trip.route.base_poses[-1].copy()
    base[0, 3] -= 0.8
    here = state_of(robot, base, resting(robot, trip.route.arm_after.positions[0]))
    drive = trip.motion.plan_arm(trip.map, here, trip.view)
    assert drive.route is not None and drive.reason == "" and drive.route.moves_base
    assert 0.5 < drive.travel < 1.0
    end = drive.route.base_poses[-1] @ robot.arm.camera_pose(drive.route.arm_after.positions[-1])
    assert camera_error(end, trip.view)[0] <= TASK.view_position_tolerance

    # it looks there from where it is, and says why
    near = trip.motion.plan_arm(trip.map, here, trip.view)
    assert near.route is not None and near.reason != "" and not near.route.moves_base
    end = base @ robot.arm.camera_pose(near.route.arm_after.positions[-1])
    assert camera_error(end, trip.view)[1] < 0.5


def test_a_long_drive_is_left_to_the_next_choice(trip: Trip) -> None:
    robot = trip.robot
    base = trip.route.base_poses[-1].copy()
    base[0, 3] -= 1.5
    here = state_of(robot, base, resting(robot, trip.route.arm_after.positions[0]))
    plan = trip.motion.plan_arm(trip.map, here, trip.view)
    assert plan.reason != ""
    assert plan.route is None or not plan.route.moves_base
