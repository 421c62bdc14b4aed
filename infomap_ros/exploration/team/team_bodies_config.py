"""How it is found out where teammates were: the parameters."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter


@dataclass(frozen=True)
class TeammatePlacesConfig:
    """Where teammates may have been at a time.

    Raises:
        ConfigError: a value is out of its range.
    """

    max_gap: float = parameter(
        0.6,
        "Longest time between two messages of a teammate across which its place is interpolated.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    speed: float = parameter(
        0.7,
        "How fast any part of a teammate moves at the most: so much its body grows for each second "
        "for which it is not known where it was.",
        unit="m/s",
        low=0.0,
        high=100.0,
    )
    most_growth: float = parameter(
        1.5, "It grows no further by that: it is taken to have stopped.", unit="m", low=0.0,
        high=100.0,
    )  # fmt: skip
    unknown_sigma: float = parameter(
        0.1,
        "Standard deviation of the place of a teammate that does not tell it.",
        unit="m",
        low=0.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class TeamBodiesConfig(TeammatePlacesConfig):
    """How teammates' bodies are found in scans.

    Raises:
        ConfigError: a value is out of its range.
    """

    wait: float = parameter(
        0.5,
        "How long a scan waits until it is known where teammates were at its stamp, in time of the "
        "data.",
        unit="s",
        low=0.0,
        high=10.0,
    )
