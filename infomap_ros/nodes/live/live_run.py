"""A bag through bag_player, stereo_range and map_fusion, each a process, watched from outside.

With fiducial_localization as a fourth one, where the bag's own poses are not to be used.

The demo, the benchmark of the live chain and the soak test are such runs.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2

from infomap_ros.nodes.common.environment import reliable_inputs
from infomap_ros.nodes.live.live_graph import LiveGraph

_QUIET = 3.0  # [s]
LEFT, RIGHT = "left/image_raw", "right/image_raw"


class LiveRun(LiveGraph):
    """Node processes that map a bag, and a watcher in this process.

    Args:
        bag: the bag that is played.
        out: folder for the logs.
        player: further parameters of bag_player.
        stereo: further parameters of stereo_range.
        fusion: further parameters of map_fusion.
        map_file: where map_fusion saves; ``map.infomap`` in `out` where not given.
        localization: further parameters of fiducial_localization, which then makes camera_pose
            anew; where not given, the bag's own poses are played.
    """

    may_end = ("bag_player",)

    def __init__(
        self,
        bag: Path,
        out: Path,
        player: Mapping[str, object] | None = None,
        stereo: Mapping[str, object] | None = None,
        fusion: Mapping[str, object] | None = None,
        map_file: Path | None = None,
        localization: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(out)
        self.map_file = (map_file or out / "map.infomap").absolute()
        pair = [LEFT, RIGHT, "left/camera_info", "right/camera_info"]
        listeners = 1 if localization is None else 2  # of the images
        self._player: dict[str, Any] = {
            "bag": bag.absolute(),
            "wait_for_subscribers": [*pair * listeners, "camera_pose"],
            **(player or {}),
        }
        images = reliable_inputs(pair)
        clouds = reliable_inputs(("points2", "camera_pose", "joint_states"))
        results = reliable_inputs(("map_updates",))
        self._player |= results
        self._stereo = {"rectify": True, **images, **(stereo or {})}
        self._fusion = {"map_file": self.map_file, **clouds, **(fusion or {})}
        self._localization: dict[str, object] | None = None
        if localization is not None:
            self._player |= {"left_out": ["/camera_pose"], "wait_for_publishers": ["camera_pose"]}
            motion = reliable_inputs(("odom", "joint_states"))
            self._localization = {"rectify": True, **images, **motion, **localization}

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
        if self._localization is not None:
            name = "fiducial_localization"
            self.pids[name] = self._processes.start(name, self._localization)

    def start_player(self) -> None:
        """Start bag_player; it waits for the nodes, and for this process if it watches images."""
        waits = [*self._player["wait_for_subscribers"], *[LEFT] * self._watched[LEFT]]
        player = self._player | {"wait_for_subscribers": waits}
        self.pids["bag_player"] = self._processes.start("bag_player", player)

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

    @property
    def played(self) -> bool:
        """Whether the bag has been played to its end."""
        return self._processes.status("bag_player") == 0

    @property
    def settled(self) -> bool:
        """Whether the bag has been played and nothing has been fused for a while since."""
        quiet = time.monotonic() - self.state.last_progress
        return self.played and quiet > _QUIET
