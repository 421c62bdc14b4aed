"""The explorations of a study: many, over the cores, each kept in a file as soon as it is done."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from infomap_ros.studies.planar.explore import Exploration, ExplorationConfig, explore
from infomap_ros.studies.planar.floor_plans import read_floor_plan
from infomap_ros.studies.planar.generators import make_world
from infomap_ros.studies.planar.settings import planar_choice
from infomap_ros.studies.planar.team_explore import explore_together
from infomap_ros.studies.planar.world import PlanarWorld


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
    """One exploration.

    Attributes:
        world: to be explored.
        strategy: name of a strategy, or dotted path of a class.
        config: sensor, number of scans, seed.
        candidates: number of candidate views.
        sensors: that explore together.
    """

    world: WorldName
    strategy: str
    config: ExplorationConfig
    candidates: int
    sensors: int = 1

    @property
    def label(self) -> str:
        """Name of the strategy for tables: that of its class where it is a dotted path."""
        return self.strategy.rpartition(".")[2]

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{self.world}__{self.label}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code; a result with another one is stale."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def run(self) -> Exploration:
        """Explore."""
        world, sensor = self.world.make(), self.config.sensor
        choice = planar_choice(sensor.max_range, self.world.cell, self.candidates, self.strategy)
        if self.sensors > 1:
            return explore_together(world, self.strategy, self.config, choice, self.sensors)
        return explore(world, self.strategy, self.config, choice)


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
    folder.mkdir(parents=True, exist_ok=True)
    found = {task: load_result(task, folder) for task in tasks}
    done = sum(result is not None for result in found.values())
    if progress is not None:
        progress(done)
    missing = [task for task, result in found.items() if result is None] if compute else []
    if missing:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(_run_and_keep, task, folder): task for task in missing}
            for future in as_completed(futures):
                found[futures[future]] = future.result()
                done += 1
                if progress is not None:
                    progress(done)
    return [Record(task, result) for task, result in found.items() if result is not None]


def load_result(task: Task, folder: Path) -> Exploration | None:
    """The kept result of a task; None where there is none, or that of other settings."""
    path = folder / task.file_name
    if not path.exists():
        return None
    with np.load(path) as kept:
        if str(kept["fingerprint"]) != task.fingerprint():
            return None
        names = [field.name for field in dataclasses.fields(Exploration)]
        values = {name: kept[name] for name in names}
    return Exploration(**values | {"ended": str(values["ended"])})


def _run_and_keep(task: Task, folder: Path) -> Exploration:
    result = task.run()
    arrays = {field.name: getattr(result, field.name) for field in dataclasses.fields(result)}
    path = folder / task.file_name
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, fingerprint=task.fingerprint(), **arrays)
    partial.replace(path)
    return result
