"""The bag in bags/ is what its README says, and the stereo sensor sees the true scene in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    PoseRecord,
    Record,
    TextRecord,
    points_inside,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import transform_points
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import build_scene
from infomap_ros.stereo import RangeCloud, StereoRangeSensor, StereoRectifier

BAG = find_share("bags/rover_rocks")
CHOSEN = (0, 9, 16, 26)  # far, near, with the robot's body in view, near the wall


@dataclass(frozen=True)
class Shot:
    """One pair of the bag, measured."""

    cloud: RangeCloud
    pose: PoseRecord
    joints: dict[str, float]


@pytest.fixture(scope="module")
def records() -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = {}
    with BagReader(BAG) as reader:
        for entry in reader.records():
            found.setdefault(entry.topic, []).append(entry.record)
    return found


@pytest.fixture(scope="module")
def scene(records: dict[str, list[Record]]) -> World:
    (text,) = records["/ground_truth/scene"]
    assert isinstance(text, TextRecord)
    return build_scene(text.text)


@pytest.fixture(scope="module")
def shots(records: dict[str, list[Record]]) -> list[Shot]:
    left, right = (records[f"/{side}/camera_info"][0] for side in ("left", "right"))
    assert isinstance(left, CameraInfoRecord)
    assert isinstance(right, CameraInfoRecord)
    rectifier = StereoRectifier(left.calibration, right.calibration)
    sensor = StereoRangeSensor(rectifier.rig)
    joints = {record.stamp: record for record in records["/joint_states"]}

    def measured() -> Iterator[Shot]:
        for index in CHOSEN:
            images = [records[f"/{side}/image_raw"][index] for side in ("left", "right")]
            pixels = [image.pixels for image in images if isinstance(image, ImageRecord)]
            cloud = sensor.measure(*rectifier.rectify(pixels[0], pixels[1]))
            pose = records["/ground_truth/camera_pose"][index]
            state = joints[pose.stamp]
            assert isinstance(pose, PoseRecord)
            assert isinstance(state, JointStateRecord)
            angles = dict(zip(state.names, state.positions.tolist(), strict=True))
            yield Shot(cloud, pose, angles)

    return list(measured())


def test_it_is_small(records: dict[str, list[Record]]) -> None:
    assert sum(file.stat().st_size for file in Path(BAG).iterdir()) < 15e6
    assert len(records["/left/image_raw"]) == len(records["/right/image_raw"]) == 34


def test_noise_of_the_poses_is_what_their_covariance_says(
    records: dict[str, list[Record]],
) -> None:
    total = 0.0
    pairs = list(zip(records["/camera_pose"], records["/ground_truth/camera_pose"], strict=True))
    for measured, truth in pairs:
        assert isinstance(measured, PoseRecord)
        assert isinstance(truth, PoseRecord)
        assert measured.covariance is not None
        assert truth.covariance is None
        turn = truth.transform[:3, :3] @ measured.transform[:3, :3].T
        error = np.concatenate(
            [
                truth.transform[:3, 3] - measured.transform[:3, 3],
                Rotation.from_matrix(turn).as_rotvec(),
            ]
        )
        total += error @ np.linalg.solve(measured.covariance, error)
    low, high = chi2.ppf((0.025, 0.975), 6 * len(pairs))
    assert low < total < high


def test_odometry_drifts_within_its_covariance(records: dict[str, list[Record]]) -> None:
    first, last = (records["/odom"][index] for index in (0, -1))
    assert isinstance(first, PoseRecord)
    assert isinstance(last, PoseRecord)
    assert np.allclose(first.transform, np.eye(4))
    assert last.covariance is not None
    assert 0.005 < np.sqrt(last.covariance[0, 0]) < 0.2


def test_stereo_is_dense_and_on_the_true_surface(shots: list[Shot], scene: World) -> None:
    for shot in shots:
        near = shot.cloud.range_image < 4.0
        points = shot.cloud.organized_points[near]
        robot = RobotModel.from_urdf(find_share("config/rover.urdf"))
        body = robot.solids_in("left_camera_optical_frame", shot.joints)
        points = points[~points_inside(points, body, 0.05)]
        distance = scene.surface_distance(transform_points(shot.pose.transform, points[::7]))
        assert shot.cloud.density > 0.6
        assert np.median(distance) < 0.01
        assert (distance < 0.05).mean() > 0.95


def test_the_robots_body_is_seen_where_the_description_puts_it(
    shots: list[Shot], scene: World
) -> None:
    robot = RobotModel.from_urdf(find_share("config/rover.urdf"))
    counts = []
    for shot in shots:
        points = shot.cloud.organized_points.reshape(-1, 3)
        body = robot.solids_in("left_camera_optical_frame", shot.joints)
        inside = points[points_inside(points, body, 0.02)]
        counts.append(len(inside))
        if len(inside):
            world = transform_points(shot.pose.transform, inside)
            assert np.median(scene.surface_distance(world)) > 0.05
    assert counts[0] == 0
    assert counts[2] > 2000
