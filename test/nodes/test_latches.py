"""One odd message, at the start or between good ones, decides nothing for ever."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import String

from infomap_ros.errors import InfomapError, MalformedMessageError
from infomap_ros.geometry import TransformRecord, make_transform
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.nodes.common.health import Health
from infomap_ros.nodes.robot import description_listener
from infomap_ros.nodes.robot.odometry_listener import FrameListener
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig

ROBOT = """<robot name="r"><link name="base_link"/><link name="cam"/>
  <joint name="j" type="fixed"><parent link="base_link"/><child link="cam"/></joint></robot>"""


class StubNode:
    """Gives the messages to the listeners as `MonitoredNode` does: errors become drops."""

    def __init__(self) -> None:
        self.receive: dict[str, Any] = {}
        self.warnings: list[str] = []
        self.timers: list[Any] = []
        self.health = Health()
        self.configs = (RobotTrackerConfig(), JointBufferConfig(), AssumedPoseConfig())

    def config(self, kind: type) -> Any:
        return next(config for config in self.configs if isinstance(config, kind))

    def listen(self, _kind: Any, topic: str, receive: Any, _profile: Any, **_options: Any) -> None:
        self.receive[topic] = receive

    def get_logger(self) -> Any:
        return SimpleNamespace(info=lambda *_: None, warning=self.warnings.append)

    def repeat(self, _period: float, call: Any) -> None:
        self.timers.append(call)

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
    assert tracker._tracked.is_described
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
    assert tracker._tracked.is_described
    assert "package://gone/a.stl" in node.warnings[0]


def test_frames_that_flood_tf_do_not_silence_the_others() -> None:
    heard: list[TransformRecord] = []
    node = StubNode()
    listener = FrameListener(node, heard.append)  # type: ignore[arg-type]
    listener.listen_to_moving()
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


def test_the_first_ten_thousand_frames_do_not_silence_a_later_one() -> None:
    """What is used, or told again, stays known too."""
    node, heard, tree = StubNode(), [], TransformTree()
    listener = FrameListener(node, lambda edge: (heard.append(edge), tree.add_transform(edge)))  # type: ignore[arg-type]
    listener.listen_to_moving()
    node.give("/tf_static", SimpleNamespace(transforms=[edge("mount"), edge("idle")]))
    for batch in range(25):
        for topic in ("/tf", "/tf_static"):
            junk = [edge(f"{topic}{batch}_{number}") for number in range(999)]
            node.give(topic, SimpleNamespace(transforms=junk))
        assert tree.at("base_link", "mount", 10**9).child_frame_id == "mount"
    node.give("/tf", SimpleNamespace(transforms=[edge("late", "mount")]))
    assert heard[-1].child_frame_id == "late"
    assert tree.at("base_link", "late", 10**9).frame_id == "base_link"
    assert len(tree._edges) == len(listener.static) == 10_000
    assert tree.root_of("idle") == "idle"


def test_a_camera_frame_is_found_after_ten_thousand_others_and_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, told = [100.0], []
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(description_listener, "time", clock)
    node = StubNode()
    listener = description_listener.DescriptionListener(node, told.append)  # type: ignore[arg-type]
    listener.want("optical")
    node.give("robot_description", String(data=ROBOT))

    def flood(name: str) -> None:
        for batch in range(12):
            junk = [edge(f"{name}{batch}_{number}") for number in range(999)]
            node.give("/tf_static", SimpleNamespace(transforms=junk))

    flood("before")
    node.give("/tf_static", SimpleNamespace(transforms=[edge("optical", "cam")]))
    flood("after")  # within the second for which what was sent stands
    now[0] += 1.0
    for call in node.timers:
        call()
    assert len(told) == 2
    assert "optical" in told[-1]


def test_two_publishers_who_differ_have_the_description_read_once_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, told = [100.0], []
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(description_listener, "time", clock)
    node = StubNode()
    listener = description_listener.DescriptionListener(node, told.append)  # type: ignore[arg-type]
    listener.want("optical")
    node.give("robot_description", String(data=ROBOT))
    for _ in range(500):
        for parent in ("cam", "base_link"):
            node.give("/tf_static", SimpleNamespace(transforms=[edge("optical", parent)]))
    assert len(told) == 2  # the text, and the first of the two
    now[0] += 1.0
    for call in node.timers:
        call()
    assert len(told) == 3  # what was told last is not lost
    assert 'link="base_link"' in told[-1].partition("optical_by_tf")[2]
    for call in node.timers:
        call()
    assert len(told) == 3


def test_a_joint_that_falls_silent_is_named_while_others_go_on() -> None:
    now, node = [100.0], StubNode()
    node.health = Health(lambda: now[0])
    RobotTracker(node, infos=("left/camera_info",))  # type: ignore[arg-type]
    turning = ROBOT.replace('type="fixed">', 'type="continuous"><axis xyz="0 0 1"/>')
    node.give("robot_description", String(data=turning))
    node.give("left/camera_info", info("cam"))
    names, position = ["j", "gripper", "wheel"], [0.0, 0.0, 0.0]
    for second in range(20):
        now[0] += 1.0
        state = JointState(name=names, position=position)
        state.header.stamp.sec = second + 1
        node.give("joint_states", state)
        if second == 5:
            assert not node.health.complaints()
            names, position = ["j", "wheel"], [0.0, 0.0]
        if second == 12:
            assert not node.health.complaints()  # grippers are told of on change
            assert node.health.values()["silent joints"] == "gripper"
            position = [np.nan, 0.0]  # an encoder has failed
    assert node.health.complaints() == ["nothing comes of joint j any more"]
    names, position = ["j", "gripper", "wheel"], [0.0, 0.0, 0.0]
    node.give("joint_states", JointState(name=names, position=position))
    assert not node.health.complaints()
    assert "silent joints" not in node.health.values()


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
