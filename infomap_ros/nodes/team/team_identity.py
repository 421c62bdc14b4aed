"""Who a node's robot is in its team, and whose messages count."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.team.authentication import TeamKey


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
