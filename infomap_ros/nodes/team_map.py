"""The map of the whole team, as map_fusion shows it.

It exists from the first update of another robot on. It is a replica as every robot has it: the own
contribution enters as others hear it, quantised, so that all robots show the same map.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes import qos
from infomap_ros.nodes.base import MonitoredNode
from infomap_ros.nodes.scan_gate import ScanGateConfig
from infomap_ros.nodes.update_stream import UpdateStream
from infomap_ros.nodes.worker import Worker
from infomap_ros.replay.messages.rows import decode_rows
from infomap_ros.team import MapReplica, MapUpdate, decode_update, is_newer

_TOPIC = "team/map_updates"


class TeamMap:
    """Listens to the updates of other robots. Used by the worker thread, but for the listening.

    Args:
        node: that listens.
        updates: of this robot, to which the team's map listens as well.
        on_change: called when the team's map has become another.
    """

    def __init__(
        self, node: MonitoredNode, updates: UpdateStream, on_change: Callable[[], None]
    ) -> None:
        self._node = node
        self._updates, self._on_change = updates, on_change
        self._config = node.config(VoxelMapConfig)
        self._frame = node.config(ScanGateConfig).map_frame
        self._replica: MapReplica | None = None

    def listen(self, worker: Worker) -> None:
        """Apply updates in a worker from now on."""

        def receive(message: PointCloud2) -> None:
            apply = partial(self._apply, message)
            worker.submit_always(lambda: self._node.guard(_TOPIC, apply))

        profile = qos.stream(depth=200)
        self._node.listen(PointCloud2, _TOPIC, receive, profile, required=False)

    @property
    def voxel_map(self) -> VoxelMap | None:
        """The sum over all robots, None as long as there is no other robot."""
        return self._replica.voxel_map if self._replica else None

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        return self._replica.memory_bytes() if self._replica else 0

    def _apply(self, message: PointCloud2) -> None:
        _, frame, rows = decode_rows(message)
        if frame != self._frame:
            raise FrameError(f"update in frame '{frame}', the map is '{self._frame}'")
        if not len(rows):
            return
        update = decode_update(rows)
        if update.robot == self._updates.robot:
            self._check_own(update)
            return
        if self._replica is None:
            self._replica = MapReplica(self._config)
            self._updates.tell_also(partial(self._hear, self._replica))
        self._hear(self._replica, update)

    def _hear(self, replica: MapReplica, update: MapUpdate) -> None:
        if replica.apply(update):
            self._on_change()
        self._node.health.note("robots in the map", str(len(replica.robots)))

    def _check_own(self, update: MapUpdate) -> None:
        """The own updates may come back; what this robot never said is another's."""
        if is_newer(update.version, self._updates.version):
            self._node.drop("robot id in use", f"{_TOPIC}: another robot is {update.robot} too")
