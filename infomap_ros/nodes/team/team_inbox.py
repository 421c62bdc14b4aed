"""Messages of the team's map as a node takes them in: read, checked for whose they are, and queued.

They wait for the worker in a queue that is bounded for all and shared fairly between the robots. A
message counts for the robot that its header name; where the team has a key, what is not signed is
dropped before it can take the place of what is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError, InvalidInputError
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.team.authentication import TeamKey
from infomap_ros.team.message_header import header_of
from infomap_ros.team.wire import MAX_MESSAGE_BYTES

Rows = NDArray[np.void]


class TeamInbox:
    """Listens to topics of the team for a worker.

    Args:
        node: that listens.
        frame: of the map.
        worker: where messages are heard.
        key: of the team; without one every message is taken for genuine.
    """

    def __init__(
        self, node: MonitoredNode, frame: str, worker: Worker, key: TeamKey | None
    ) -> None:
        self._node, self._frame, self._worker, self._key = node, frame, worker, key

    def listen(self, topic: str, hear: Callable[[Rows], object], *, required: bool = False) -> None:
        """Subscribe.

        Args:
            topic: relative name.
            hear: called by the worker with the rows of each message that has some.
            required: whether its absence is worth a warning.
        """
        receive, profile = partial(self._receive, topic, hear), qos.stream(depth=200)
        self._node.listen(PointCloud2, topic, receive, profile, required=required, from_peer=True)

    def _receive(self, topic: str, hear: Callable[[Rows], object], message: PointCloud2) -> None:
        size = len(message.data)
        if size > 2 * MAX_MESSAGE_BYTES:
            raise InvalidInputError(
                "message", f"{size} bytes, at most {MAX_MESSAGE_BYTES} are told"
            )
        _, frame, rows = decode_rows(message)
        if frame != self._frame:
            raise FrameError(f"told in frame '{frame}', the map is '{self._frame}'")
        if not len(rows):
            return
        if self._key is not None:
            self._key.verify(rows)
        header = header_of(rows, "message")
        speaker = header.get("sender", header.get("robot", "nobody"))
        guarded = partial(self._node.guard_peer, topic, partial(hear, rows))
        self._worker.submit_from(f"robot {speaker}", size, guarded)
