"""What can be set of the exploration of a team."""

from __future__ import annotations

from dataclasses import dataclass, field

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions
from infomap_ros.team.config import TeamConfig


@dataclass(frozen=True)
class TeamTaskConfig:
    """A team and what may happen to it.

    Raises:
        ConfigError: a value is out of its range.
    """

    robots: int = parameter(2, "Number of robots.", low=1, high=16)
    coverage: float = parameter(
        0.9, "The exploration ends when a robot's map has this share of the true surface.", low=0.0
    )
    loss: float = parameter(0.2, "Share of the packets that are lost.", low=0.0, high=0.95)
    rate: float = parameter(10.0, "Of each robot's radio.", unit="Mbit/s", low=0.01, high=1000.0)
    killed_at: float = parameter(
        0.0,
        "Coverage at which the software of the last robot is ended without warning, to be started "
        "again after `down`; 0 for never.",
        low=0.0,
        high=1.0,
    )
    down: float = parameter(20.0, "Time until it is started again.", unit="s", low=0.0, high=1e4)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class TeamExplorationOptions(ExplorationOptions):
    """Everything that can be set of the exploration of a team."""

    team: TeamTaskConfig = field(default_factory=TeamTaskConfig)
    sharing: TeamConfig = field(
        default_factory=lambda: TeamConfig(bandwidth=0.6, message_size=1400, digest_period=0.2)
    )
