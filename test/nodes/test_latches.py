"""One odd message, at the start or between good ones, decides nothing for ever."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import String

from infomap_ros.errors import InfomapError, MalformedMessageError
from infomap_ros.geometry import TransformRecord, make_transform
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.nodes.robot import description_listener
from infomap_ros.nodes.robot.frame_listener import FrameListener
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig

ROBOT = """<robot name="r"><link name="base_link"/><link name="cam"/>
  <joint name="j" type="fixed"><parent link="base_link"/><child link="cam"/></joint></robot>"""


class StubNode:
    """Gives the messages to the listeners as `MonitoredNode` does: errors become drops."""

    def __init__(self) -> None:
        self.receive: dict[str, Any] = {}
        self.warnings: list[str] = []
        self.configs = (RobotTrackerConfig(), JointBufferConfig(), AssumedPoseConfig())

    def config(self, kind: type) -> Any:
        return next(config for config in self.configs if isinstance(config, kind))

    def listen(self, _kind: Any, topic: str, receive: Any, _profile: Any, **_options: Any) -> None:
        self.receive[topic] = receive

    def get_logger(self) -> Any:
        return SimpleNamespace(info=lambda *_: None, warning=self.warnings.append)

    def create_timer(self, *_arguments: Any, **_options: Any) -> None:
        """Nothing waits here."""

    def resolve_topic_name(self, topic: str) -> str:
        return f"/{topic}"

    def count_publishers(self, _topic: str) -> int:
        return 1

    def give(self, topic: str, *message: Any) -> None:
        with contextlib.suppress(InfomapError):
            self.receive[topic](*message)


def info(frame: str) -> CameraInfo:
    message = CameraInfo(height=240, width=320, distortion_model="plumb_bob", d=[0.0] * 5)
    message.header.frame_id = frame
    message.k = [250.0, 0.0, 160.0, 0.0, 250.0, 120.0, 0.0, 0.0, 1.0]
    message.r = np.eye(3).ravel().tolist()
    message.p = [250.0, 0.0, 160.0, 0.0, 0.0, 250.0, 120.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def edge(child: str, parent: str = "base_link") -> Any:
    zero = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id=parent),
        child_frame_id=child,
        transform=SimpleNamespace(translation=zero, rotation=turn),
    )


@pytest.mark.parametrize("odd", ["junk", "", "cam"])
@pytest.mark.parametrize("is_first", [True, False])
def test_a_camera_info_of_another_frame_is_forgotten(odd: str, is_first: bool) -> None:
    node = StubNode()
    tracker = RobotTracker(node, infos=("left/camera_info",))  # type: ignore[arg-type]
    node.give("robot_description", String(data=ROBOT))
    for frame in [odd, "cam", "cam"] if is_first else ["cam", "cam", odd, "cam"]:
        node.give("left/camera_info", info(frame))
    assert tracker.is_described
    assert tracker.robot.camera_frame == "cam"


def test_a_camera_that_is_exchanged_is_taken() -> None:
    node = StubNode()
    tracker = RobotTracker(node, infos=("left/camera_info",))  # type: ignore[arg-type]
    node.give("robot_description", String(data=ROBOT))
    for frame in ("cam", "cam", "base_link", "base_link"):
        node.give("left/camera_info", info(frame))
    assert tracker.robot.camera_frame == "base_link"


def test_a_mesh_that_is_missing_is_said() -> None:
    node = StubNode()
    tracker = RobotTracker(node, infos=("left/camera_info",))  # type: ignore[arg-type]
    mesh = '<collision><geometry><mesh filename="package://gone/a.stl"/></geometry></collision>'
    text = ROBOT.replace('<link name="cam"/>', f'<link name="cam">{mesh}</link>')
    node.give("robot_description", String(data=text))
    node.give("left/camera_info", info("cam"))
    assert tracker.is_described
    assert "package://gone/a.stl" in node.warnings[0]


def test_frames_that_flood_tf_do_not_silence_the_others() -> None:
    heard: list[TransformRecord] = []
    node = StubNode()
    listener = FrameListener(node, heard.append)  # type: ignore[arg-type]
    listener.hear_moving()
    with pytest.raises(MalformedMessageError, match="10001 transforms"):
        flood = [edge(f"junk{number}") for number in range(10_001)]
        node.receive["/tf_static"](SimpleNamespace(transforms=flood))
    for _ in range(10):
        node.give("/tf", SimpleNamespace(transforms=[edge("camera")]))
    assert [each.child_frame_id for each in heard] == ["camera"] * 10


def test_a_description_is_read_once_however_many_frames_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[str] = []
    read: list[int] = []
    complete = description_listener.with_fixed_frames

    def count(*arguments: Any) -> str:
        read.append(1)
        return complete(*arguments)

    monkeypatch.setattr(description_listener, "with_fixed_frames", count)
    node = StubNode()
    listener = description_listener.DescriptionListener(node, told.append)  # type: ignore[arg-type]
    listener.want("optical")
    node.give("robot_description", String(data=ROBOT))
    for number in range(500):
        node.give("/tf_static", SimpleNamespace(transforms=[edge(f"frame{number}")]))
    assert len(read) == 1
    for _ in range(5):
        node.give("/tf_static", SimpleNamespace(transforms=[edge("optical", "cam")]))
    assert len(read) == len(told) == 2
    assert "optical" in told[-1]


@pytest.mark.parametrize("name", ["a\x1b[2J", "map\n[INFO] mission complete", "x" * 300])
def test_a_name_that_a_terminal_would_obey_is_refused(name: str) -> None:
    listener = FrameListener(StubNode(), lambda _: None)  # type: ignore[arg-type]
    with pytest.raises(MalformedMessageError) as caught:
        listener._on_transforms(SimpleNamespace(transforms=[edge(name)]), is_static=True)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 200


def test_transforms_are_as_they_were_told() -> None:
    heard: list[TransformRecord] = []
    node = StubNode()
    FrameListener(node, heard.append)  # type: ignore[arg-type]
    node.give("/tf_static", SimpleNamespace(transforms=[edge("camera")]))
    np.testing.assert_array_equal(heard[0].transform, make_transform(np.eye(3), (0.0, 0.0, 0.0)))
