"""Configuration of what a robot sends its team and asks of it.

How much of this robot's memory, processor and bandwidth the others can take.

Whatever a message of another robot can fill has its bound here, with where it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter, setting


@dataclass(frozen=True)
class TeamConfig:
    """How a robot shares its map.

    Raises:
        ConfigError: a value is out of its range.
    """

    bandwidth: float = parameter(
        5.0,
        "What this robot sends of the map at the most, on average; most information first.",
        unit="MB/s",
        low=0.001,
        high=1000.0,
    )
    message_size: int = setting(
        60_000,
        "Upper limit of a message. Below 64 kB it fits one datagram; where datagrams are lost and "
        "nothing sends them again, what fits one packet of the network is best.",
        unit="bytes",
        low=1000,
        high=1_000_000,
    )
    digest_period: float = setting(
        0.1,
        "Time between two digests of what was sent, and two rounds of requests.",
        unit="s",
        low=0.02,
        high=60.0,
    )
    silence: float = setting(
        5.0,
        "A robot that has sent nothing for so long is taken to be gone: others answer for it.",
        unit="s",
        low=0.5,
        high=3600.0,
    )

    recovery: float = setting(
        10.0,
        "For so long after the start, what others know of this robot's contribution is put into "
        "its map again; then all of its map is sent.",
        unit="s",
        low=0.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


REQUEST_TIMEOUT = 0.2
"""Time until what was asked for and has not come is asked for again [s]."""


class Budget:
    """How many bytes may be sent now.

    Args:
        bandwidth: on average [bytes/s].
        burst: time for which unused bytes are kept [s].
    """

    def __init__(self, bandwidth: float, burst: float = 0.15) -> None:
        self._rate, self._most = bandwidth, max(2000.0, bandwidth * burst)
        self._bytes, self._last = self._most, float("nan")

    def available(self, now: float) -> float:
        """Bytes that may be sent at a time [s]; below zero after more than that was sent."""
        if now > self._last:
            self._bytes = min(self._most, self._bytes + self._rate * (now - self._last))
        self._last = now
        return self._bytes

    def spend(self, count: float) -> None:
        """Count bytes as sent."""
        self._bytes -= count


MOST_ROBOTS = 64
"""Robots of which anything is kept where no team list says more.

A replica sums over its robots for each voxel that it receives, and 32 robots already send half of
what one core can receive (docs/team.md).
"""

MOST_MISSED = 1 << 14
"""Missed blocks of one contribution that are remembered.

As many as two messages of the usual 60 kB name twice over; what is missed beyond that the next
comparison of whole contributions finds.
"""

MOST_TRIES = 8
"""Times that a missed block is asked for.

With a fifth of all requests and answers lost, 3 of 10^4 blocks stay missed, and are found again by
the next comparison. 8 requests of 12 bytes for a row of 16 bytes: a digest costs six times its
bytes.
"""

MISSED_FOR = 30.0
"""Time for which a block is missed [s].

Well above the eight tries at the default request timeout; who has died meanwhile is not asked for
ever.
"""

MOST_WANTED = 32
"""Questions of one robot that wait for their answer."""

MOST_BLOCKS_TAKEN_BACK = 1 << 14
"""Blocks that others hold of an earlier start, and that are taken back after the recovery.

Each takes 2.6 kB, so 43 MB. What more they hold stays with them; it was true when it was sent.
"""

TAKEN_BACK_SHARE = 0.02
"""Part of the memory limit for these blocks, where that is less: anybody may hand back anything."""

MOST_RECOVERED = 1 << 20
"""Voxels that others know of this robot and that wait to be put into its map; 40 MB."""

TALK_SHARE = 0.15
"""Part of the bandwidth that each of these may take: digests of what this robot sent, digests that
others ask for, and requests. The rest is left for the map itself, whatever the others say."""

GUESTS_MOST, BORROWED_MOST, ROOM_AFTER = 0.9, 0.75, 0.6
"""Parts of the memory limit: for which others' contributions leave room, and which they leave.

Others write into the shared map until 0.9 of the limit is used, so that what this robot sends
always fits; beyond an equal share only until 0.75 is used, so that who needs less than its share
gets it; and where there is no room, what informs least is dropped until 0.6 is used.
"""

ROOM_PERIOD = 60.0
"""Time between two such droppings [s], as the sum over the robots is made again each time."""
