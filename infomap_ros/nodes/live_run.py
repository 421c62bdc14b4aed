"""A bag through bag_player, stereo_range and map_fusion as three processes, watched from outside.

The demo, the benchmark of the live chain and the soak test are such runs.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger

from infomap_ros.errors import ProcessError
from infomap_ros.nodes import qos
from infomap_ros.nodes.environment import process_environment, reliable_inputs
from infomap_ros.nodes.processes import NodeProcesses, private_graph
from infomap_ros.nodes.run_state import RunState

_QUIET = 3.0  # [s]
LEFT, RIGHT = "left/image_raw", "right/image_raw"


class LiveRun:
    """Three node processes and a watcher in this process.

    Args:
        bag: the bag that is played.
        out: folder for the logs.
        player: further parameters of bag_player.
        stereo: further parameters of stereo_range.
        fusion: further parameters of map_fusion.
        map_file: where map_fusion saves; ``map.infomap`` in `out` where not given.

    Attributes:
        state: what is known of the run.
        pids: process ids by node name.
    """

    def __init__(
        self,
        bag: Path,
        out: Path,
        player: Mapping[str, object] | None = None,
        stereo: Mapping[str, object] | None = None,
        fusion: Mapping[str, object] | None = None,
        map_file: Path | None = None,
    ) -> None:
        self.state = RunState()
        self.pids: dict[str, int] = {}
        self._watched: Counter[str] = Counter()
        self.map_file = (map_file or out / "map.infomap").absolute()
        self._player = {
            "bag": bag.absolute(),
            "wait_for_subscribers": [LEFT, RIGHT, "camera_pose"],
            **(player or {}),
        }
        images = reliable_inputs((LEFT, RIGHT, "left/camera_info", "right/camera_info"))
        clouds = reliable_inputs(("points2", "camera_pose", "joint_states"))
        results = reliable_inputs(("map_updates",))
        self._player |= results
        self._stereo = {"rectify": True, **images, **(stereo or {})}
        self._fusion = {"map_file": self.map_file, **clouds, **(fusion or {})}
        environment = process_environment(private_graph())
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
        self._watch("map_updates", PointCloud2, self.state.updates)

    def watch_images(self) -> None:
        """Note when each left image arrives."""
        self._watch(LEFT, Image, self.state.images)

    def watch_clock(self) -> None:
        """Listen to the clock of the bag."""
        self.subscribe(Clock, "/clock", lambda _: None)

    def _watch(self, topic: str, kind: type, arrivals: dict[int, float]) -> None:
        def receive(message: Any) -> None:
            stamp = message.header.stamp
            arrivals[stamp.sec * 1_000_000_000 + stamp.nanosec] = time.monotonic()

        self.subscribe(kind, topic, receive)

    def subscribe(self, kind: type, topic: str, receive: Callable[[Any], None]) -> None:
        """Listen to a topic of the run."""
        self._watched[topic] += 1
        self._node.create_subscription(kind, topic, receive, qos.stream(depth=100))

    def start(self, timeout: float = 300.0) -> None:
        """Start stereo_range and map_fusion, and when they have found each other the player.

        Args:
            timeout: for the two nodes to be ready [s]; kernels may have to be compiled.

        Raises:
            ProcessError: a node does not start.
        """
        self.start_nodes()
        self.spin_until(self._connected, "stereo_range and map_fusion to connect", timeout)
        self.start_player()

    def start_nodes(self) -> None:
        """Start stereo_range and map_fusion."""
        self.pids["map_fusion"] = self._processes.start("map_fusion", self._fusion)
        self.pids["stereo_range"] = self._processes.start("stereo_range", self._stereo)

    def start_player(self) -> None:
        """Start bag_player."""
        self.pids["bag_player"] = self._processes.start("bag_player", self._player)

    def stop_player(self) -> None:
        """End bag_player before its bag ends, as when it loops.

        Raises:
            ProcessError: it does not end.
        """
        self._processes.end("bag_player")

    def _connected(self) -> bool:
        """Whether the clouds have a listener, and the updates all of this process."""
        clouds = self.state.count("stereo_range", "/points2 subscribers")
        updates = self.state.count("map_fusion", "/map_updates subscribers")
        return clouds >= 1 + self._watched["points2"] and updates >= self._watched["map_updates"]

    def spin_until(
        self,
        condition: Callable[[], bool],
        what: str,
        timeout: float,
        tick: Callable[[], None] = lambda: None,
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

    def spin_for(self, seconds: float) -> None:
        """Watch the run for some time.

        Raises:
            ProcessError: a process failed.
        """
        end = time.monotonic() + seconds
        self.spin_until(lambda: time.monotonic() >= end, "the time to pass", seconds + 60.0)

    @property
    def played(self) -> bool:
        """Whether the bag has been played to its end."""
        return self._processes.status("bag_player") == 0

    @property
    def settled(self) -> bool:
        """Whether the bag has been played and nothing has been fused for a while since."""
        quiet = time.monotonic() - self.state.last_progress
        return self.played and quiet > _QUIET

    def call(self, service: str, timeout: float = 60.0) -> str:
        """Call a Trigger service, for example ``map_fusion/save``; returns its answer.

        Raises:
            ProcessError: there is no answer or it says that it failed.
        """
        client = self._node.create_client(Trigger, service)
        self.spin_until(client.service_is_ready, f"service {service}", timeout)
        answer = client.call_async(Trigger.Request())
        self.spin_until(answer.done, f"the answer of {service}", timeout)
        response = answer.result()
        if not response.success:
            raise ProcessError(f"{service}: {response.message}")
        return str(response.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.state.add(status)
