"""What is known of the other robots of a team, and for how long it counts.

How far a robot had come is known for longer than where it stood: whoever repeats its old words
after it has fallen silent is not heard. A robot whose clock went back is told so by its teammates
(`AgentBoard.past`) and goes on after what they know.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from infomap_ros.team.agent_text import agent_from_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.agents_config import AgentBoardConfig
from infomap_ros.team.authentication import TeamKey
from infomap_ros.team.membership import Membership
from infomap_ros.team.own_version import MOST_FOLLOWED
from infomap_ros.team.versions import is_newer, versions_ahead


class AgentBoard:
    """What is known of the other robots. Texts are handed in, and so is the time.

    Args:
        robot: id of this robot.
        session: number that it drew when it started; None where it only listens.
        config: when robots are forgotten.
        team: ids of the robots that count; all if empty.
        key: of the team; without one every message is taken for genuine.
    """

    def __init__(
        self,
        robot: int,
        session: int | None,
        config: AgentBoardConfig | None = None,
        team: Collection[int] = (),
        key: TeamKey | None = None,
    ) -> None:
        self.config, self._key = config or AgentBoardConfig(), key
        self._robot, self._listens = robot, session is None
        self._membership = Membership(robot, session, team, self.config.silence)
        self._agents: dict[int, Agent] = {}
        self._heard: dict[int, float] = {}
        self._newest: dict[int, int] = {}
        self._past: dict[int, float] = {}
        self._now = -math.inf

    def hear(self, text: str, now: float, own_version: int = 0) -> Agent | None:
        """Learn what a robot tells of itself.

        Args:
            text: as `team.agent_text.agent_to_text` writes it.
            now: time of any steady clock [s].
            own_version: the newest version of this robot.

        Returns:
            What it tells, if that is news: neither this robot's own words nor older than what is
            known.

        Raises:
            InvalidInputError: the text is malformed, or says something impossible.
            UpdateRefusedError: it is not of this team, two robots have one id, or its version is
                impossible after those that were heard.
        """
        agent = agent_from_text(text, self._key)
        self._now = now
        self._forget(now)
        if agent.robot == self._robot and self._listens:
            return None
        is_known = self._membership.knows(agent.robot, agent.session)
        self._membership.check_update(agent, now, own_version)
        if agent.robot == self._robot:
            return None
        if self._is_past(agent, is_known):
            self._past[agent.robot] = now
            return None
        self._agents[agent.robot] = agent
        self._heard[agent.robot] = now
        self._past.pop(agent.robot, None)
        self._newest[agent.robot] = agent.version
        return agent

    def _is_past(self, agent: Agent, is_known: bool) -> bool:
        """Whether a robot has told something newer before.

        Who was silent for long and starts again with a clock that was never set cannot catch up,
        and is heard.
        """
        newest = self._newest.get(agent.robot)
        if newest is None or is_newer(agent.version, newest):
            return False
        starts_again = agent.robot not in self._agents and not is_known
        return not (starts_again and versions_ahead(newest, agent.version) > MOST_FOLLOWED)

    def present(self, now: float) -> tuple[Agent, ...]:
        """The others that were heard lately, by id; their goals count."""
        return tuple(
            agent
            for robot, agent in sorted(self._agents.items())
            if now - self._heard[robot] <= self.config.silence
        )

    def remembered(self, now: float) -> tuple[Agent, ...]:
        """All whose bodies count, by id: those that are present and those silent for long."""
        self._forget(now)
        return tuple(agent for _, agent in sorted(self._agents.items()))

    def claims(self, now: float) -> dict[int, int]:
        """Claims of the others that are known, by their ids."""
        return {agent.robot: agent.claim for agent in self.present(now)}

    def past(self) -> dict[int, int]:
        """Newest versions that are known of robots that spoke with older ones lately, by id."""
        silence = self.config.silence
        return {r: self._newest[r] for r, at in self._past.items() if self._now - at <= silence}

    def _forget(self, now: float) -> None:
        silent = [r for r, heard in self._heard.items() if now - heard > self.config.memory]
        for robot in silent:
            del self._heard[robot], self._agents[robot]
