"""Several simulated robots in one world and one time, in one process.

Where the robots of a team start: side by side, in clear space, the target in sight.

The tags by which rovers know each other where there is no target.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from xml.etree import ElementTree

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.team_alignment import TeamTagsConfig, tag_pose
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.turns import Turns
from infomap_ros.simulation.worlds.builder import World

# [m] between robots that start side by side; and if they look for each other: arms must not meet.
ABREAST, APART = 1.0, 1.3
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
    rays, heights = np.meshgrid(angles, np.arange(_LOWEST, _HIGHEST, 2.0 * _TOUCH))
    rays, heights = np.stack([np.cos(rays), np.sin(rays)], axis=-1).reshape(-1, 2), heights.ravel()
    reached = np.zeros(len(rays))
    while True:
        nearest = reached.min()
        going = np.flatnonzero(reached < nearest + _TOUCH)
        points = place + reached[going, None] * rays[going]
        levels = world.terrain.height(points) + heights[going]
        gaps = world.surface_distance(np.column_stack([points, levels]))
        if nearest >= _FARTHEST or gaps.min() < _TOUCH:
            return float(min(max(nearest - _TOUCH, 0.0), _FARTHEST))
        reached[going] += 0.7 * gaps  # the ground that is followed may slope


_PLATES = (  # on the deck of the rover: middle [m] and direction, to the left, right and back
    ((-0.1, 0.125, 0.19), (0.0, 1.0, 0.0)),
    ((-0.1, -0.125, 0.19), (0.0, -1.0, 0.0)),
    ((-0.205, 0.0, 0.19), (-1.0, 0.0, 0.0)),
)
_PLATE, _THICK = 0.2, 0.01  # [m]


def rover_tags(robots: int) -> TeamTagsConfig:
    """Tags on the rovers of a team, whose ids count from 1: three on each, alike."""
    poses = [float(x) for middle, facing in _PLATES for x in tag_pose(middle, facing)]
    carriers = [robot for robot in range(1, robots + 1) for _ in _PLATES]
    ids = tuple(range(20, 20 + len(carriers)))
    return TeamTagsConfig(robots=tuple(carriers), ids=ids, poses=(*poses,) * robots)


def with_plates(description: str) -> str:
    """The rover's URDF text with the plates of its tags, so that it and others know of them."""
    root = ElementTree.fromstring(description)
    base = next(link for link in root.iter("link") if link.get("name") == "base_link")
    for middle, facing in _PLATES:
        place = np.array(middle) - (0.5 * _THICK + 0.006) * np.array(facing)
        size = np.where(np.abs(facing) > 0.5, _THICK, _PLATE)
        for kind in ("visual", "collision"):
            part = ElementTree.SubElement(base, kind)
            ElementTree.SubElement(part, "origin", xyz=_text(place), rpy="0 0 0")
            box = ElementTree.SubElement(part, "geometry")
            ElementTree.SubElement(box, "box", size=_text(size))
    return ElementTree.tostring(root, encoding="unicode")


def _text(numbers: FloatArray) -> str:
    return " ".join(f"{number:g}" for number in numbers)


_TURN = 0.1  # [s] that a robot may be ahead of the others


class TeamSimulator(Simulator):
    """A `Simulator` that lets the others have their turn as it goes on."""

    after_step: Callable[[], None] | None = None
    _passed_on = 0.0  # [s], when the others had their turn

    def step(self, duration: float) -> None:
        """Simulate for a while [s], and wait where the others have not come as far.

        Raises:
            InvalidInputError: as `Simulator.step`.
            SwitchedOff: this robot is switched off.
        """
        super().step(duration)
        if self.after_step is not None and self.time >= self._passed_on + _TURN - 1e-6:
            self._passed_on = self.time
            self.after_step()


class TeamWorld:
    """Robots that see each other, and stand in each other's way.

    Args:
        world: where.
        description: URDF text of all robots.
        config: of each robot; the seeds and starts become different ones.
        robots: how many; they have numbers from 0 on.
        on_step: called after each step of a robot, when the others have come as far, with its
            number.

    Attributes:
        starts: where the robots began.
        simulators: of the robots.
        turns: in which they run.

    Raises:
        RobotModelError: as `Simulator`.
        SimulationError: likewise.
    """

    def __init__(
        self,
        world: World,
        description: str,
        config: SimulatorConfig,
        robots: int,
        on_step: Callable[[int], None] = lambda _: None,
    ) -> None:
        names = self._names = tuple(f"robot_{number}" for number in range(robots))
        self.turns, self._on_step = Turns(names), on_step
        self.simulators: list[TeamSimulator] = []
        self.starts = team_starts(world, robots)
        for number, start in enumerate(self.starts):
            own = dataclasses.replace(config, seed=config.seed + 1000 * number, start=start.place)
            others = {name: description for name in names if name != names[number]}
            simulator = TeamSimulator(world, description, own, others)
            simulator.after_step = partial(self._after_step, number)
            self.simulators.append(simulator)
        for number in range(robots):
            self._place_others(number)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robots, by their numbers."""
        return self._names

    @property
    def contacts(self) -> int:
        """Forbidden contacts of all robots."""
        return sum(simulator.contacts for simulator in self.simulators)

    def close(self) -> None:
        """Free what drawing needs."""
        for simulator in self.simulators:
            simulator.close()

    def _after_step(self, number: int) -> None:
        self.turns.pass_on(self._names[number], self.simulators[number].time)
        self._place_others(number)
        self._on_step(number)

    def _place_others(self, number: int) -> None:
        own = self.simulators[number]
        for name, other in zip(self._names, self.simulators, strict=True):
            if other is not own:
                own.place_teammate(name, other.true_pose(), other.true_joints())
