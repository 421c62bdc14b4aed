"""Several simulated robots in one world and one time, in one process."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

from infomap_ros.simulation.multi_robot.team_starts import team_starts
from infomap_ros.simulation.multi_robot.turns import Turns
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import World

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
