"""Odd messages anywhere in good streams: what a node knows soon after is what it knows without.

The nodes run in one process; each message goes straight to the callbacks of their subscriptions, as
the middleware would hand it over, so that an hour of messages takes a minute. A rover that moves
tells its state at 10 Hz; between that come messages of any topic of the seven nodes of a robot of
which one field is odd (not finite, huge, negative, empty, too long), old ones, and stamps of
another time. Each episode ends with good messages for 5 s. Then every node must have the state that
is true, and have used the last images, clouds and odometry. An exception that
leaves a callback is a defect.

Prints one JSON line of figures; exits with 1 at the first episode that ends wrongly, with its seed.

    python benchmarks/fuzz_nodes.py --messages 1000000 --seed 1
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
import rclpy.logging
from rclpy.parameter import Parameter

from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PinholeCamera,
    PointCloudRecord,
    PoseRecord,
    TextRecord,
    make_transform,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages import (
    encode_camera_info,
    encode_image,
    encode_joint_state,
    encode_odometry,
    encode_pose,
    encode_text,
)
from infomap_ros.messages.clouds import encode_point_cloud
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.dead_reckoning import DeadReckoningNode
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.next_best_view import NextBestViewNode
from infomap_ros.nodes.robot_driver import RobotDriverNode
from infomap_ros.nodes.stereo_range import StereoRangeNode

PERIOD = 100_000_000  # of the good streams [ns]
BEGIN = 1_700_000_000_000_000_000  # stamp of the first messages [ns]
AFTER = 50  # rounds of good messages before the state is judged: 5 s
LAST = 10  # rounds at their end of which nothing may be missing
ODD = 40  # odd messages in an episode, at most
SIDES = ("left", "right")
CAMERA = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
BASELINE = 0.1  # [m]
TYPES = RclpyMessageTypes()
ODD_FLOATS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e38, 0.0, -0.0, 1e-320, -1.0, 1e9)
ODD_TEXTS = (
    "",
    "x" * 5000,
    "a\x1b[2J",
    "map\n[INFO] done",
    "<script>",
    "\ufffd\U0001f600",
    "/",
    "odom",
)
ODD_STAMPS = (0, 1, -1, 1_000_000_000, 3600 * 10**9, -3600 * 10**9, 2**31 - 1)


class Recorded:
    """What nodes hand on, by what it is: their stamps [ns]."""

    def __init__(self) -> None:
        self.stamps: dict[str, list[int]] = {}

    def note(self, what: str, stamp: int) -> None:
        """Something of that stamp was handed on."""
        self.stamps.setdefault(what, []).append(stamp)


def watched_nodes(recorded: Recorded) -> list[type]:
    """The nodes, with what is costly in them replaced by a note that it was asked for."""

    class Range(StereoRangeNode):
        def _hand_over(self, images: Any) -> None:
            recorded.note("pairs for stereo_range", images.stamp)

    class Localization(FiducialLocalizationNode):
        def _on_view(self, view: Any, tags: Any) -> None:
            recorded.note("views for fiducial_localization", view.stamp)

    class Fusion(MapFusionNode):
        def _on_scan(self, scan: Any) -> None:
            recorded.note("scans for map_fusion", scan.pose.stamp)

    class Reckoning(DeadReckoningNode):
        def _publish(self, frame: str, base: PoseRecord) -> None:
            recorded.note("poses of dead_reckoning", base.stamp)

    return [Range, Localization, Fusion, Reckoning, NextBestViewNode, ExplorerNode, RobotDriverNode]


@dataclass
class Rover:
    """A robot that moves to and fro: what its sensors and its other nodes say at a stamp."""

    text: str = field(default_factory=lambda: find_share("config/rover.urdf").read_text("utf-8"))

    def __post_init__(self) -> None:
        self.frames = {side: f"{side}_camera_optical_frame" for side in SIDES}
        self._robot = RobotModel.from_urdf(self.text, self.frames["left"], "base_link")
        self.go_to(0)
        rng = np.random.default_rng(7)
        texture = rng.integers(0, 255, (CAMERA.height, CAMERA.width + 4), np.uint8)
        self.images = {"left": texture[:, :-4], "right": texture[:, 4:]}
        self.points = rng.uniform(0.5, 2.0, (12, 16, 3)).astype(np.float32)

    def go_to(self, number: int) -> None:
        """Be where it is in a round."""
        self.joints = {
            joint.name: 0.1 + 0.05 * np.sin(0.1 * number + row)
            for row, joint in enumerate(self._robot.joints)
        }
        self.T_map_base = make_transform(np.eye(3), (1.0 + 0.3 * np.sin(0.02 * number), 0.5, 0.0))
        T_base_camera = self._robot.forward_kinematics(self.joints, self.frames["left"])
        self.T_map_camera = self.T_map_base @ T_base_camera

    def calibration(self, side: str) -> CameraCalibration:
        """Of one camera."""
        offset = -CAMERA.fx * BASELINE if side == "right" else 0.0
        projection = np.hstack([CAMERA.matrix, [[offset], [0.0], [0.0]]])
        size = CAMERA.width, CAMERA.height
        return CameraCalibration(*size, intrinsics=CAMERA.matrix, projection=projection)

    def messages(self, number: int) -> Iterator[tuple[str, Any]]:
        """The messages of a round, with their topics."""
        self.go_to(number)
        stamp = BEGIN + number * PERIOD
        if number % 10 == 0:
            yield "robot_description", encode_text(TYPES, TextRecord(0, "", self.text))
        positions = np.array(list(self.joints.values()))
        state = JointStateRecord(stamp, "", tuple(self.joints), positions)
        yield "joint_states", encode_joint_state(TYPES, state)
        still = np.zeros(6), 1e-6 * np.eye(6)
        odometry = OdometryRecord(stamp, "odom", self.T_map_base, None, "base_link", *still)
        yield "odom", encode_odometry(TYPES, odometry)
        pose = PoseRecord(stamp, "map", self.T_map_camera, 1e-6 * np.eye(6))
        yield "camera_pose", encode_pose(TYPES, pose)
        for side in SIDES:
            info = CameraInfoRecord(stamp, self.frames[side], self.calibration(side))
            yield f"{side}/camera_info", encode_camera_info(TYPES, info)
            image = ImageRecord(stamp, self.frames[side], self.images[side], "mono8")
            yield f"{side}/image_rect", encode_image(TYPES, image)
        cloud = PointCloudRecord(stamp, self.frames["left"], self.points)
        yield "points2", encode_point_cloud(TYPES, cloud)


class OddMessages:
    """Draws what does not belong into a stream.

    Args:
        rng: draws.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._kept: dict[str, list[Any]] = {}

    def keep(self, topic: str, message: Any) -> None:
        """Remember some good messages, to be told again later."""
        kept = self._kept.setdefault(topic, [])
        if len(kept) < 20:
            kept.append(message)
        elif self._rng.random() < 0.1:
            kept[int(self._rng.integers(20))] = message

    def draw(self, topic: str, kind: type, stamp: int) -> Any:
        """An odd message of a topic."""
        kept = self._kept.get(topic)
        if not kept:
            message = kind()
        else:
            message = copy.deepcopy(kept[int(self._rng.integers(len(kept)))])
            if self._rng.random() < 0.1:
                return message  # as it was, late
            self._set_stamp(message, stamp)
        for _ in range(int(self._rng.integers(1, 4))):
            self._spoil(message)
        return message

    def _set_stamp(self, message: Any, stamp: int) -> None:
        if hasattr(message, "header") and stamp > 0:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)

    def _spoil(self, message: Any) -> None:
        """Change one field somewhere."""
        if hasattr(message, "header") and self._rng.random() < 0.2:
            stamp = message.header.stamp
            now = stamp.sec * 10**9 + stamp.nanosec + int(self._rng.choice(ODD_STAMPS))
            stamp.sec, stamp.nanosec = divmod(min(max(now, 0), (2**31 - 1) * 10**9), 10**9)
            return
        names = list(message.get_fields_and_field_types())
        if not names:
            return  # nothing in it can be odd
        name = str(self._rng.choice(names))
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            self._spoil(value)
            return
        try:
            setattr(message, name, self._odd(value))
        except (AssertionError, OverflowError, TypeError, ValueError):
            return  # no message can say that

    def _odd(self, value: Any) -> Any:
        rng = self._rng
        if isinstance(value, bool):
            return not value
        if isinstance(value, str):
            cut = int(rng.integers(len(value) + 1))
            texts = (*ODD_TEXTS, value[:cut], value[:cut] + "\x00" + value[cut:])
            return texts[int(rng.integers(len(texts)))]
        if isinstance(value, int):
            return int(rng.choice((0, 1, -1, 2, 255, 65535, 2**31 - 1, -(2**31), value + 1)))
        if isinstance(value, float):
            return float(rng.choice(ODD_FLOATS))
        return self._odd_sequence(value)

    def _odd_sequence(self, values: Any) -> Any:
        rng, changed = self._rng, copy.deepcopy(values)
        if not len(changed):
            return changed
        how = rng.random()
        if how < 0.5 or isinstance(values, np.ndarray):
            row = int(rng.integers(len(changed)))
            if hasattr(changed[row], "get_fields_and_field_types"):
                self._spoil(changed[row])
            else:
                changed[row] = self._odd(changed[row])
            return changed
        if how < 0.7:
            return changed[: int(rng.integers(len(changed)))]
        return changed * 2


