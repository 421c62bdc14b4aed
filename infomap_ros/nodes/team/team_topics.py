"""The topics on which the robots of a team meet, and how they become common to all.

The topic team/agents as it is received.

Who a node's robot is in its team, and whose messages count.

Messages of the team's map as a node takes them in: read, checked for whose they are, and queued.

They wait for the worker in a queue that is bounded for all and shared fairly between the robots. A
message counts for the robot that its header name; where the team has a key, what is not signed is
dropped before it can take the place of what is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import FrameError, InvalidInputError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages.agents import decode_agent_texts
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.team.membership import TeamKey
from infomap_ros.team.message_header import header_of
from infomap_ros.team.wire import MAX_MESSAGE_BYTES

UPDATES = "team/map_updates"
DIGESTS = "team/digests"
REQUESTS = "team/requests"
AGENTS = "team/agents"

SHARED = {topic: f"/{topic}" for topic in (UPDATES, DIGESTS, REQUESTS, AGENTS)}
"""Remaps that take the topics of a robot out of its namespace."""

OWN_FRAMES = {"/tf": "tf", "/tf_static": "tf_static"}
"""Remaps that give each robot a tree of frames in its namespace, as those of Nav2 do: robots whose
frames have the same names do not meet on one topic. Without namespace they change nothing."""


def listen_to_agents(node: MonitoredNode, frame: str, take: Callable[[str], object]) -> None:
    """Subscribe to what robots report of themselves.

    Args:
        node: that listens; what is refused is counted there.
        frame: of the map.
        take: called with each text; its errors are counted drops.
    """

    def receive(message: MarkerArray) -> None:
        for frame_id, text in decode_agent_texts(message):
            if frame_id != frame:
                raise FrameError(f"robot reported in frame '{frame_id}', the map is '{frame}'")
            take(text)

    profile = qos.stream(depth=50)
    node.listen(MarkerArray, AGENTS, receive, profile, required=False, from_peer=True)


@dataclass(frozen=True)
class TeamIdentityConfig:
    """The same for all nodes of a robot.

    Raises:
        ConfigError: a value is out of its range.
    """

    robot_id: int = parameter(0, "Id of this robot, unique in its team.", low=0, high=65535)
    team: tuple[int, ...] = parameter(
        (), "Ids of the robots whose messages count; those of all robots where empty."
    )
    team_key: str = parameter(
        "",
        "File with the secret of the team: what is not signed with it is dropped. Empty: all is "
        "taken for genuine.",
    )

    def __post_init__(self) -> None:
        check_config(self)

    def read_key(self) -> TeamKey | None:
        """The team's key, None without one.

        Raises:
            InvalidInputError: the file cannot be read, or holds too short a key.
        """
        return TeamKey.of_team(self.team_key)


Rows = NDArray[np.void]


class TeamInbox:
    """Listens to topics of the team for a worker.

    Args:
        node: that listens.
        frame: of the map.
        worker: where messages are received.
        key: of the team; without one every message is taken for genuine.
    """

    def __init__(
        self, node: MonitoredNode, frame: str, worker: Worker, key: TeamKey | None
    ) -> None:
        self._node, self._frame, self._worker, self._key = node, frame, worker, key

    def listen(self, topic: str, take: Callable[[Rows], object], *, required: bool = False) -> None:
        """Subscribe.

        Args:
            topic: relative name.
            take: called by the worker with the rows of each message that has some.
            required: whether its absence is worth a warning.
        """
        receive, profile = partial(self._receive, topic, take), qos.stream(depth=200)
        self._node.listen(PointCloud2, topic, receive, profile, required=required, from_peer=True)

    def _receive(self, topic: str, take: Callable[[Rows], object], message: PointCloud2) -> None:
        size = len(message.data)
        if size > 2 * MAX_MESSAGE_BYTES:
            raise InvalidInputError(
                "message", f"{size} bytes, at most {MAX_MESSAGE_BYTES} are taken"
            )
        _, frame, rows = decode_rows(message)
        if frame != self._frame:
            raise FrameError(f"message in frame '{frame}', the map is '{self._frame}'")
        if not len(rows):
            return
        if self._key is not None:
            self._key.verify(rows)
        header = header_of(rows, "message")
        speaker = header.get("sender", header.get("robot", "nobody"))
        guarded = partial(self._node.guard_peer, topic, partial(take, rows))
        self._worker.submit_from(f"robot {speaker}", size, guarded)
