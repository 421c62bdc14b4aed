"""Other robots in the world of the simulated one, each simulated by a node of its own.

They are heard on their ground_truth topics: where each truly is, its joints, and what time it is
there. All simulations of one world keep together in time.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import JointState

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import decode_joint_state, decode_pose_with_covariance
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.simulation.multi_robot.shared_time import SharedTime
from infomap_ros.simulation.simulator import Simulator

_JOINING = 2.0  # [s] in which others are heard before time begins
_PAUSE = 0.002  # [s] between two looks at whether the others have come
_REPEAT = 0.2  # [s] after which the own state is told again while waiting


@dataclass(frozen=True)
class TeammatesConfig:
    """Other robots in the same world.

    Raises:
        ConfigError: a value is out of its range.
    """

    teammates: tuple[str, ...] = parameter(
        (),
        "Namespaces of the other robots in this world, each with a simulator of its own; the same "
        "world, seed and start_time must be given to all.",
    )
    time_window: float = setting(
        0.1,
        "By how much simulated time may be ahead of that of another robot; at least two periods "
        "of state_rate.",
        unit="s",
        low=0.02,
        high=10.0,
    )
    teammate_silence: float = setting(
        8.0,
        "A simulator that was not heard for so long is not waited for: its robot stays where it "
        "stood. When it is back, it goes on at the time of the others.",
        unit="s",
        low=1.0,
        high=600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
        names = [name.strip("/") for name in self.teammates]
        if len(set(names)) < len(names) or not all(names):
            raise ConfigError("teammates", self.teammates, "different namespaces")


class SimulatorTeammates:
    """Puts teammates where they are, and keeps time with them.

    Callbacks queue; the thread that simulates does the rest.

    Args:
        node: that listens.
        simulator: in whose world they are; was made with their `names`.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator) -> None:
        config = node.config(TeammatesConfig)
        self._node, self._simulator = node, simulator
        self._time = SharedTime(config.time_window, config.teammate_silence)
        self._news: queue.SimpleQueue[tuple[str, Callable[[], None]]] = queue.SimpleQueue()
        self._poses: dict[str, FloatArray] = {}
        self._joints: dict[str, dict[str, float]] = {}
        self._names = teammate_names(config)
        self._told = 0.0
        for name in self._names:
            for kind, topic, receive in (
                (PoseWithCovarianceStamped, "base_pose", self._on_pose),
                (JointState, "joint_states", self._on_joints),
            ):
                topic = f"/{name}/ground_truth/{topic}"
                handle = partial(self._queue, topic, partial(receive, name))
                node.listen(kind, topic, handle, qos.stream(), required=False)

    def join(self, publish: Callable[[], None]) -> None:
        """Begin at the time of the others, as far as they are there.

        Args:
            publish: tells the own state.
        """
        end = time.monotonic() + _JOINING
        while self._names and time.monotonic() < end:
            publish()
            time.sleep(0.05)
            self.update()
            if self._time.running(time.monotonic()).keys() >= set(self._names):
                break

    def update(self) -> None:
        """Put teammates where they were last heard to be; skip time that was missed."""
        while not self._news.empty():
            topic, take = self._news.get()
            self._node.guard(topic, take)
        for name in self._poses.keys() & self._joints.keys():
            place = partial(
                self._simulator.place_teammate, name, self._poses[name], self._joints[name]
            )
            self._node.guard(f"/{name}", place)
        missed = self._time.missed(self._simulator.time, time.monotonic())
        if missed > 0.0:
            self._node.get_logger().info(f"time goes on {missed:.1f} s later, with the others")
            self._simulator.skip(missed)

    def wait(self, publish: Callable[[], None]) -> bool:
        """Wait a moment where others are behind; whether that was so.

        Args:
            publish: tells the own state again, in case that another one has missed it.
        """
        now = time.monotonic()
        if self._time.may_step(self._simulator.time, now):
            return False
        if now - self._told > _REPEAT:
            self._told = now
            publish()
        time.sleep(_PAUSE)
        return True

    def _queue(self, topic: str, receive: Callable[[Any], None], message: Any) -> None:
        self._news.put((topic, partial(receive, message)))

    def _on_pose(self, name: str, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        self._poses[name] = pose.transform
        elapsed = pose.stamp * 1e-9 - self._simulator.config.start_time
        self._time.hear(name, elapsed, time.monotonic())

    def _on_joints(self, name: str, message: JointState) -> None:
        record = decode_joint_state(message)
        self._joints[name] = dict(zip(record.names, map(float, record.positions), strict=True))


def teammate_names(config: TeammatesConfig) -> tuple[str, ...]:
    """Names of the teammates: their namespaces without slashes at the ends."""
    return tuple(name.strip("/") for name in config.teammates)
