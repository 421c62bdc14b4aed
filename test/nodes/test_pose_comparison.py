"""Poses of a run against its ground truth."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from infomap_ros.geometry import PoseRecord, PoseUncertainty, make_transform, perturb_transform
from infomap_ros.messages import encode_pose
from infomap_ros.messages.pose_uncertainty import encode_pose_uncertainty
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.live.live_truth import LiveTruth, PoseComparison


class FakeRun:
    """Hands messages to those who subscribe."""

    def __init__(self) -> None:
        self.topics: dict[str, Any] = {}

    def subscribe(self, kind: type, topic: str, receive: Any, profile: Any = None) -> None:
        self.topics[topic] = receive

    def tell(self, topic: str, stamp: int, transform: np.ndarray, sigma: float = 1e-3) -> None:
        record = PoseRecord(stamp, "map", transform, sigma**2 * np.eye(6))
        self.topics[topic](encode_pose(RclpyMessageTypes(), record))


def test_errors_are_those_of_the_motion_since_the_first_pose() -> None:
    run = FakeRun()
    comparison = PoseComparison(run)  # type: ignore[arg-type]
    elsewhere = perturb_transform(np.eye(4), [3.0, -1.0, 0.5, 0.2, 0.1, 1.5])
    for stamp in range(5):
        true = make_transform(np.eye(3), [0.5 * stamp, 0.0, 0.0])
        off = make_transform(np.eye(3), [0.5 * stamp, 0.003 * stamp, 0.0])
        run.tell("ground_truth/camera_pose", stamp, true)
        run.tell("camera_pose", stamp, elsewhere @ off)
    run.tell("ground_truth/camera_pose", 99, np.eye(4))
    figures = comparison.figures()
    assert figures["poses"] == 5
    assert figures["path_length_m"] == pytest.approx(2.0)
    assert figures["largest_pose_error_mm"] == pytest.approx(12.0)
    assert figures["pose_error_mm"] == pytest.approx(3.0 * np.sqrt(6.0), abs=0.01)


def test_without_truth_there_is_only_their_number() -> None:
    run = FakeRun()
    comparison = PoseComparison(run)  # type: ignore[arg-type]
    run.tell("camera_pose", 1, np.eye(4))
    assert comparison.figures() == {"poses": 1}


def test_published_poses_are_held_against_the_truth_in_the_frame_of_the_map() -> None:
    run = FakeRun()
    truth = LiveTruth(run, "/rover2/")  # type: ignore[arg-type]
    T_world_map = perturb_transform(np.eye(4), [3.0, -1.0, 0.5, 0.2, 0.1, 1.5])
    error, sigma = np.array([0.02, -0.01, 0.005, 0.003, -0.002, 0.01]), 0.02
    for stamp in range(4):
        believed = make_transform(np.eye(3), [0.5 * stamp, 0.0, 0.0])
        true = T_world_map @ perturb_transform(believed, error)
        run.tell("/rover2/ground_truth/camera_pose", stamp * 10**9, true)
        if stamp != 2:
            run.tell("/rover2/camera_pose", stamp * 10**9, believed, sigma)
    for count in (2, 5, 4):  # restarted, it counts on from what it wrote last
        message = String(data=json.dumps({"count": count}))
        run.topics["/rover2/ground_truth/contacts"](message)

    poses = truth.poses(T_world_map)

    assert [each.pose.stamp for each in poses] == [0, 10**9, 3 * 10**9]
    for pose in poses:
        np.testing.assert_allclose(pose.error, error, atol=1e-9)
        assert pose.nees == pytest.approx(error @ error / sigma**2)
    assert (truth.contacts, truth.simulated_seconds) == (5, 3.0)


def test_poses_before_and_after_a_map_was_moved_are_each_compared_in_its_frame() -> None:
    run, types = FakeRun(), RclpyMessageTypes()
    truth = LiveTruth(run)  # type: ignore[arg-type]
    heading = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    begin = make_transform(heading, [1.0, 2.0, 0.3])
    run.tell(
        "ground_truth/base_pose", 0, begin @ perturb_transform(np.eye(4), [0, 0, 0, 0, 0.1, 0])
    )
    frames = {7: begin, 3: perturb_transform(np.eye(4), [4.0, 1.0, 0.0, 0.0, 0.0, 0.7])}
    error = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.01])
    for stamp, origin in enumerate((7, 7, 3, 3, 3)):
        believed = make_transform(np.eye(3), [0.1 * stamp, 0.0, 0.0])
        parts = PoseUncertainty(1e-4 * np.eye(6), origin=origin)
        message = encode_pose_uncertainty(types, stamp, "map", parts)
        run.topics["camera_pose_uncertainty"](message)
        run.tell("camera_pose", stamp, believed)
        true = frames[origin] @ perturb_transform(believed, error)
        run.tell("ground_truth/camera_pose", stamp, true)
    run.tell("camera_pose", 9, np.eye(4))  # that does not say in which map
    run.tell("ground_truth/camera_pose", 9, np.eye(4))

    assert truth.origins == [(0, 7), (2, 3)]
    np.testing.assert_allclose(truth.begin, begin, atol=1e-9)
    for origin, stamps in ((7, [0, 1]), (3, [2, 3, 4])):
        poses = truth.poses(frames[origin], origin)
        assert [each.pose.stamp for each in poses] == stamps
        for pose in poses:
            np.testing.assert_allclose(pose.error, error, atol=1e-9)
    assert len(truth.poses(begin)) == 6
