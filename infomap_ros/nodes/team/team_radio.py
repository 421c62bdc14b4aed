"""Messages of the team that get lost on purpose, to see what becomes of it."""

from __future__ import annotations

import random
from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, setting

_TEAM = "team/"


@dataclass(frozen=True)
class TeamRadioConfig:
    """A bad radio between robots, for tests.

    Raises:
        ConfigError: a value is out of its range.
    """

    simulated_loss: float = setting(
        0.0,
        "For tests: share of the messages on topics team/* that are dropped on arrival, as a bad "
        "radio would.",
        low=0.0,
        high=0.99,
    )

    def __post_init__(self) -> None:
        check_config(self)


def loses(config: TeamRadioConfig, topic: str) -> bool:
    """Whether a message on a topic, as the node calls it, gets lost."""
    return topic.startswith(_TEAM) and random.random() < config.simulated_loss
