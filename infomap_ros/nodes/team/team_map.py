"""The map of the whole team, as map_fusion shows it.

It exists from the first word of another robot on. It is a replica as every robot has it: the own
contribution enters as others receive it, quantized, so that all robots show the same map.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.fusion.update_stream import UpdateStream
from infomap_ros.nodes.team.team_exchange import TeamExchange
from infomap_ros.nodes.team.team_topics import UPDATES, TeamInbox
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizerConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import decode_digest
from infomap_ros.team.member import TeamMember
from infomap_ros.team.wire import decode_update

Rows = NDArray[np.void]


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
        self._frame = node.config(ScanSynchronizerConfig).map_frame
        self._member: TeamMember | None = None

    def listen(self, worker: Worker) -> None:
        """Apply updates in a worker from now on."""
        key = self._updates.key
        TeamInbox(self._node, self._frame, worker, key).listen(UPDATES, self._apply)
        TeamExchange(
            self._node, self._frame, worker, key, lambda: self._member, self._changed, self._meet
        )

    @property
    def voxel_map(self) -> VoxelMap | None:
        """The sum over all robots, None as long as there is no other robot."""
        return self._member.replica.voxel_map if self._member else None

    def account(self) -> str:
        """What this robot knows of the team, as JSON: hash, robots, voxels.

        Robots of which the ``hash`` is the same hold the same map, bit by bit.

        Raises:
            InvalidInputError: there is no other robot.
        """
        if self._member is None:
            raise InvalidInputError("team", "no other robot has reported")
        replica = self._member.replica
        known = {
            "hash": f"{replica.hash():016x}",
            "robots": list(replica.robots),
            "left_out": list(replica.aside),
            "known_voxels": replica.voxel_map.known_voxels,
        }
        return json.dumps(known)

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        return self._member.replica.memory_bytes() if self._member else 0

    def _apply(self, rows: Rows) -> None:
        if self._member is None:
            update = decode_update(self._genuine(rows))
            self._join(update.robot, update.session)
        if self._member is not None and self._member.receive_update(rows, time.monotonic()):
            self._changed()

    def _meet(self, rows: Rows) -> None:
        """A digest may be the first message of another robot."""
        if self._member is None:
            digest = decode_digest(self._genuine(rows))
            self._join(digest.sender, digest.session)

    def _join(self, robot: int, session: int) -> None:
        """There is another robot, unless these are own words: from now on this is a team."""
        updates = self._updates
        if (robot, session) == (updates.robot, updates.session):
            return
        sharing = self._node.config(TeamConfig)
        own = updates.robot, updates.session, updates.version
        self._member = TeamMember(*own, self._config, sharing, updates.team, key=updates.key)
        updates.join(self._member, self._changed)

    def _genuine(self, rows: Rows) -> Rows:
        key = self._updates.key
        return rows if key is None else key.verify(rows)

    def _changed(self) -> None:
        self._on_change()
        if self._member is not None:
            robots = len(self._member.replica.robots)
            self._node.health.note("robots in the map", str(robots))


def team_map_file(map_file: Path) -> Path:
    """The file of the map of the whole team, beside that of what one robot saw."""
    return map_file.with_name(f"{map_file.stem}_team{map_file.suffix}")
