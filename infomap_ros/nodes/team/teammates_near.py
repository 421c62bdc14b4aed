"""Who is near, for the node that moves the robot: heard on team/agents."""

from __future__ import annotations

import threading
import time

from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.agents_topic import listen_to_agents
from infomap_ros.nodes.team.team_identity import TeamIdentityConfig
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents import Agent


class TeammatesNear:
    """What the others tell of themselves.

    Args:
        node: that listens; has the configurations of team and tracker.
    """

    def __init__(self, node: MonitoredNode) -> None:
        who = node.config(TeamIdentityConfig)
        self._board = AgentBoard(who.robot_id, None, team=who.team, key=who.read_key())
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
