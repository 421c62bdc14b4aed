"""The topic map_updates: this robot's contribution, sent to others.

Each publication holds the voxels that changed since the last one. Who comes late needs the rest:
when a subscriber appears, everything known is sent again, a slice with each publication, so that
neither the network nor the subscriber's queue overflows. Values are absolute, so telling them again
harms nobody.

The robot's own nodes listen to map_updates. What it sends goes to
team/map_updates as well, unless both are one topic.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.mapping import VoxelChanges, VoxelMap
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.messages.rows import encode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.fusion.map_outputs import without_evidence
from infomap_ros.nodes.team.team_topics import UPDATES, TeamIdentityConfig
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizerConfig
from infomap_ros.team.config import Budget, TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import draw_session
from infomap_ros.team.update import MapUpdate, next_version, version_at
from infomap_ros.team.wire import MAX_MESSAGE_BYTES, OCCUPANCY_ROW, encode_update

_VOXEL_BYTES = 4  # of a message, about
_SLICE_BYTES = BLOCK_VOXELS * _VOXEL_BYTES


class UpdateStream:
    """Publishes map_updates. Used by one thread, but for the notice of subscribers.

    Args:
        node: that publishes.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._config = node.config(TeamIdentityConfig)
        self._sharing = node.config(TeamConfig)
        self._frame = node.config(ScanSynchronizerConfig).map_frame
        self._types = RclpyMessageTypes()
        self._version = version_at(time.time_ns())
        self._budget = Budget(self._sharing.bandwidth * 1e6)
        self._newcomer = False
        self._origin = self._next_block = self._blocks_left = 0
        self._taken_back = np.empty((0, 3), np.int32)
        self.key = self._config.read_key()
        self._member: TeamMember | None = None
        self._on_send: Callable[[], None] = lambda: None
        self._resumed = self._replaced = self._joined = False
        self.session = draw_session()
        how = qos.stream(depth=50), self._on_newcomer
        self._publisher = node.advertise(PointCloud2, "map_updates", *how)
        self._to_team = None
        if node.resolve_topic_name(UPDATES) != self._publisher.topic_name:
            self._to_team = node.advertise(PointCloud2, UPDATES, *how)

    @property
    def robot(self) -> int:
        """Id of this robot."""
        return self._config.robot_id

    @property
    def version(self) -> int:
        """Version of the last publication."""
        return self._version

    @property
    def team(self) -> tuple[int, ...]:
        """Ids of the robots whose updates count, none for all."""
        return self._config.team

    def resumed(self) -> None:
        """The map was read from a file as this robot left it."""
        self._resumed, self._replaced = True, False

    def join(self, member: TeamMember, on_send: Callable[[], None]) -> None:
        """From now on send what a team needs; from the start on, as nobody may have received it.

        Args:
            member: chooses what is sent, and knows the map of the team.
            on_send: called when something was sent, which changes that map.
        """
        self._member, self._on_send = member, on_send
        self._joined = True

    @property
    def behind(self) -> bool:
        """Whether somebody still waits for what was known before."""
        if self._member is not None:
            return True
        waiting = self._newcomer or self._blocks_left > 0 or len(self._taken_back) > 0
        return waiting and self._has_listeners

    def publish(self, voxel_map: VoxelMap, stamp: int, *, always: bool = True) -> None:
        """Send what changed and a slice of what others still wait for.

        While nobody listens nothing is sent: who comes later gets all of it.

        Args:
            voxel_map: own contribution, which tracks its changes.
            stamp: of the messages [ns].
            always: send an empty message if there is nothing to send.
        """
        if self._member is not None:
            self._publish_to_team(self._member, voxel_map, stamp, always)
            return
        if not self._has_listeners:
            self._taken_back = self._taken_back[:0]
            self._newcomer = True
            voxel_map.track_changes(True)  # forgets the changes
            return
        if voxel_map.origin != self._origin:  # listeners drop what was sent in another frame
            self._origin, self._newcomer = voxel_map.origin, True
            self._taken_back = self._taken_back[:0]
        budget = int(min(self._budget.available(time.monotonic()), MAX_MESSAGE_BYTES))
        self._take_back(voxel_map, budget // _VOXEL_BYTES, stamp)
        self._repeat(voxel_map, max(1, budget // _SLICE_BYTES))
        changes = voxel_map.take_changes()
        if always or len(changes.indices):
            self._send(changes, voxel_map.config.voxel_size, stamp)

    def replace(self, old: VoxelMap) -> None:
        """From now on another map is sent: take back what the `old` one had and that has not."""
        self._replaced = self._newcomer = True
        if self._member is None:
            self._taken_back = np.concatenate([self._taken_back, old.voxels()[0]])

    @property
    def _has_listeners(self) -> bool:
        if self._publisher.get_subscription_count() > 0:
            return True
        team = self._to_team
        return team is not None and team.get_subscription_count() > 1  # this node is one of them

    def _on_newcomer(self) -> None:
        self._newcomer = True

    def _publish_to_team(
        self, member: TeamMember, voxel_map: VoxelMap, stamp: int, always: bool
    ) -> None:
        """Send what the team needs most, as far as the bandwidth allows."""
        if self._replaced:
            member.replace(voxel_map)
        elif self._joined and not self._resumed:
            member.begin(voxel_map)
        self._replaced = self._joined = False
        if self._newcomer:
            self._newcomer = False
            member.send_everything()
        messages = member.updates(voxel_map, time.monotonic())
        self._version = member.version
        if messages:
            self._on_send()
        if always and not messages:
            messages = [np.zeros(0, OCCUPANCY_ROW)]
        for rows in messages:
            self._publish(rows, stamp)

    def _repeat(self, voxel_map: VoxelMap, blocks: int) -> None:
        """Count the next blocks as changed, from the first on when somebody is new."""
        if self._newcomer:
            self._newcomer = False
            self._next_block, self._blocks_left = 0, 1
        if self._blocks_left:
            self._blocks_left = voxel_map.mark_changed(self._next_block, blocks)
            self._next_block += blocks

    def _take_back(self, voxel_map: VoxelMap, voxels: int, stamp: int) -> None:
        """Say of the next voxels that they are not observed, unless they are again."""
        if not len(self._taken_back):
            return
        size = voxel_map.config.voxel_size
        indices, self._taken_back = np.split(self._taken_back, [max(1, voxels)])
        gone = ~voxel_map.is_known((indices + 0.5) * size)
        if gone.any():
            self._send(without_evidence(indices[gone]), size, stamp)

    def _send(self, changes: VoxelChanges, voxel_size: float, stamp: int) -> None:
        self._version = next_version(self._version)
        who = self.robot, self._version, self.session, self._origin
        update = MapUpdate.of_changes(changes, voxel_size, *who)
        parts = encode_update(update, self._sharing.message_size)
        self._budget.spend(sum(rows.nbytes for rows in parts))
        if self.key is not None:
            parts = [self.key.sign(rows) for rows in parts]
        for rows in parts or [np.zeros(0, OCCUPANCY_ROW)]:
            self._publish(rows, stamp)

    def _publish(self, rows: NDArray[np.void], stamp: int) -> None:
        """Send the own nodes, and the team what is not empty."""
        message = encode_rows(self._types, stamp, self._frame, rows)
        self._publisher.publish(message)
        if self._to_team is not None and len(rows):
            self._to_team.publish(message)
