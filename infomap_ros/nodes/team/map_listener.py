"""The shared map as a node receives it from map_updates and team/map_updates."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import ExplorationError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.team_exchange import TeamExchange
from infomap_ros.nodes.team.team_topics import UPDATES, TeamIdentityConfig, TeamInbox
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import draw_session
from infomap_ros.team.update import version_at
from infomap_ros.team.wire import decode_update

Rows = NDArray[np.void]
# After the start, plans are refused until the map has not grown for so long: what was known before
# a restart arrives bit by bit [s].
_ARRIVAL_PAUSE = 1.0
_GROWTH = 1.01  # by this factor the map must grow to count as growing


@dataclass(frozen=True)
class MapListenerConfig:
    """How the map is received.

    Raises:
        ConfigError: a value is out of its range.
    """

    memory_limit: float = parameter(
        8.0,
        "An update that would make the map larger is dropped.",
        unit="GB",
        low=0.001,
        high=1024.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class MapListener:
    """A replica of the map. Used by the worker thread, but for the listening.

    Args:
        node: that listens.
        worker: applies the updates, in the order in which they come.
        required: whether the node cannot work without the map: an update is then a result of it,
            and that none comes is worth a warning.
        on_update: called by the worker after each update, and when a map is taken in or left out.
    """

    def __init__(
        self,
        node: MonitoredNode,
        worker: Worker,
        *,
        required: bool = True,
        on_update: Callable[[], None] = lambda: None,
    ) -> None:
        self._required, self._on_update = required, on_update
        self._node, self._config = node, node.config(MapListenerConfig)
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._team = node.config(TeamIdentityConfig)
        self._key = self._team.read_key()
        self._member: TeamMember | None = None
        self._known, self._grown, self._arrived = 0, 0.0, False
        inbox = TeamInbox(node, self._frame, worker, self._key)
        for topic in ("map_updates", UPDATES):
            inbox.listen(topic, self._apply, required=required and topic == "map_updates")
        TeamExchange(node, self._frame, worker, self._key, lambda: self._member, on_update)

    def voxel_map(self) -> VoxelMap:
        """The sum over all robots.

        Raises:
            ExplorationError: there is no map yet, or it is still arriving.
        """
        voxel_map = self.known_map()
        if voxel_map is None:
            raise ExplorationError("no map_updates have arrived yet")
        self._arrived |= time.monotonic() - self._grown >= _ARRIVAL_PAUSE
        if not self._arrived:
            raise ExplorationError(f"the map is still arriving: {self._known} voxels so far")
        return voxel_map

    def known_map(self) -> VoxelMap | None:
        """The sum over all robots as far as it has arrived; None where nothing has."""
        if self._member is None or not self._member.replica.voxel_map.known_voxels:
            return None
        voxel_map = self._member.replica.voxel_map
        voxel_map.origin = self._member.replica.origin
        return voxel_map

    def _apply(self, rows: Rows) -> None:
        """Learn what a robot has seen; the first update gives the size of the voxels.

        Raises:
            InfomapError: the update cannot be used; the map is as before.
        """
        if self._member is None:
            genuine = rows if self._key is None else self._key.verify(rows)
            self._member = self._make_member(decode_update(genuine).voxel_size)
        self._member.receive_update(rows, time.monotonic())
        self._on_update()
        if self._required:
            self._node.health.produced()
        if not self._arrived:
            self._note_growth(self._member.replica.voxel_map.known_voxels)

    def _make_member(self, voxel_size: float) -> TeamMember:
        """A member of the team that only listens, and asks for what it missed."""
        config, team = self._config, self._team
        map_config = VoxelMapConfig(
            voxel_size=round(voxel_size, 7), memory_limit=config.memory_limit
        )
        sharing = self._node.config(TeamConfig)
        who = team.robot_id, draw_session(), version_at(time.time_ns())
        return TeamMember(*who, map_config, sharing, team.team, contributes=False, key=self._key)

    def _note_growth(self, known: int) -> None:
        if known > _GROWTH * self._known:
            self._known, self._grown = known, time.monotonic()
