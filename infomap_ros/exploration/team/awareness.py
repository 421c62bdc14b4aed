"""What a robot knows of itself and of its teammates while it moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from infomap_ros.geometry import PlacedSolid
from infomap_ros.motion.robot.solid_extent import upright_extent
from infomap_ros.team.agents import Agent

NEARER = 0.05
"""Poses are noisy: who is nearer by less is where it was [m]."""


@dataclass(frozen=True, eq=False)
class Awareness:
    """What the robot knows while it moves.

    Attributes:
        place: tells where its base is: x, y [m, map] and yaw [rad].
        joints: tells their positions by name [rad or m].
        body: its solids in a posture, by positions of the joints, placed in its base frame.
        teammates: tells who was heard lately, and where.
        pause: lets a moment pass.
        say: is told what the robot does, and why.
    """

    place: Callable[[], tuple[float, float, float]]
    joints: Callable[[], Mapping[str, float]]
    body: Callable[[Mapping[str, float]], Sequence[PlacedSolid]]
    teammates: Callable[[], Sequence[Agent]]
    pause: Callable[[], object]
    say: Callable[[str, str], object]

    def radius(self) -> float:
        """How far the body reaches from the axis of its base now [m]."""
        return upright_extent(self.body(self.joints()))[0]


def who_and_how_near(mate: Agent, gap: float) -> str:
    """A teammate that is in the way, in words; the gap to it [m]."""
    return f"robot {mate.robot} is in the way, {max(gap, 0.0):.2f} m from it"
