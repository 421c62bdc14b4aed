"""Stops the robot when robot_driver is killed: a process that waits for the end of a pipe.

Goals of actions run on when their client is gone, and a base without a time-out of its own keeps
its last velocity. What is heard of the driver is the pipe alone: when it ends without a farewell,
all goals of the action servers are canceled, and zero is published as velocity.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass

import rclpy
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

_FAREWELL = "farewell"
_STOPPING = 1.0  # [s] during which zero is published, and answers are waited for
_PERIOD = 0.05  # [s] between two velocities


@dataclass(frozen=True)
class Reach:
    """What moves a robot.

    Attributes:
        actions: names of action servers, with their namespaces.
        velocities: topics of velocities, with their namespaces.
        is_stamped: whether velocities have a stamp.
        namespace: of the driver.
    """

    actions: tuple[str, ...] = ()
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
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, text=True, start_new_session=True
        )
        self._say(json.dumps(asdict(reach)) + "\n")

    def part(self) -> None:
        """Let it go: the driver ends by itself, and has stopped the robot."""
        self._say(_FAREWELL)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def _say(self, text: str) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # it has gone: there is nobody who watches
                self._process.stdin.write(text)
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

    def stop(self) -> None:
        """Cancel all goals, and publish zero for a while."""
        self.get_logger().error("robot_driver is gone: stopping the robot")
        asked = set()
        end = time.monotonic() + _STOPPING
        while time.monotonic() < end:
            for number, client in enumerate(self._cancels):
                if number not in asked and client.service_is_ready():
                    asked.add(number)
                    client.call_async(CancelGoal.Request())
            for publisher in self._velocities:
                publisher.publish(self._zero())
            rclpy.spin_once(self, timeout_sec=_PERIOD)

    def _zero(self) -> Twist | TwistStamped:
        zero = self._kind()
        if isinstance(zero, TwistStamped):
            zero.header.stamp = self.get_clock().now().to_msg()
        return zero


def main() -> int:
    """Wait for the end of the standard input."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends when the driver does
    reach = Reach(**json.loads(sys.stdin.readline() or "{}"))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    brake = _Brake(reach)
    if _FAREWELL not in sys.stdin.read():
        brake.stop()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
