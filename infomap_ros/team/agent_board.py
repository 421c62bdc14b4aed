"""What is known of the other robots of a team, and for how long it counts."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from infomap_ros.team.agents import Agent
from infomap_ros.team.agents_config import AgentBoardConfig
from infomap_ros.team.membership import Membership
from infomap_ros.team.versions import is_newer


class AgentBoard:
    """What is known of the other robots. Messages are handed in, and so is the time.

    Args:
        robot: id of this robot.
        session: number that it drew when it started; None where it only listens.
        config: when robots are forgotten.
        team: ids of the robots that count; all if empty.
    """

    def __init__(
        self,
        robot: int,
        session: int | None,
        config: AgentBoardConfig | None = None,
        team: Collection[int] = (),
    ) -> None:
        self.config = config or AgentBoardConfig()
        self._robot, self._listens = robot, session is None
        self._membership = Membership(robot, session, team, self.config.silence)
        self._agents: dict[int, Agent] = {}
        self._heard: dict[int, float] = {}

    def hear(self, agent: Agent, now: float, own_version: int = 0) -> bool:
        """Learn what a robot tells of itself.

        Args:
            agent: as it was told.
            now: time of any steady clock [s].
            own_version: the newest version of this robot.

        Returns:
            Whether it is news: neither this robot's own words nor older than what is known.

        Raises:
            UpdateRefusedError: it is not on the team list, two robots have one id, or its version
                is impossible after those that were heard.
        """
        self._forget(now)
        if agent.robot == self._robot and self._listens:
            return False
        self._membership.check_update(agent, now, own_version)
        known = self._agents.get(agent.robot)
        late = known is not None and not is_newer(agent.version, known.version)
        if agent.robot == self._robot or late:
            return False
        self._agents[agent.robot] = agent
        self._heard[agent.robot] = now
        return True

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

    def age(self, robot: int, now: float) -> float:
        """Time since a robot was heard [s]; infinite where it never was."""
        return now - self._heard.get(robot, -np.inf)

    def claims(self, now: float) -> dict[int, int]:
        """Claims of the others that are known, by their ids."""
        return {agent.robot: agent.claim for agent in self.present(now)}

    def _forget(self, now: float) -> None:
        silent = [r for r, heard in self._heard.items() if now - heard > self.config.memory]
        for robot in silent:
            del self._heard[robot], self._agents[robot]
