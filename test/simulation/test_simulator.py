"""The robot that moves by forces: it obeys, gives, slips, drifts, and counts what it touches."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError, RobotModelError, SimulationError
from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.base_motion import planar
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras import eyes
from infomap_ros.simulation.cameras.eyes import DepthEye
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.rocks import upright
from infomap_ros.simulation.worlds.terrain import Terrain

ARM = ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint")
LINKS = ("base_link", "arm_turret", "arm_upper", "arm_forearm", "arm_wrist", "stereo_link")
CONFIG = SimulatorConfig(camera=StereoCameraConfig(width=64, height=48, supersampling=1))


def flat_world(*boxes: tuple[str, tuple[float, float, float], np.ndarray]) -> World:
    """Level ground with boxes: name, size, pose."""
    builder = SceneBuilder(Terrain(np.zeros((41, 41)), 4.0))
    builder.add_ground_material("ground", np.full((64, 64, 3), 128, np.uint8), 1.0)
    builder.add_material("paint", np.full((64, 64, 3), 200, np.uint8))
    builder.add_terrain("ground")
    for name, size, pose in boxes:
        builder.add_box(name, size, pose, "paint")
    return builder.compile()


@pytest.fixture(scope="module")
def flat() -> World:
    return flat_world()


@pytest.fixture
def rover(flat: World, description: str) -> Simulator:
    return Simulator(flat, description, CONFIG)


def finish(simulator: Simulator, limit: float = 60.0) -> float:
    """Step until it stands still; returns the time that took [s]."""
    start = simulator.time
    while simulator.is_moving:
        simulator.step(0.1)
        assert simulator.time - start < limit
    return simulator.time - start


def test_it_stands_on_level_ground_as_its_description_says(rover: Simulator) -> None:
    finish(rover)
    pose = rover.true_pose()
    assert pose[2, 3] == pytest.approx(0.0762, abs=0.002)
    assert pose[2, 2] > np.cos(0.005)
    assert rover.contacts == 0


def test_it_drives_a_path_and_stops(rover: Simulator) -> None:
    rover.follow_base_path([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.0, 1.0)])
    assert rover.is_moving
    finish(rover)
    assert rover.problem == ""
    believed = planar(rover.odometry().transform)
    np.testing.assert_allclose(believed, (0.5, 0.0, 1.0), atol=0.06)
    truth = planar(invert_transform(rover.T_world_odom) @ rover.true_pose())
    np.testing.assert_allclose(truth, (0.5, 0.0, 1.0), atol=0.12)


def test_a_path_in_another_frame_is_driven_there(rover: Simulator) -> None:
    frame = upright(0.3, -0.2, 0.0, 0.5)
    start = planar(invert_transform(frame))
    rover.follow_base_path([start, planar(invert_transform(frame) @ upright(0.4, 0, 0, 0))], frame)
    finish(rover)
    assert planar(rover.odometry().transform)[0] == pytest.approx(0.4, abs=0.03)


def test_corrections_on_the_way_take_the_drift_away(flat: World, description: str) -> None:
    odometry = dataclasses.replace(CONFIG.odometry, scale_error=0.2)
    errors = []
    for correct in (False, True):
        robot = Simulator(flat, description, dataclasses.replace(CONFIG, odometry=odometry))
        robot.follow_base_path([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
        while robot.is_moving:
            robot.step(0.2)
            if correct:
                T_map_base = invert_transform(robot.T_world_odom) @ robot.true_pose()
                robot.correct_path(robot.odometry().transform @ invert_transform(T_map_base))
        errors.append(abs(planar(robot.true_pose())[0] - 1.0))
    assert errors[0] > 0.08
    assert errors[1] < 0.03


def test_a_velocity_ends_when_it_is_not_repeated(rover: Simulator) -> None:
    for _ in range(10):
        rover.command_velocity(0.2, 0.0)
        rover.step(0.1)
    finish(rover, 3.0)
    assert 0.15 < planar(rover.true_pose())[0] < 0.35


def test_odometry_drifts_within_its_covariance(flat: World, description: str) -> None:
    scores = []
    for seed in range(6):
        robot = Simulator(flat, description, dataclasses.replace(CONFIG, seed=seed))
        robot.follow_base_path([(0, 0, 0), (0.8, 0, 0), (0.8, 0, 1.5), (0.8, 0.4, 1.5)])
        finish(robot)
        truth = invert_transform(robot.T_world_odom) @ robot.true_pose()
        estimate = robot.odometry()
        error = planar(truth) - planar(estimate.transform)
        assert np.abs(error).max() > 1e-4
        assert estimate.covariance is not None
        spread = estimate.covariance[np.ix_([0, 1, 5], [0, 1, 5])]
        scores.append(error @ np.linalg.solve(spread, error))
    assert np.mean(scores) < 7.8  # 3 degrees of freedom: 95 % are below 7.8


def test_the_suspension_gives_when_the_arm_moves(flat: World, description: str) -> None:
    tilts = {}
    for sag in (0.0, 0.008):
        setup = RobotSetupConfig(suspension_sag=sag)
        robot = Simulator(flat, description, dataclasses.replace(CONFIG, robot=setup))
        robot.follow_arm_trajectory(ARM[1:3], [(1.2, 0.0)], [2.0])
        finish(robot)
        tilts[sag] = np.degrees(np.arcsin(-robot.true_pose()[2, 0]))
    assert abs(tilts[0.0]) < 0.1
    assert 0.3 < tilts[0.008] < 3.0  # nose down


def test_the_arm_follows_its_trajectory(rover: Simulator) -> None:
    goal = (0.8, 0.3, -0.4, 0.6)
    rover.follow_arm_trajectory(ARM, [(0.0, -0.35, 0.65, 0.0), goal], [0.0, 2.0])
    took = finish(rover)
    positions = dict(zip(rover.joint_state().names, rover.joint_state().positions, strict=True))
    np.testing.assert_allclose([positions[name] for name in ARM], goal, atol=0.01)
    assert 2.0 <= took < 4.0


def test_no_joint_is_faster_than_its_limit(rover: Simulator) -> None:
    rover.follow_arm_trajectory(ARM[:1], [(1.8,)], [0.01])
    before, fastest = 0.0, 0.0
    while rover.is_moving:
        rover.step(0.1)
        now = float(rover.joint_state().positions[0])
        fastest, before = max(fastest, abs(now - before) / 0.1), now
    assert before == pytest.approx(1.8, abs=0.01)
    assert fastest < 1.2 * 1.5


def test_the_camera_is_where_the_joints_and_the_base_say(rover: Simulator) -> None:
    rover.follow_arm_trajectory(ARM, [(0.5, 0.2, 0.3, -0.2)], [1.0])
    finish(rover)
    joints = rover.joint_state()
    robot = RobotModel.from_urdf(rover.description)
    positions = dict(zip(joints.names, joints.positions.tolist(), strict=True))
    expected = rover.true_pose() @ robot.forward_kinematics(positions, "left_camera_optical_frame")
    np.testing.assert_allclose(rover.true_camera_pose(), expected, atol=0.005)


def test_same_seed_same_run(flat: World, description: str) -> None:
    def run(seed: int) -> np.ndarray:
        robot = Simulator(flat, description, dataclasses.replace(CONFIG, seed=seed))
        robot.follow_base_path([(0, 0, 0), (0.2, 0.05, 0.4)])
        finish(robot)
        return np.concatenate([robot.true_pose(), robot.odometry().transform])

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1), run(2))


def test_standing_still_costs_nothing_and_changes_nothing(rover: Simulator) -> None:
    finish(rover)
    before, stamp = rover.true_pose(), rover.stamp
    rover.step(1000.0)
    assert np.array_equal(before, rover.true_pose())
    assert rover.stamp - stamp == 1_000_000_000_000


def test_driving_against_a_wall_is_a_contact_and_ends(description: str) -> None:
    wall = ("wall", (0.1, 2.0, 1.0), make_transform(np.eye(3), (0.6, 0.0, 0.5)))
    robot = Simulator(flat_world(wall), description, CONFIG)
    robot.follow_base_path([(0.0, 0.0, 0.0), (1.5, 0.0, 0.0)])
    finish(robot)
    assert "the base" in robot.problem
    assert robot.true_pose()[2, 2] > 0.8
    assert robot.contacts >= 1
    assert robot.contact_events[0].other == "wall"
    robot.follow_base_path([planar(robot.odometry().transform)])
    assert robot.problem == ""


def test_spinning_on_the_spot_is_being_stuck(flat: World, description: str) -> None:
    setup = RobotSetupConfig(wheel_friction=0.05)
    tether = ("bar", (0.05, 3.0, 0.02), make_transform(np.eye(3), (0.3, 0.0, 0.05)))
    robot = Simulator(flat_world(tether), description, dataclasses.replace(CONFIG, robot=setup))
    robot.follow_base_path([(0.0, 0.0, 0.0), (1.5, 0.0, 0.0)])
    finish(robot)
    assert "stuck" in robot.problem
    assert planar(robot.odometry().transform)[0] > planar(robot.true_pose())[0] + 0.1


def test_wheels_with_rollers_move_the_base_as_they_are_told(flat: World, description: str) -> None:
    """Two turns on the spot, then ahead: a skidding rover leaves the spot by more."""
    away = []
    for rollers in (True, False):
        config = dataclasses.replace(CONFIG, robot=RobotSetupConfig(rollers=rollers))
        robot = Simulator(flat, description, config)
        assert robot.skids is not rollers
        for _ in range(120):
            robot.command_velocity(0.0, 0.5)
            robot.step(0.2)
        away.append(float(np.hypot(*planar(robot.true_pose())[:2])))
        start = robot.true_pose()
        for _ in range(20):
            robot.command_velocity(0.2, 0.0)
            robot.step(0.2)
        driven = planar(np.linalg.inv(start) @ robot.true_pose())
        assert driven[0] == pytest.approx(0.2 * 4.0, abs=0.1)
        assert abs(driven[1]) < 0.1
    assert away[0] < 0.01 < away[1]


@pytest.mark.parametrize("uphill", [0.25, -0.25])
def test_rollers_keep_a_slow_speed_uphill_and_downhill_and_stand_there(
    flat: World, description: str, uphill: float
) -> None:
    """A drag that they do not overcome leaves slow turns and drives unfinished: they are stuck."""
    config = dataclasses.replace(CONFIG, robot=RobotSetupConfig(rollers=True))
    robot = Simulator(flat, description, config)
    robot.scene[0].opt.gravity[0] = -9.81 * uphill
    robot.step(2.0)
    start = robot.true_pose()
    for _ in range(30):
        robot.command_velocity(0.08, 0.0)
        robot.step(0.2)
    driven = planar(np.linalg.inv(start) @ robot.true_pose())[0]
    assert driven == pytest.approx(0.08 * 6.0, abs=0.1)
    robot.stop()
    robot.step(2.0)
    stands = robot.true_pose()
    robot.step(5.0)
    assert np.linalg.norm(robot.true_pose()[:3, 3] - stands[:3, 3]) < 0.02


def test_rollers_push_no_harder_than_they_grip(description: str) -> None:
    wall = ("wall", (0.1, 2.0, 1.0), make_transform(np.eye(3), (0.6, 0.0, 0.5)))
    config = dataclasses.replace(CONFIG, robot=RobotSetupConfig(rollers=True))
    robot = Simulator(flat_world(wall), description, config)
    robot.follow_base_path([(0.0, 0.0, 0.0), (1.5, 0.0, 0.0)])
    finish(robot)
    assert "the base" in robot.problem
    assert robot.true_pose()[0, 3] < 0.6
    assert robot.true_pose()[2, 2] > 0.8


def test_a_low_step_is_no_contact(description: str) -> None:
    step = ("step", (0.3, 2.0, 0.1), make_transform(np.eye(3), (0.6, 0.0, -0.02)))
    robot = Simulator(flat_world(step), description, CONFIG)
    robot.follow_base_path([(0.0, 0.0, 0.0), (1.2, 0.0, 0.0)])
    finish(robot)
    assert planar(robot.true_pose())[0] > 0.9
    assert robot.contact_events == ()


def test_an_arm_that_touches_is_named_with_what_it_touched(description: str) -> None:
    post = ("post", (0.1, 0.1, 1.6), make_transform(np.eye(3), (0.55, 0.25, 0.8)))
    robot = Simulator(flat_world(post), description, CONFIG)
    robot.follow_arm_trajectory(ARM[1:3], [(1.3, 0.0)], [3.0])
    finish(robot)
    assert robot.contacts == 0
    robot.follow_arm_trajectory(ARM[:1], [(1.2,)], [2.0])
    finish(robot)
    assert any("arm" in e.link or "stereo" in e.link for e in robot.contact_events)
    assert {event.other for event in robot.contact_events} == {"post"}
    assert "arm_pan_joint" in robot.problem


def test_touching_itself_is_a_contact(rover: Simulator) -> None:
    rover.follow_arm_trajectory(ARM[1:], [(1.9, 2.65, 0.0)], [4.0])
    finish(rover)
    assert rover.contacts >= 1
    touched = {(event.link, event.other) for event in rover.contact_events}
    assert touched <= {(a, b) for a in LINKS for b in LINKS}


def test_bad_commands_are_refused(rover: Simulator) -> None:
    with pytest.raises(RobotModelError, match="no_joint"):
        rover.follow_arm_trajectory(["no_joint"], [[0.0]], [1.0])
    with pytest.raises(InvalidInputError, match="arm_shoulder_joint"):
        rover.follow_arm_trajectory(ARM[1:2], [[2.5]], [1.0])
    with pytest.raises(InvalidInputError, match="decrease"):
        rover.follow_arm_trajectory(ARM[:1], [[0.1], [0.2]], [1.0, 0.5])
    with pytest.raises(InvalidInputError, match="shapes"):
        rover.follow_arm_trajectory(ARM[:1], [[0.1, 0.2]], [1.0])
    with pytest.raises(InvalidInputError, match="velocity"):
        rover.command_velocity(np.nan, 0.0)
    with pytest.raises(InvalidInputError, match="duration"):
        rover.step(-1.0)


def test_a_setup_that_does_not_fit_is_refused(flat: World, description: str) -> None:
    setup = RobotSetupConfig(left_wheels=("middle_wheel_joint",))
    with pytest.raises(RobotModelError, match="middle_wheel_joint"):
        Simulator(flat, description, dataclasses.replace(CONFIG, robot=setup))
    setup = RobotSetupConfig(left_camera_frame="third_eye")
    with pytest.raises(RobotModelError, match="third_eye"):
        Simulator(flat, description, dataclasses.replace(CONFIG, robot=setup))


def test_a_pair_is_taken_where_the_cameras_are(rover: Simulator) -> None:
    finish(rover)
    try:
        pair = rover.capture()
    except SimulationError as error:
        pytest.fail(str(error))
    assert pair.stamp == rover.stamp
    assert pair.left.shape == pair.right.shape == (48, 64)
    sky, ground = pair.left[:5].mean(), pair.left[-5:].mean()
    assert sky > ground + 20
    left, right = rover.calibrations
    assert right.projection[0, 3] == pytest.approx(-left.projection[0, 0] * 0.1016, rel=1e-6)
    rover.close()


def test_the_measured_camera_pose_is_as_good_as_it_says(rover: Simulator) -> None:
    finish(rover)
    truth = rover.true_camera_pose()
    records = [rover.camera_pose() for _ in range(200)]
    errors = np.array([record.transform[:3, 3] - truth[:3, 3] for record in records])
    assert records[0].covariance is not None
    declared = np.sqrt(np.diag(records[0].covariance)[:3])
    np.testing.assert_allclose(errors.std(axis=0), declared, rtol=0.2)


def test_depth_is_true_but_for_its_noise(description: str) -> None:
    wall = ("wall", (0.1, 6.0, 6.0), make_transform(np.eye(3), (2.05, 0.0, 0.0)))
    config = dataclasses.replace(
        CONFIG, robot=RobotSetupConfig(home=(0.0, 0.0, 0.0, 0.0), suspension_sag=0.0)
    )
    robot = Simulator(flat_world(wall), description, config)
    images = np.array([robot.capture_depth().depth for _ in range(40)])
    robot.close()
    camera = robot.depth_calibration.rectified_camera()
    near_axis = images[:, 20:28, 28:36]
    truth = 2.0 - robot.true_camera_pose()[0, 3]
    assert camera.width == images.shape[2]
    assert near_axis.mean() == pytest.approx(truth, abs=0.004)
    sigma = 0.0012 + 0.0019 * (truth - 0.4) ** 2
    assert near_axis.std(axis=0).mean() == pytest.approx(sigma, rel=0.2)
    neighbors = np.corrcoef(near_axis[:, 3, 3], near_axis[:, 3, 4])[0, 1]
    assert neighbors > 0.0


def test_depth_out_of_range_is_no_measurement(
    rover: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eyes, "_PIXEL_SIGMA", 0.0)
    camera = PinholeCamera(4, 4, 3.0, 3.0, 1.5, 1.5)
    eye = DepthEye(rover._body, camera, np.random.default_rng(0))
    depth = np.full((4, 4), 1.0, np.float32)
    depth[0], depth[1], depth[2] = 0.25, 6.5, np.nan
    measured = eye.measure(depth)
    assert np.isnan(measured[:3]).all()
    np.testing.assert_allclose(measured[3], 1.0, atol=0.01)
