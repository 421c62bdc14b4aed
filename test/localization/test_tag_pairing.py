"""Tags that another node tells: their conventions, what is believed, which view they are of."""

from __future__ import annotations

from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.geometry.records import WaitingQueueConfig
from infomap_ros.localization.target.tag_board import TagBoard
from infomap_ros.localization.target.tag_detection import (
    TagDetectionsRecord,
    TagPairing,
    believed_tags,
)
from infomap_ros.localization.target.tag_detector import TagTargetDetector
from infomap_ros.localization.target.target import TargetSighting
from infomap_ros.messages.fiducials import decode_tag_detections

from .tag_scenes import CAMERA, BoardView, pose_error

BOARD = TagBoard()
LEVEL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
POSE = make_transform(Rotation.from_rotvec([0.1, 0.5, 0.3]).as_matrix() @ LEVEL, [0.1, -0.05, 1.2])
# What the detector of AprilTag 3.4.5 found in an image of the board at this pose: `p` of each.
APRILTAG = {
    0: [(376.85, 142.46), (320.30, 128.46), (304.16, 190.30), (358.50, 207.74)],
    1: [(458.23, 162.61), (392.12, 146.24), (373.11, 212.40), (436.42, 232.73)],
    2: [(354.02, 223.60), (300.23, 205.36), (284.92, 264.05), (336.63, 285.34)],
    3: [(431.12, 249.74), (368.49, 228.50), (350.53, 291.07), (410.56, 315.80)],
}


def detections(**changes: Any) -> Message:
    """As apriltag_ros sends them, with changes of tag 1."""
    tags = []
    for one, quad in APRILTAG.items():
        corners = [Message(x=x, y=y) for x, y in quad]
        told = {"family": "tag36h11", "id": one, "hamming": 0, "decision_margin": 170.0}
        told |= {"corners": corners} | (changes if one == 1 else {})
        tags.append(Message(**told))
    stamp = Message(sec=0, nanosec=5)
    return Message(header=Message(stamp=stamp, frame_id="left"), detections=tags)


def test_corners_of_apriltag_are_where_the_camera_sees_them_and_tell_the_pose(
    rng: np.random.Generator,
) -> None:
    told = decode_tag_detections(detections())
    assert (told.stamp, told.frame_id) == (5, "left")
    seen = CAMERA.project(transform_points(POSE, BOARD.corners))
    np.testing.assert_allclose(told.tags["corners"], seen, atol=0.15)
    view = BoardView(BOARD, POSE, rng)
    view.image[:] = 128
    detector = TagTargetDetector()
    assert not isinstance(detector.detect(view), TargetSighting)
    view.tags = believed_tags(told.tags, view.image.shape, lambda *_: None)
    sighting = detector.detect(view)
    assert isinstance(sighting, TargetSighting)
    error = pose_error(sighting.T_camera_target, POSE)
    assert np.linalg.norm(error[:3]) < 0.005 and np.linalg.norm(error[3:]) < 0.01
    assert error @ np.linalg.solve(sighting.covariance, error) < 22.5


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"hamming": 1}, "tag with wrong bits"),
        ({"decision_margin": 1.64}, "tag of low decision margin"),  # of a false one, tag16h5
        ({"family": "tagStandard41h12"}, "tag of an unknown family or id"),
        ({"id": 587}, "tag of an unknown family or id"),
        ({"id": 0}, "tag twice in an image"),
        ({"corners": [Message(x=x, y=y) for x, y in APRILTAG[1][::-1]]}, "another order"),
        ({"corners": [Message(x=x / 9, y=y / 9) for x, y in APRILTAG[1]]}, "tag too small"),
        ({"corners": [Message(x=x + 300, y=y) for x, y in APRILTAG[1]]}, "tag beyond the image"),
    ],
)
def test_a_tag_that_is_not_believed_is_counted(changes: dict[str, Any], reason: str) -> None:
    why: list[str] = []
    tags = decode_tag_detections(detections(**changes)).tags
    left = believed_tags(tags, (480, 640), lambda reason, _: why.append(reason))
    assert len(left) == 4 - len(why) and reason in why[0] and len(set(why)) == 1
    assert 1 not in left["id"] and {2, 3} <= {*left["id"]}


@pytest.mark.parametrize(
    "changes",
    [
        {"corners": []},
        {"decision_margin": np.nan},
        {"id": -1},
        {"corners": [Message(x=1, y=2)] * 3},
    ],
)
def test_a_message_that_contradicts_its_type_is_malformed(changes: dict[str, Any]) -> None:
    with pytest.raises(MalformedMessageError):
        decode_tag_detections(detections(**changes))


MS = 1_000_000


class Stream:
    """Views each 100 ms, and what became of them."""

    def __init__(self, tolerance: float = 0.0) -> None:
        self.drops: list[str] = []
        waiting = WaitingQueueConfig(capacity=5, max_wait=1.0)
        self.pairing = TagPairing(waiting, tolerance, lambda reason, _: self.drops.append(reason))
        self.pairing.frame_id = "left"
        self.tags = decode_tag_detections(detections()).tags
        self.done: list[tuple[int, int]] = []

    def view(self, number: int) -> None:
        self._note([Message(stamp=100 * MS * number)])

    def tell(self, number: float, frame: str = "left") -> None:
        self.pairing.add(TagDetectionsRecord(round(100 * MS * number), frame, self.tags))
        self._note([])

    def _note(self, views: list[Message]) -> None:
        for view, tags in self.pairing.take(views):
            self.done.append((view.stamp // (100 * MS), len(tags)))


def test_views_wait_for_their_tags_and_keep_their_order() -> None:
    stream = Stream()
    for number in (1, 2, 3):
        stream.view(number)
    stream.tell(2)
    assert stream.done == [(1, 0), (2, 4)]
    stream.tell(1)
    stream.tell(4)
    stream.view(4)
    assert stream.done == [(1, 0), (2, 4), (3, 0), (4, 4)]
    assert stream.drops == ["tags after their image"]


def test_wrong_stamps_and_frames_are_counted_and_do_no_harm_to_others() -> None:
    stream = Stream()
    stream.view(1)
    stream.tell(1, "right")
    stream.tell(40.0)
    assert stream.done == []
    stream.tell(1.5)
    stream.view(2)
    stream.tell(2)
    assert stream.done == [(1, 0), (2, 4)]
    assert stream.drops == ["wrong frame", "tags without their image"]


def test_a_detector_that_ends_costs_one_wait() -> None:
    stream = Stream()
    for number in range(1, 7):
        stream.view(number)
    assert [one for one, _ in stream.done] == [1, 2, 3, 4, 5, 6]
    stream.view(7)
    assert stream.done[-1] == (7, 0)
    stream.tell(7)
    stream.view(8)
    assert stream.done[-1] == (7, 0)
    stream.tell(8)
    assert stream.done[-1] == (8, 4)


def test_stamps_may_differ_by_the_tolerance() -> None:
    stream = Stream(0.02)
    stream.view(1)
    stream.tell(0.9)
    stream.view(2)
    stream.tell(2.15)
    assert stream.done == [(1, 4), (2, 4)]
