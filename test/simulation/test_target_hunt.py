"""The target stands behind the simulated robot: it looks around until it has found it."""

from __future__ import annotations

import numpy as np

from infomap_ros.exploration.loop import Ending, EndReason, Exploration
from infomap_ros.exploration.robot import Choice, Interrupted, Motion, RobotState
from infomap_ros.exploration.target_hunt import find_target
from infomap_ros.exploration.target_search import TargetSearchPlanner
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetSighting
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ArmPath
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.robots.ready_robot import ready_robot
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.scenes import make_world
from infomap_ros.simulation.worlds.target_board import WORLD_BOARD
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier

CAMERA = StereoCameraConfig(width=320, height=240, supersampling=1)


class LookingRobot:
    """A simulated robot that knows odometry and joints alone, and looks for tags."""

    def __init__(self, yaw: float) -> None:
        world = make_world("mars", 2, size=4.5)
        description = read_description(find_share("config/rover.urdf"))
        config = SimulatorConfig(start=(0.0, 0.0, yaw), camera=CAMERA)
        self.simulator = Simulator(world, description, config)
        frames = ready_robot(description, config.robot).setup
        self.model = RobotModel.from_urdf(description, frames.left_camera_frame, frames.base_frame)
        self._rectifier = StereoRectifier(*self.simulator.calibrations)
        self._sensor = StereoRangeSensor(self._rectifier.rig, StereoConfig())
        self._detector = TagTargetDetector(TagTargetConfig(board=WORLD_BOARD))
        self.planner = TargetSearchPlanner(self.model, self._rectifier.rig.left)
        self.looks = 0
        self.found = False

    def state(self) -> RobotState:
        record = self.simulator.joint_state()
        joints = dict(zip(record.names, map(float, record.positions), strict=True))
        camera = self.simulator.odometry_camera_pose()
        T_base_camera = self.model.forward_kinematics(joints, self.model.camera_frame)
        return RobotState(camera @ invert_transform(T_base_camera), camera, np.eye(6), joints)

    def look(self, interrupted: Interrupted) -> str:
        pair = self.simulator.capture()
        images = self._rectifier.rectify(pair.left, pair.right)
        self.looks += 1
        result = self._detector.detect(StereoView(pair.stamp, *images, self._sensor))
        self.found = isinstance(result, TargetSighting)
        return ""

    def look_for_target(self) -> Choice:
        return self.planner.choose(self.state())

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        self.simulator.follow_arm_trajectory(path.joint_names, path.positions, path.times)
        return self._finish()

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        self.simulator.follow_base_path(poses)
        return self._finish()

    def _finish(self) -> Motion:
        while self.simulator.is_moving:
            self.simulator.step(0.1)
        return Motion(self.simulator.problem)


class Notes:
    """A log of a run that keeps what is written."""

    def __init__(self) -> None:
        self.kinds: list[str] = []

    def write(self, kind: str, **content: object) -> None:
        self.kinds.append(kind)


def hunt(robot: object, **task: int) -> tuple[object, Exploration]:
    exploration = Exploration(robot, robot, TaskConfig(**task), Notes())  # type: ignore[arg-type]
    return find_target(exploration, robot, robot), exploration  # type: ignore[arg-type]


def test_a_target_behind_the_robot_is_found() -> None:
    robot = LookingRobot(yaw=np.pi)
    try:
        ending, exploration = hunt(robot)
    finally:
        robot.simulator.close()
    assert ending is None
    assert robot.found
    assert 2 <= robot.looks <= 8  # in front it would have been the first, all around is 20
    assert exploration.state == "looking for the target"


class PaperRobot:
    """A rover that obeys at once, and whose target is nowhere."""

    def __init__(self, camera: PinholeCamera) -> None:
        text = find_share("config/rover.urdf").read_text(encoding="utf-8")
        self.model = RobotModel.from_urdf(text, "left_camera_optical_frame", "base_link")
        self.joints = {joint.name: 0.0 for joint in self.model.joints}
        self.base, self.planner = np.eye(4), TargetSearchPlanner(self.model, camera)
        self.found, self.stuck = False, False
        self.choices: list[Choice] = []
        self.reached: list[FloatArray] = []

    def state(self) -> RobotState:
        camera = self.base @ self.model.forward_kinematics(self.joints, self.model.camera_frame)
        return RobotState(self.base, camera, np.eye(6), self.joints)

    def look(self, interrupted: Interrupted) -> str:
        self.reached.append(self.state().T_map_camera)
        return ""

    def look_for_target(self) -> Choice:
        self.choices.append(self.planner.choose(self.state()))
        return self.choices[-1]

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        if self.stuck:
            return Motion("the arm is stuck")
        self.joints |= dict(zip(path.joint_names, path.positions[-1], strict=True))
        return Motion("")

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        assert self.choices[-1].route is not None
        self.base = self.choices[-1].route.base_poses[-1]
        return Motion("")


def test_where_there_is_no_target_all_is_looked_at_once_and_the_end_says_so() -> None:
    robot = PaperRobot(PinholeCamera(320, 240, 150.0, 150.0, 159.5, 119.5))
    ending, _ = hunt(robot)
    assert isinstance(ending, Ending) and ending.reason is EndReason.FAILED
    assert ending.detail.startswith("the target was not found: ")
    assert "97 %" in ending.detail or "98 %" in ending.detail or "99 %" in ending.detail
    assert len(robot.choices) < 20
    for choice, reached in zip(robot.choices, robot.reached[1:], strict=False):
        assert choice.pose is not None
        np.testing.assert_allclose(choice.pose, reached, atol=1e-6)
    routes = [choice.route for choice in robot.choices if choice.route is not None]
    assert any(route.moves_base for route in routes)  # the arm turns by 2.9 rad alone
    assert not all(route.moves_base for route in routes)


def test_an_arm_that_cannot_move_ends_the_search() -> None:
    robot = PaperRobot(PinholeCamera(320, 240, 150.0, 150.0, 159.5, 119.5))
    robot.stuck = True
    ending, _ = hunt(robot, max_failures=3)
    assert isinstance(ending, Ending)
    assert ending.detail == "the target was not found: arm: the arm is stuck"
    assert len(robot.choices) == 3


def test_views_that_are_proposed_look_where_they_should(rng: np.random.Generator) -> None:
    robot = PaperRobot(PinholeCamera(320, 240, 150.0, 150.0, 159.5, 119.5))
    for azimuth in rng.uniform(-np.pi, np.pi, 10):
        axis = np.array([np.cos(azimuth), np.sin(azimuth), -0.2]) / np.hypot(1.0, 0.2)
        across = np.cross(axis, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        rotation = np.column_stack([across, np.cross(axis, across), axis])
        for pose in robot.planner.poses_for(rotation, robot.state()):
            assert pose[:3, 2] @ axis > np.cos(0.25)
            assert pose[2, 1] < 0.0  # not upside down
