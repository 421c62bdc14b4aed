"""The explorations of a study: many, over the cores, each kept in a file as soon as it is done."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from infomap_ros.studies.common.runs import Kept, run_all
from infomap_ros.studies.planar.explore import Exploration, ExplorationConfig, explore
from infomap_ros.studies.planar.floor_plans import read_floor_plan
from infomap_ros.studies.planar.generators import make_world
from infomap_ros.studies.planar.settings import planar_choice
from infomap_ros.studies.planar.team_explore import explore_together
from infomap_ros.studies.planar.world import PlanarWorld
from infomap_ros.views.unproductive_looks import UnproductiveLooksConfig


def label_of(strategy: str) -> str:
    """Name of a strategy for tables: that of its class where it is a dotted path."""
    return strategy.rpartition(".")[2]


@dataclass(frozen=True)
class WorldName:
    """What a world is made from.

    Attributes:
        kind: one of `generators.KINDS`, or "floor plans".
        seed: of a drawn world.
        path: of a floor plan, "" for a drawn world.
        cell: edge of a cell [m].
    """

    kind: str
    seed: int = 0
    path: str = ""
    cell: float = 0.5

    def __str__(self) -> str:
        return Path(self.path).stem if self.path else f"{self.kind}_{self.seed}"

    def make(self) -> PlanarWorld:
        """Draw the world, or read it."""
        if self.path:
            return read_floor_plan(self.path, self.cell)
        return make_world(self.kind, self.seed, self.cell)


@dataclass(frozen=True)
class Task:
    """One exploration: implements `infomap_ros.studies.common.runs.Task`.

    Attributes:
        world: to be explored.
        strategy: name of a strategy, or dotted path of a class.
        config: sensor, number of scans, seed.
        candidates: number of candidate views.
        sensors: that explore together.
        unproductive: when voxels are given up that views promised to inform and did not; or never.
    """

    world: WorldName
    strategy: str
    config: ExplorationConfig
    candidates: int
    sensors: int = 1
    unproductive: UnproductiveLooksConfig | None = None

    @property
    def label(self) -> str:
        """Name of the strategy for tables."""
        return label_of(self.strategy)

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{self.world}__{self.label}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code; a result with another one is stale."""
        values = {name: v for name, v in dataclasses.asdict(self).items() if v is not None}
        return json.dumps(values, sort_keys=True)

    def run(self) -> Exploration:
        """Explore."""
        world, sensor = self.world.make(), self.config.sensor
        choice = planar_choice(sensor.max_range, self.world.cell, self.candidates, self.strategy)
        if self.sensors > 1:
            return explore_together(world, self.strategy, self.config, choice, self.sensors)
        return explore(world, self.strategy, self.config, choice, unproductive=self.unproductive)


@dataclass(frozen=True, eq=False)
class Record:
    """A task with its result."""

    task: Task
    result: Exploration


def run_tasks(
    tasks: Sequence[Task],
    folder: Path,
    jobs: int,
    progress: Callable[[int], None] | None = None,
    compute: bool = True,
) -> list[Record]:
    """Do what is not done yet; what is found in the folder is not done again.

    Args:
        tasks: what to do; the first are done first.
        folder: keeps the results, one file each; made if need be.
        jobs: processes.
        progress: called with the number of tasks done.
        compute: else only what is found is returned.

    Returns:
        Records in the order of the tasks.
    """
    kept = Kept(folder, Exploration)
    return [Record(*pair) for pair in run_all(tasks, kept, jobs, progress, compute).items()]
