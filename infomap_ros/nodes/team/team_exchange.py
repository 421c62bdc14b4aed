"""The topics team/digests and team/requests, on which robots find out what they have missed."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.messages.rows import encode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.team.team_topics import DIGESTS, REQUESTS, TeamInbox
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import TeamKey

Rows = NDArray[np.void]
IGNORED = "ignored by a teammate"


class TeamExchange:
    """Carries digests and requests of a member of a team. The work is done in a worker thread.

    Args:
        node: that speaks.
        frame: of the map.
        worker: where the member lives.
        key: of the team, None without one.
        find_member: gives it, None as long as there is none.
        on_change: called by the worker when a robot's map was taken in or left out.
        foreign: called with each digest before that, as it may be the first sign of a team.
    """

    def __init__(
        self,
        node: MonitoredNode,
        frame: str,
        worker: Worker,
        key: TeamKey | None,
        find_member: Callable[[], TeamMember | None],
        on_change: Callable[[], object],
        foreign: Callable[[Rows], object] = lambda rows: None,
    ) -> None:
        self._node, self._frame, self._worker = node, frame, worker
        self._find_member, self._on_change, self._foreign = find_member, on_change, foreign
        self._types, self._speaking = RclpyMessageTypes(), False
        profile = qos.stream(depth=200)
        self._publishers = {
            topic: node.advertise(PointCloud2, topic, profile) for topic in (DIGESTS, REQUESTS)
        }
        inbox = TeamInbox(node, frame, worker, key)
        for topic in (DIGESTS, REQUESTS):
            inbox.listen(topic, partial(self._receive, topic))
        period = node.config(TeamConfig).digest_period
        node.repeat(period, self._speak_soon)

    def _receive(self, topic: str, rows: Rows) -> None:
        if topic == DIGESTS:
            self._foreign(rows)
        member = self._find_member()
        if member is None:
            return
        receive = member.receive_digest if topic == DIGESTS else member.receive_request
        receive(rows, time.monotonic())

    def _speak_soon(self) -> None:
        """Have the worker speak, unless it still has to."""

        def speak() -> None:
            self._speaking = False
            self._speak()

        if self._find_member() is not None and not self._speaking:
            self._speaking = True
            self._worker.submit_always(speak)

    def _speak(self) -> None:
        member = self._find_member()
        if member is None:
            return
        aside = member.replica.aside
        self._publish(DIGESTS, member.digests(time.monotonic()))
        if member.replica.aside != aside:
            self._on_change()
        for robot, found in member.contradictions.items():
            known = f"{found.contradicted} of {found.compared} surface voxels"
            self._node.drop("maps contradict", f"robot {robot}: {known}; it is left out")
        for robot, version in member.barred_by(time.monotonic()).items():
            known = f"holds version {version} of this robot, which is at {member.version}"
            self._node.drop(IGNORED, f"robot {robot} {known}; restart this robot, set its clock")
        self._publish(REQUESTS, member.requests(time.monotonic()))

    def _publish(self, topic: str, messages: list[Rows]) -> None:
        stamp = self._node.get_clock().now().nanoseconds
        for rows in messages:
            encoded = encode_rows(self._types, stamp, self._frame, rows)
            self._publishers[topic].publish(encoded)
