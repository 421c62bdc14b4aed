"""What hangs on a keyframe follows it; depth seen by another camera; where odometry says to be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PinholeCamera,
    TransformRecord,
    make_transform,
)
from infomap_ros.localization.filter.config import KeptPoses
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.robot_motion import RobotMotion
from infomap_ros.replay.localize_run import TrajectoryRecorder
from infomap_ros.replay.sequences.frame_files import ColorCamera, register_depth


def turned(yaw: float, x: float, y: float = 0.0) -> np.ndarray:
    return make_transform(Rotation.from_euler("z", yaw).as_matrix(), [x, y, 0.0])


def kept(poses: dict[int, np.ndarray]) -> KeptPoses:
    stamps = np.array(list(poses), np.int64)
    return KeptPoses(stamps, np.array(list(poses.values())), np.zeros((len(poses), 6, 6)))


def test_poses_follow_the_keyframe_before_them_when_it_is_corrected():
    recorder, true = TrajectoryRecorder(), [turned(0.1 * i, 1.0 * i) for i in range(6)]
    drift = turned(0.05, 0.2, 0.1)
    believed = [*true[:2], *(drift @ pose for pose in true[2:])]
    frames: dict[int, np.ndarray] = {}
    for stamp, pose in enumerate(believed):
        if stamp in (0, 2, 4):
            frames[stamp] = pose
        if stamp == 5:  # the target corrects the last keyframes
            frames = {0: true[0], 2: true[2], 4: true[4]}
            pose = true[5]
        recorder.add(stamp, pose, np.eye(6), kept(frames))
    np.testing.assert_allclose(recorder.known_then().transforms[2:5], believed[2:5])
    np.testing.assert_allclose(recorder.known_now().transforms, true, atol=1e-12)


def test_what_hung_on_a_keyframe_that_was_given_up_follows_another():
    recorder = TrajectoryRecorder()
    recorder.add(0, turned(0.0, 0.0), np.eye(6), kept({0: turned(0.0, 0.0)}))
    both = {0: turned(0.0, 0.0), 2: turned(0.3, 2.0)}
    recorder.add(3, turned(0.3, 3.0), np.eye(6), kept(both))
    fewer = {0: turned(0.5, 0.0)}  # 2 was given up, and 0 turned since
    recorder.add(4, turned(0.8, 4.0), np.eye(6), kept(fewer))
    expected = turned(0.5, 0.0) @ turned(0.3, 3.0)
    np.testing.assert_allclose(recorder.known_now().transforms[1], expected, atol=1e-12)


def test_depth_of_a_slanted_plane_is_that_of_the_other_camera():
    camera = PinholeCamera(160, 120, 140.0, 140.0, 80.0, 60.0)
    color = ColorCamera(PinholeCamera(160, 120, 120.0, 120.0, 78.0, 61.0), (-0.03, 0.005, 0.0))
    u = np.arange(160.0)[None, :].repeat(120, axis=0)
    slope = 0.3
    depth = 1.5 / (1.0 - slope * (u - camera.cx) / camera.fx)  # z = 1.5 + 0.3 x
    seen = register_depth(np.rint(1000 * depth).astype(np.uint16), camera, color)
    expected = (1.5 + slope * 0.03) / (1.0 - slope * (u - 78.0) / 120.0)
    measured = seen > 0
    assert measured[30:90, 40:120].mean() > 0.99
    error = 1e-3 * seen[measured] - expected[measured]
    assert np.abs(error).max() < 0.005  # half a pixel of the slope


def test_of_two_surfaces_the_nearer_one_is_seen():
    camera = PinholeCamera(40, 30, 40.0, 40.0, 20.0, 15.0)
    color = ColorCamera(camera, (-0.1, 0.0, 0.0))
    depth = np.full((30, 40), 2000, np.uint16)
    depth[:, 20:] = 1000  # 4 px to the left in the color image, the far one 2 px
    seen = register_depth(depth, camera, color)
    assert (seen[:, 16:36] == 1000).all()
    assert (seen[:, :16] == 2000).all()


ARM = """<robot name="arm"><link name="base_link"/><link name="optical"/>
<joint name="slide" type="prismatic"><parent link="base_link"/><child link="optical"/>
<axis xyz="0 0 1"/><limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>"""


def test_odometry_and_joints_place_the_camera():
    motion = RobotMotion("optical", RobotModel.from_urdf(ARM))
    with pytest.raises(PoseUnavailableError, match="no odometry"):
        motion.posture(0)
    for stamp in (0, 100_000_000):
        x = stamp * 1e-8
        motion.add(OdometryRecord(stamp, "odom", turned(0.0, x), None, "base_link"))
        motion.add(JointStateRecord(stamp, "", ("slide",), np.array([0.1 + x])))
    posture = motion.posture(50_000_000)
    np.testing.assert_allclose(posture.T_odom_base[:3, 3], [0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(posture.T_odom_camera[:3, 3], [0.5, 0.0, 0.6], atol=1e-9)


def test_without_a_description_tf_places_the_camera():
    mount = make_transform(np.eye(3), [0.2, 0.0, 0.3])
    motion = RobotMotion("optical", None, [TransformRecord(0, "base_link", "optical", mount, True)])
    motion.add(OdometryRecord(5, "odom", turned(0.0, 1.0), None, "base_link"))
    np.testing.assert_allclose(motion.posture(5).T_odom_camera[:3, 3], [1.2, 0.0, 0.3])
    lost = RobotMotion("optical")
    lost.add(OdometryRecord(5, "odom", turned(0.0, 1.0), None, "base_link"))
    with pytest.raises(PoseUnavailableError):
        lost.posture(5)
