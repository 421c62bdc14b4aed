"""Configuration of what a robot tells its team and asks of it."""

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
        "What this robot sends of the map at the most, on average; what tells most goes first.",
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
        "Time between two digests of what was told, and two rounds of requests.",
        unit="s",
        low=0.02,
        high=60.0,
    )
    summary_period: float = setting(
        1.0,
        "Time between two summaries of all that this robot holds.",
        unit="s",
        low=0.05,
        high=600.0,
    )
    request_timeout: float = setting(
        0.2,
        "Time until what was asked for and has not come is asked for again.",
        unit="s",
        low=0.05,
        high=60.0,
    )
    silence: float = setting(
        5.0,
        "A robot that was not heard for so long is taken to be gone: others answer for it.",
        unit="s",
        low=0.5,
        high=3600.0,
    )

    recovery: float = setting(
        10.0,
        "For so long after the start, what others know of this robot's contribution is put into "
        "its map again; then all of its map is told.",
        unit="s",
        low=0.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


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
