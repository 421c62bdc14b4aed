"""A bag through bag_player, stereo_range and map_fusion as three processes, watched from outside.

The demo, the benchmark of the live chain and the soak test are such runs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from infomap_ros.errors import ProcessError
from infomap_ros.nodes import qos
from infomap_ros.nodes.processes import NodeProcesses, private_graph

LEFT, RIGHT = "left/image_raw", "right/image_raw"


@dataclass
class RunState:
    """What is known of a run so far.

    Attributes:
        figures: last diagnostic values of each node by node name.
        complaints: last diagnostic message of each node that was not ``ok``.
        updates: arrival of the first map update of each stamp [s, monotonic] by stamp [ns].
    """

    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    complaints: dict[str, str] = field(default_factory=dict)
    updates: dict[int, float] = field(default_factory=dict)

    def count(self, node: str, figure: str = "results") -> int:
        """A whole-number figure of a node, 0 while unknown."""
        return int(self.figures.get(node, {}).get(figure, "0"))

    def drops(self) -> dict[str, int]:
        """Drops of all nodes, ``node: reason`` -> count."""
        return {
            f"{node}: {name.removeprefix('dropped: ')}": int(value)
            for node, values in self.figures.items()
            for name, value in values.items()
            if name.startswith("dropped: ")
        }


class LiveRun:
    """Three node processes and a watcher in this process.

    Args:
        bag: the bag that is played.
        out: folder for the logs and the map file.
        player: further parameters of bag_player.
        stereo: further parameters of stereo_range.
        fusion: further parameters of map_fusion.
    """

    def __init__(
        self,
        bag: Path,
        out: Path,
        player: Mapping[str, object] | None = None,
        stereo: Mapping[str, object] | None = None,
        fusion: Mapping[str, object] | None = None,
    ) -> None:
        self.state = RunState()
        self.map_file = (out / "map.npz").absolute()
        self._player = {
            "bag": bag.absolute(),
            "wait_for_subscribers": [LEFT, RIGHT, "camera_pose"],
            **(player or {}),
        }
        self._stereo = {"rectify": True, **(stereo or {})}
        self._fusion = {"map_file": self.map_file, **(fusion or {})}
        environment = private_graph()
        self._processes = NodeProcesses(out / "log", environment=environment)
        self._context = rclpy.Context()
        self._environment = environment

    def __enter__(self) -> LiveRun:
        os.environ.update(self._environment)  # the watcher must live in the same graph
        rclpy.init(context=self._context, domain_id=int(self._environment["ROS_DOMAIN_ID"]))
        self._node = rclpy.create_node("infomap_watcher", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.stream(depth=50)
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._processes.stop()
        self._node.destroy_node()
        self._context.try_shutdown()

    def watch_updates(self) -> None:
        """Note when the map updates of each stamp arrive."""

        def receive(message: PointCloud2) -> None:
            stamp = message.header.stamp
            self.state.updates.setdefault(
                stamp.sec * 1_000_000_000 + stamp.nanosec, time.monotonic()
            )

        self._node.create_subscription(PointCloud2, "map_updates", receive, qos.stream(depth=100))

    def start(self) -> None:
        """Start the three nodes."""
        self._processes.start("map_fusion", self._fusion)
        self._processes.start("stereo_range", self._stereo)
        self._processes.start("bag_player", self._player)

    def spin_until(
        self, condition: Callable[[], bool], what: str, timeout: float, tick: Callable[[], None]
    ) -> None:
        """Watch the run until a condition holds.

        Args:
            condition: when to stop.
            what: is waited for, in words.
            timeout: [s].
            tick: called again and again, for example to show progress.

        Raises:
            ProcessError: a process failed, or the time is over.
        """
        end = time.monotonic() + timeout
        while not condition():
            self._processes.check(may_end=("bag_player",))
            if time.monotonic() > end:
                complaints = "; ".join(f"{n}: {text}" for n, text in self.state.complaints.items())
                raise ProcessError(f"waited {timeout:.0f} s in vain for {what}. {complaints}")
            self._executor.spin_once(timeout_sec=0.1)
            tick()

    @property
    def played(self) -> bool:
        """Whether the bag has been played to its end."""
        return self._processes.status("bag_player") == 0

    @property
    def settled(self) -> bool:
        """Whether every cloud that stereo_range made has come to its end in map_fusion."""
        made, fused = self.state.count("stereo_range"), self.state.count("map_fusion")
        lost = sum(n for name, n in self.state.drops().items() if name.startswith("map_fusion"))
        return self.played and made > 0 and fused + lost >= made

    def call(self, service: str, timeout: float = 60.0) -> str:
        """Call a Trigger service, for example ``map_fusion/save``; returns its answer.

        Raises:
            ProcessError: there is no answer or it says that it failed.
        """
        client = self._node.create_client(Trigger, service)
        self.spin_until(client.service_is_ready, f"service {service}", timeout, lambda: None)
        answer = client.call_async(Trigger.Request())
        self.spin_until(answer.done, f"the answer of {service}", timeout, lambda: None)
        response = answer.result()
        if not response.success:
            raise ProcessError(f"{service}: {response.message}")
        return str(response.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = status.hardware_id.rpartition("/")[2]
            self.state.figures[node] = {pair.key: pair.value for pair in status.values}
            if status.message != "ok":
                self.state.complaints[node] = status.message
