"""Teammates' bodies, as map_fusion keeps them out of the map.

Where they are they report on team/agents, and there also the topic of their robot_description and
the hash of what stands there. It is read where the team says who belongs to it, by a list or a
key; of strangers, the cylinder that they report is all that is known.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from std_msgs.msg import String

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.exploration.team.teammate_places import BodyInScan, TeamBodies
from infomap_ros.geometry import PoseRecord
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.messages import decode_text
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.urdf import hash_of_description
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_body import RobotBodyConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents import Agent
from infomap_ros.team.membership import NOT_AUTHENTIC

_MOST_DESCRIPTIONS = 64
_LONGEST_KEPT = 1 << 20  # characters of a text that came before its hash


class TeamBodyListener:
    """Knows where the bodies of the others are.

    Args:
        node: that listens; has the configurations of who is in the team and of bodies.
        frame: of the map.
        on_change: called when more is known of them than before.
        on_arrival: called with the body of a robot that is new or back, placed in the map.
    """

    def __init__(
        self,
        node: MonitoredNode,
        frame: str,
        on_change: Callable[[], None],
        on_arrival: Callable[[BodyInScan], None],
    ) -> None:
        self._node, self._on_change, self._on_arrival = node, on_change, on_arrival
        who = node.config(TeamIdentityConfig)
        self._board = AgentBoard(who.robot_id, None, who.team, who.read_key())
        self._bodies = TeamBodies(node.config(BodyFilterConfig))
        self._reading = node.config(RobotBodyConfig).robot
        self._is_closed = bool(who.team) or bool(who.team_key)
        self._topics: dict[int, str] = {}
        self._reported: dict[int, Agent] = {}
        self._unread: dict[int, str] = {}
        self._listening = 0
        self._models: dict[int, RobotModel] = {}
        listen_to_agents(node, frame, self._receive)

    def check_known_at(self, stamp: int, newest: int) -> None:
        """Make sure that nothing more need be waited for; times [ns].

        Raises:
            PoseUnavailableError: it may still be reported where a teammate was at that time.
        """
        present = [agent.robot for agent in self._board.present(time.monotonic())]
        self._bodies.check_known_at(stamp, newest, present)

    def bodies_in(self, camera: PoseRecord) -> Sequence[BodyInScan]:
        """Their bodies, placed for a scan from a pose of the camera in the map."""
        self._board.origin = 0 if camera.uncertainty is None else camera.uncertainty.origin
        remembered = self._board.remembered(time.monotonic())
        self._bodies.keep([agent.robot for agent in remembered])
        found = self._bodies.bodies_in(camera)
        if found:
            words = [f"{body.robot}{'' if body.is_sure else ' (place not sure)'}" for body in found]
            self._node.health.note("teammates in scans", ", ".join(words))
        return found

    def _receive(self, text: str) -> None:
        agent = self._board.receive(text, time.monotonic())
        if agent is not None and self._board.shares_frame(agent):
            self._bodies.receive(agent)
            self._ask_what_it_is(agent)
            for body in self._bodies.take_arrivals():
                self._on_arrival(body)
            self._on_change()

    def _ask_what_it_is(self, agent: Agent) -> None:
        """Listen to the description of a teammate that is new, or has another one than before."""
        robot, topic = agent.robot, agent.description
        self._reported[robot] = agent
        if robot in self._models and not self._bodies.is_described(robot):
            self._bodies.describe(robot, self._models[robot])  # forgotten, and back
        if robot in self._unread:
            self._read(robot, self._unread.pop(robot))
        is_known = self._topics.get(robot) == topic
        if not self._is_closed or not topic or is_known or topic in self._topics.values():
            return
        if self._listening >= _MOST_DESCRIPTIONS:
            return
        self._listening += 1
        self._topics[robot] = topic
        receive = partial(self._on_description, robot)
        profile = qos.latched()
        self._node.listen(String, topic, receive, profile, required=False, from_peer=True)

    def _on_description(self, robot: int, message: String) -> None:
        self._read(robot, decode_text(message).text)

    def _read(self, robot: int, text: str) -> None:
        """Learn what a teammate is, if this is the text of which it reported the hash.

        Raises:
            UpdateRefusedError: it is not, or not yet.
        """
        agent = self._reported[robot]
        if hash_of_description(text) != agent.description_hash:
            if len(text) <= _LONGEST_KEPT:
                self._unread[robot] = text
            wrong = f"what {agent.description} says is not what robot {robot} has reported"
            raise UpdateRefusedError(wrong, NOT_AUTHENTIC)
        model = self._reading.read(text, base_frame=agent.base_frame)
        self._models[robot] = model
        self._bodies.describe(robot, model)
        self._node.get_logger().info(f"removing the body of teammate {robot} from clouds")
