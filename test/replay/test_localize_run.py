"""A bag becomes a trajectory with covariances, and a map where it tells no pose."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from infomap_ros.cli import app
from infomap_ros.errors import BagError
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import (
    LocalizeInputConfig,
    LocalizeOptions,
    LocalizeRun,
)
from infomap_ros.replay.map_inputs import MapInputConfig, MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.mapped_bag import open_recording

from .moving_camera import OPTICAL, START, STEP, TILT, WALL, pose, write


@pytest.fixture(scope="module")
def hand_held(tmp_path_factory):
    return write(tmp_path_factory.mktemp("bags") / "hand_held")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return write(tmp_path_factory.mktemp("bags") / "robot", odometry=True)


def localized(path, **options) -> LocalizeRun:
    with BagReader(path) as bag:
        run = LocalizeRun(bag, LocalizeOptions(**options))
        run.run()
    return run


def check_path(transforms: np.ndarray, T_map_truth: np.ndarray) -> None:
    for index, transform in enumerate(transforms):
        true = T_map_truth @ pose(index)
        np.testing.assert_allclose(transform[:3, 3], true[:3, 3], atol=0.004)
        turn = Rotation.from_matrix(true[:3, :3].T @ transform[:3, :3]).magnitude()
        assert turn < 0.003


def test_images_alone_begin_a_level_map_at_the_camera(hand_held):
    run = localized(hand_held)
    begin = np.eye(4)
    begin[:3, 3] = -pose(0)[:3, 3]
    check_path(run.log.trajectory.transforms, begin)
    check_path(run.log.corrected_trajectory.transforms, begin)
    summary = run.summary()
    assert (summary["views"], summary["tracking"], summary["lost"]) == (10, 10, 0)
    np.testing.assert_allclose(summary["path_length"], 9 * 0.025, atol=0.004)


def test_by_an_inertial_sensor_the_map_is_level_however_the_camera_is_held(tmp_path):
    run = localized(write(tmp_path / "bag", imu="imu"))
    summary = run.summary()
    assert (summary["imu_topic"], summary["tracking"]) == ("/imu/data", 10)
    transforms = run.log.trajectory.transforms
    up = transforms[0][:3, :3].T @ [0.0, 0.0, 1.0]  # in the camera
    np.testing.assert_allclose(up, OPTICAL.T @ TILT.T @ [0.0, 0.0, 1.0], atol=1e-3)
    check_path(transforms, transforms[0] @ np.linalg.inv(pose(0)))


def test_an_inertial_sensor_that_nothing_ties_to_the_camera_is_named(tmp_path):
    with BagReader(write(tmp_path / "bag", imu="imu_of_nobody")) as bag:
        run = LocalizeRun(bag)
        run.run()
    assert run.summary()["imu_topic"] == "" and run.summary()["tracking"] == 10
    (problem,) = bag.problems
    assert problem.startswith("/imu/data is not used") and "imu_of_nobody" in problem
    chosen = {"input": LocalizeInputConfig(motion="none")}
    assert localized(write(tmp_path / "other", imu="imu"), **chosen).summary()["imu_topic"] == ""


def test_a_car_is_followed_from_the_first_pair_on(real_data):
    folder = real_data / "stereo_kitti_03"
    with open_recording(folder) as recording:
        run = LocalizeRun(recording)
        run.run()
    assert run.summary()["tracking"] == 5
    found = run.log.trajectory.transforms
    truth = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    for pose_found, pose_true in zip(found[1:], truth[1:], strict=True):
        moved = np.linalg.inv(found[0]) @ pose_found
        distance = np.linalg.norm(pose_true[:, 3])  # 1 m at 10 pairs a second
        assert np.linalg.norm(moved[:3, 3] - pose_true[:, 3]) <= 0.05 * distance
        turn = Rotation.from_matrix(moved[:3, :3] @ pose_true[:, :3].T).magnitude()
        assert turn <= np.radians(0.1)


def test_a_stopped_run_keeps_what_it_has_located(hand_held):
    with BagReader(hand_held) as bag:
        run = LocalizeRun(bag)
        run.run(lambda done, of: run.stop() if done == 4 else None)
    assert 4 <= len(run.log.trajectory) < 10
    assert run.summary()["interrupted"] == 1


def test_odometry_gives_the_frame_of_the_map(robot):
    run = localized(robot)
    assert run.inputs.odometry_topic == "/odom"
    check_path(run.log.trajectory.transforms, np.eye(4))
    assert not run.without_motion
    alone = localized(robot, input=LocalizeInputConfig(motion="none"))
    assert alone.inputs.odometry_topic == ""
    assert abs(alone.log.trajectory.transforms[0][0, 3]) < 1e-9


def test_a_bag_without_poses_becomes_a_map(hand_held):
    with BagReader(hand_held) as bag:
        run = MapRun(bag, MapOptions())
        run.run()
    _, means, _ = run.map.gaussians()
    far = means[means[:, 0] > WALL - 0.1 - 0.25]
    assert len(far) > 50
    np.testing.assert_allclose(np.median(far[:, 0]), WALL - 0.1, atol=0.02)
    summary = run.summary()
    assert summary["pose_topic"] == "(localization)"
    assert (summary["frames"], summary["localization_tracking"]) == (10, 10)


def test_the_bags_poses_can_be_insisted_on(hand_held):
    with BagReader(hand_held) as bag, pytest.raises(BagError, match="no pose, odometry or tf"):
        MapRun(bag, MapOptions(input=MapInputConfig(poses="bag")))


def test_missing_odometry_and_images_are_named(hand_held, tmp_path):
    with BagReader(hand_held) as bag, pytest.raises(BagError, match="no odometry"):
        LocalizeRun(bag, LocalizeOptions(input=LocalizeInputConfig(motion="odometry")))
    blind = write(tmp_path / "blind", color=False, count=2)
    with BagReader(blind) as bag, pytest.raises(BagError, match=r"never located.*registered image"):
        LocalizeRun(bag).run()


def test_command_writes_trajectory_covariances_and_picture(hand_held, tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["localize", str(hand_held), "--out", str(out)])
    assert result.exit_code == 0, result.output
    tum = np.loadtxt(out / "trajectory.txt")
    covariances = np.loadtxt(out / "covariances.txt")
    assert tum.shape == (10, 8) and covariances.shape == (10, 37)
    np.testing.assert_allclose(tum[:, 0], 1e-9 * (START + STEP * np.arange(10)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tum[:, 4:], axis=1), 1.0, atol=1e-6)
    last = covariances[-1, 1:].reshape(6, 6)
    assert np.linalg.eigvalsh(last)[0] > 0.0
    moved = tum[-1, 1:4] - tum[0, 1:4]
    np.testing.assert_allclose(moved, (pose(9) - pose(0))[:3, 3], atol=0.006)
    assert (out / "trajectory.png").stat().st_size > 1000
    assert json.loads((out / "summary.json").read_text())["poses"] == 10


def test_command_fails_with_one_line(tmp_path):
    result = CliRunner().invoke(app, ["localize", str(tmp_path / "none"), "--out", str(tmp_path)])
    assert result.exit_code != 0
    assert "there is no bag" in str(result.exception)
