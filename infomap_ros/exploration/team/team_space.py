"""The space that teammates take: for the choice of views, and for the ways of base and arm."""

from __future__ import annotations

import numpy as np

from infomap_ros.exploration.planar import spaced
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.obstacles import Obstacle
from infomap_ros.team.agents import Agent
from infomap_ros.team.agents_config import AgentsConfig
from infomap_ros.views.situation import Teammate

_LEAST_SHARE = 0.5  # of a body's radius, however near one stands to it


def teammate_of(agent: Agent) -> Teammate:
    """A robot as the choice of a view sees it: the middle of its body, and what it will see."""
    base = agent.T_map_base
    middle = base[:3, 3] + 0.5 * (agent.bottom + agent.top) * base[:3, 2]
    stand = None
    if agent.goal is not None and len(agent.way):
        stand = np.array([*agent.way[-1, :2], middle[2]])
    return Teammate(middle, agent.goal, agent.max_range, agent.camera, agent.radius, stand)


def bodies_in_the_way(
    agent: Agent, goes_on: bool, own_place: FloatArray, own_radius: float, config: AgentsConfig
) -> list[Obstacle]:
    """A robot's body, and the rest of the way that it has told, as upright cylinders.

    They are grown by the clearance and by three standard deviations of its position; less where
    this robot stands within that already, as it must be able to leave.

    Args:
        agent: as it told last.
        goes_on: whether it was heard lately, so that its way counts.
        own_place: x and y of this robot's base, shape (2,) [m, map].
        own_radius: of this robot's body about its base [m].
        config: of the clearance.
    """
    here = agent.T_map_base[:2, 3]
    places = [here]
    if goes_on and agent.goal is not None and len(agent.way):
        way = agent.way[:, :2]
        rest = way[int(np.linalg.norm(way - here, axis=1).argmin()) :]
        places += list(spaced(rest, 0.5 * max(agent.radius, 0.1)))
    bottom, top = agent.T_map_base[2, 3] + agent.bottom, agent.T_map_base[2, 3] + agent.top
    obstacles = []
    for number, place in enumerate(places):
        room = float(np.linalg.norm(place - own_place)) - own_radius
        least = _LEAST_SHARE * agent.radius if number == 0 else 0.0
        radius = max(min(agent.reach + config.clearance, room), least)
        if radius > 0.0:
            x, y = float(place[0]), float(place[1])
            name = f"robot {agent.robot}" if number == 0 else f"the way of robot {agent.robot}"
            obstacles.append(Obstacle(x, y, radius, bottom, max(top, bottom + 0.1), name))
    return obstacles
