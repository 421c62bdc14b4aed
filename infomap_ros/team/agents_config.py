"""How robots hear of each other: the parameters."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, setting


@dataclass(frozen=True)
class AgentBoardConfig:
    """For how long what a teammate has told counts.

    Raises:
        ConfigError: a value is out of its range.
    """

    silence: float = setting(
        5.0,
        "What a teammate was heading for no longer counts when it was not heard for so long.",
        unit="s",
        low=0.1,
        high=3600.0,
    )
    memory: float = setting(
        60.0,
        "Its body still counts for so long; then it is part of the scene, if it stands there.",
        unit="s",
        low=0.1,
        high=86400.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class AgentsConfig(AgentBoardConfig):
    """How a robot tells of itself, and what it makes of what the others tell.

    Raises:
        ConfigError: a value is out of its range.
    """

    period: float = setting(
        0.2,
        "Time between two messages about this robot, in time of the data.",
        unit="s",
        low=0.01,
        high=60.0,
    )
    settling: float = setting(
        0.3,
        "After a goal is claimed, time in which claims that teammates made at the same moment are "
        "waited for: longer than a message takes.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    idle_timeout: float = setting(
        120.0,
        "Where teammates leave no view that is worth its cost, this robot waits as long as they go "
        "from view to view, and so long after that; then it has nothing left to do.",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    goal_time: float = setting(
        300.0,
        "A goal that was claimed longer ago is given up, in time of the data.",
        unit="s",
        low=1.0,
        high=86400.0,
    )
    clearance: float = setting(
        0.3,
        "Distance that is kept between the bodies, and to the places where teammates are going.",
        unit="m",
        low=0.0,
        high=10.0,
    )
