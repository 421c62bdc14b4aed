"""Who is near, for the node that moves the robot: heard on team/agents."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.agents_topic import listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents import Agent
from infomap_ros.team.authentication import TeamKey


@dataclass(frozen=True)
class TeammatesNearConfig:
    """Who counts as a teammate.

    Raises:
        ConfigError: a value is out of its range.
    """

    robot_id: int = parameter(0, "Id of this robot in its team.", low=0, high=65535)
    team: tuple[int, ...] = parameter(
        (), "Ids of the robots that count as teammates; all where empty."
    )
    team_key: str = parameter(
        "", "File with the secret of the team, as map_fusion has it; empty for none."
    )

    def __post_init__(self) -> None:
        check_config(self)


class TeammatesNear:
    """What the others tell of themselves.

    Args:
        node: that listens; has the configurations of this and of the tracker.
    """

    def __init__(self, node: MonitoredNode) -> None:
        who = node.config(TeammatesNearConfig)
        key = TeamKey.of_team(who.team_key)
        self._board = AgentBoard(who.robot_id, None, team=who.team, key=key)
        self._own = node.resolve_topic_name("robot_description")
        self._lock = threading.Lock()
        listen_to_agents(node, node.config(RobotTrackerConfig).map_frame, self._hear)

    def present(self) -> tuple[Agent, ...]:
        """The others that were heard lately, as they told last; may be asked by any thread."""
        with self._lock:
            heard = self._board.present(time.monotonic())
        # An explorer that was given no id hears its own robot's next_best_view, too.
        return tuple(agent for agent in heard if agent.description != self._own)

    def _hear(self, text: str) -> None:
        with self._lock:
            self._board.hear(text, time.monotonic())