class Episodes:
    """The nodes, and streams that are disturbed.

    Args:
        seed: of all draws.
    """

    def __init__(self, seed: int) -> None:
        self._recorded, self._rover = Recorded(), Rover()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0")))
        rclpy.logging.set_logger_level("", rclpy.logging.LoggingSeverity.FATAL)
        rover = {
            "controllers": [f"arm: {', '.join(self._rover.joints)}"],
            "arm": "joint_trajectory",
        }
        values = {RobotDriverNode: rover | {"base": "cmd_vel"}, ExplorerNode: {"autostart": False}}
        self._nodes = []
        for kind in watched_nodes(self._recorded):
            given = [Parameter(name, value=value) for name, value in values.get(kind, {}).items()]
            name = f"/fuzzed_{len(self._nodes)}"
            self._nodes.append(
                kind(context=self._context, namespace=name, parameter_overrides=given)
            )
        self._subscriptions = [
            (node, topic.removeprefix(node.get_namespace() + "/"), each.msg_type, each.callback)
            for node in self._nodes
            for each in node.subscriptions
            for topic in [each.topic_name]
        ]
        self._by_topic: dict[str, list[Callable[[Any], None]]] = {}
        for _, topic, _, callback in self._subscriptions:
            self._by_topic.setdefault(topic, []).append(callback)
        good = {topic for topic, _ in self._rover.messages(0)}
        self._streams = [each for each in self._subscriptions if each[1] in good]
        self._rng = np.random.default_rng(seed)
        self._odd = OddMessages(self._rng)
        self.messages, self.odd, self._round = 0, 0, 0
        self._good(AFTER)

    @property
    def topics(self) -> set[str]:
        """All that are listened to."""
        return set(self._by_topic)

    def close(self) -> None:
        """End the nodes."""
        for node in self._nodes:
            node.destroy_node()
        self._context.try_shutdown()

    def run(self) -> str:
        """One episode; returns what is wrong after it, or nothing."""
        sent = []
        for _ in range(int(self._rng.integers(1, ODD + 1))):
            streams = self._streams if self._rng.random() < 0.5 else self._subscriptions
            node, topic, kind, callback = streams[int(self._rng.integers(len(streams)))]
            message = self._odd.draw(topic, kind, BEGIN + self._round * PERIOD)
            sent.append(f"{node.get_name()} {topic}: {str(message)[:300]}")
            try:
                callback(message)
            except Exception as error:
                raise AssertionError(f"{sent[-1]}: {type(error).__name__}: {error}") from error
            self.messages, self.odd = self.messages + 1, self.odd + 1
            self._good(int(self._rng.integers(0, 3)))
        self._good(AFTER)
        wrong = self._wrong()
        return f"{wrong} after {sent}" if wrong else ""

    def _good(self, rounds: int) -> None:
        for _ in range(rounds):
            self._round += 1
            for topic, message in self._rover.messages(self._round):
                self._odd.keep(topic, message)
                for callback in self._by_topic.get(topic, ()):
                    callback(copy.copy(message))
                    self.messages += 1

    def _wrong(self) -> str:
        """What a node does not know that it should."""
        expected = {BEGIN + number * PERIOD for number in range(self._round - LAST, self._round)}
        for what, stamps in self._recorded.stamps.items():
            missing = len(expected.difference(stamps))
            if missing:
                return f"{missing} of {LAST} {what} are missing"
            del stamps[:]
        for node in self._nodes:
            tracker = getattr(node, "_tracker", None)
            if tracker is None:
                continue
            state = tracker.known_state()
            if state is None:
                return f"{node.get_name()} does not know its state"
            away = np.abs(state.T_map_base - self._rover.T_map_base).max()
            turned = [abs(state.joints[name] - q) for name, q in self._rover.joints.items()]
            if not (away < 1e-6 and max(turned) < 1e-9):
                return f"{node.get_name()} is {away:.3g} m, its joints {max(turned):.3g} rad off"
        return ""


def check(seconds: float, seed: int, most: int | None = None) -> dict[str, object]:
    """Run episodes for some time, or so many messages.

    Args:
        seconds: [s].
        seed: of the draws.
        most: messages.

    Raises:
        AssertionError: an episode ended wrongly, or a callback raised.
    """
    episodes, count, begin = Episodes(seed), 0, time.monotonic()
    try:
        while time.monotonic() - begin < seconds and (most is None or episodes.messages < most):
            wrong = episodes.run()
            count += 1
            assert not wrong, f"seed {seed}, episode {count}: {wrong}"
        return {
            "seed": seed,
            "episodes": count,
            "messages": episodes.messages,
            "odd": episodes.odd,
            "topics": len(episodes.topics),
            "seconds": round(time.monotonic() - begin, 1),
        }
    finally:
        episodes.close()


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    try:
        figures = check(float("inf"), arguments.seed, arguments.messages)
    except AssertionError as error:
        print(json.dumps({"seed": arguments.seed, "wrong": str(error)}))
        return 1
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
