"""Stops the robot when robot_driver is killed or hangs: a process that listens to a pipe.

Goals of actions run on when their client is gone, and a base without a time-out of its own keeps
its last velocity. What comes from the driver is the pipe alone: when it ends without a farewell,
or nothing comes for a second while something moves, all goals of the action servers are canceled,
zero is published as velocity, and arms that are driven by topics are told to slow down and stand.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import rclpy
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import MalformedMessageError
from infomap_ros.messages.motions import encode_arm_stop
from infomap_ros.messages.poses import decode_joint_state
from infomap_ros.nodes.common.message_types import RclpyMessageTypes

BEAT = 0.1  # [s] between two signs of life
_RESTS, _MOVES, _FAREWELL = b"r", b"m", b"f"
_PATIENCE = 1.0  # [s] without a sign of life in a motion: the driver hangs
_STOPPING = 1.0  # [s] during which zero is published, and answers are waited for
_PERIOD = 0.05  # [s] between two velocities


@dataclass(frozen=True)
class Reach:
    """What moves a robot.

    Attributes:
        actions: names of action servers, with their namespaces.
        arms: joints of each controller that is driven by a topic of trajectories, by topic.
        joint_states: topic that has these joints.
        velocities: topics of velocities, with their namespaces.
        is_stamped: whether velocities have a stamp.
        namespace: of the driver.
    """

    actions: tuple[str, ...] = ()
    arms: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    joint_states: str = "/joint_states"
    velocities: tuple[str, ...] = ()
    is_stamped: bool = False
    namespace: str = "/"


class Watchdog:
    """The process, from the driver's side.

    Args:
        reach: what is to be stopped.
    """

    def __init__(self, reach: Reach) -> None:
        command = [sys.executable, "-m", "infomap_ros.nodes.driving.watchdog"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
        self._say(json.dumps(asdict(reach)).encode() + b"\n")

    def beat(self, moves: bool) -> None:
        """Give a sign of life, at least each `BEAT`.

        Args:
            moves: whether something moves: only then it matters that the next one comes.
        """
        self._say(_MOVES if moves else _RESTS)

    def part(self) -> None:
        """Let it go: the driver ends by itself, and has stopped the robot."""
        self._say(_FAREWELL)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def _say(self, words: bytes) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # it has gone: there is nobody who watches
                self._process.stdin.write(words)
                self._process.stdin.flush()


class _Brake(Node):
    """Is known to the action servers before it is needed."""

    def __init__(self, reach: Reach) -> None:
        super().__init__("robot_driver_watchdog", namespace=reach.namespace)
        self._kind = TwistStamped if reach.is_stamped else Twist
        self._cancels = [
            self.create_client(CancelGoal, f"{name}/_action/cancel_goal") for name in reach.actions
        ]
        self._velocities = [
            self.create_publisher(self._kind, topic, 1) for topic in reach.velocities
        ]
        self._reach, self._types = reach, RclpyMessageTypes()
        self._arms = {
            topic: self.create_publisher(JointTrajectory, topic, 1) for topic in reach.arms
        }
        self._moving = set[str]()
        if reach.arms:  # from the start: to find who publishes takes longer than to stop
            latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            topic = reach.joint_states
            self._joints = self.create_subscription(JointState, topic, self._halt, latest)

    def stop(self, why: str) -> None:
        """Cancel all goals, have arms stand, and publish zero for a while."""
        self.get_logger().error(f"robot_driver {why}: stopping the robot")
        asked = set()
        self._moving = set(self._arms)
        if self._arms:  # what waits may be old
            with self._joints.handle:
                self._joints.handle.take_message(JointState, False)
        end = time.monotonic() + _STOPPING
        while time.monotonic() < end:
            for number, client in enumerate(self._cancels):
                if number not in asked and client.service_is_ready():
                    asked.add(number)
                    client.call_async(CancelGoal.Request())
            for publisher in self._velocities:
                publisher.publish(self._zero())
            rclpy.spin_once(self, timeout_sec=_PERIOD)

    def _halt(self, message: JointState) -> None:
        with contextlib.suppress(MalformedMessageError):  # the next one will be read
            record = decode_joint_state(message)
            positions = dict(zip(record.names, record.positions, strict=True))
            velocities = record.velocities
            speeds = {} if velocities is None else dict(zip(record.names, velocities, strict=True))
            for topic, joints in self._reach.arms.items():
                if topic in self._moving and positions.keys() >= set(joints):
                    self._moving.remove(topic)
                    stop = encode_arm_stop(self._types, joints, positions, speeds)
                    self._arms[topic].publish(stop)

    def _zero(self) -> Twist | TwistStamped:
        zero = self._kind()
        if isinstance(zero, TwistStamped):
            zero.header.stamp = self.get_clock().now().to_msg()
        return zero


def _watch(brake: _Brake) -> None:
    """Stop the robot when the standard input is silent in a motion, or ends; until it ends."""
    pipe, last = sys.stdin.fileno(), _RESTS
    while True:
        ready, _, _ = select.select([pipe], [], [], _PATIENCE if last == _MOVES else None)
        if not ready:
            brake.stop(f"has given no sign of life for {_PATIENCE:g} s")
            last = _RESTS  # once, until it moves something again
            continue
        received = os.read(pipe, 4096)
        if _FAREWELL in received:
            return
        if not received:
            brake.stop("is gone")
            return
        last = received[-1:]


def main() -> int:
    """Watch until the standard input ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends when the driver does
    words = b""
    while not words.endswith(b"\n"):  # byte by byte: nothing may stay in a buffer
        byte = os.read(sys.stdin.fileno(), 1)
        if not byte:
            return 0
        words += byte
    reach = Reach(**json.loads(words))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    _watch(_Brake(reach))
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
