"""Where the robots of a team start: side by side, in clear space, the target in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.builder import World

ABREAST = 1.0  # [m] between robots that start side by side
_ASIDE = 0.25  # [rad]; the target is no farther from ahead
_HIGHEST = 1.3  # [m] above the ground; nothing of a robot is higher
_LOWEST = 0.1  # [m]; what is lower is ground
_FARTHEST = 1.5  # [m]; what is farther off is of no matter
_TOUCH = 0.04  # [m] from a surface
_RAYS = 96


@dataclass(frozen=True)
class TeamStart:
    """Where one robot starts.

    Attributes:
        place: x, y [m], yaw [rad] in the world.
        clearance: radius about it in which there is nothing but ground and robots [m].
    """

    place: tuple[float, float, float]
    clearance: float


def team_starts(world: World, robots: int, distance: float = ABREAST) -> list[TeamStart]:
    """Starts of a team about the start of a world.

    A single robot starts as the world says. The world's start is clear for one; beside it things
    may be nearer, which whoever starts a team has to say.

    Args:
        world: where.
        robots: how many.
        distance: between two of them [m].

    Returns:
        From the right to the left. Each looks ahead, or so far aside that it sees the target.
    """
    x, y, yaw = world.start
    offsets = distance * (np.arange(robots) - 0.5 * (robots - 1))
    starts = []
    for offset in offsets:
        place = np.array([x - offset * np.sin(yaw), y + offset * np.cos(yaw)])
        heading = yaw if robots == 1 else yaw + _turn_to_target(world, place, yaw)
        clearance = _clearance(world, place)
        starts.append(TeamStart((float(place[0]), float(place[1]), float(heading)), clearance))
    return starts


def _turn_to_target(world: World, place: FloatArray, yaw: float) -> float:
    """How far a robot turns so that the target is ahead, but for `_ASIDE` [rad]."""
    if world.T_world_target is None:
        return 0.0
    away = world.T_world_target[:2, 3] - place
    bearing = float(np.angle(np.exp(1j * (np.arctan2(away[1], away[0]) - yaw))))
    return bearing - float(np.clip(bearing, -_ASIDE, _ASIDE))


def _clearance(world: World, place: FloatArray) -> float:
    """Distance of the nearest thing that stands on the ground or hangs above it [m].

    Marches outwards at constant heights above the ground, each step as far as nothing is near.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)
    ways, heights = np.meshgrid(angles, np.arange(_LOWEST, _HIGHEST, 2.0 * _TOUCH))
    ways, heights = np.stack([np.cos(ways), np.sin(ways)], axis=-1).reshape(-1, 2), heights.ravel()
    reached = np.zeros(len(ways))
    while True:
        nearest = reached.min()
        going = np.flatnonzero(reached < nearest + _TOUCH)
        points = place + reached[going, None] * ways[going]
        levels = world.terrain.height(points) + heights[going]
        gaps = world.surface_distance(np.column_stack([points, levels]))
        if nearest >= _FARTHEST or gaps.min() < _TOUCH:
            return float(min(max(nearest - _TOUCH, 0.0), _FARTHEST))
        reached[going] += 0.7 * gaps  # the ground that is followed may slope
