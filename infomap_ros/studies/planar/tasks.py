"""The explorations of a study: many, over the cores, each kept in a file as soon as it is done."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from infomap_ros.errors import InvalidInputError
from infomap_ros.studies.common.runs import Kept, run_all
from infomap_ros.studies.planar.explore import (
    Exploration,
    ExplorationConfig,
    explore,
    explore_together,
)
from infomap_ros.studies.planar.settings import planar_choice
from infomap_ros.studies.planar.world import BoolArray, PlanarWorld, make_world


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
        look_limit: looks in vain after which a voxel is given up; None: never.
    """

    world: WorldName
    strategy: str
    config: ExplorationConfig
    candidates: int
    sensors: int = 1
    look_limit: float | None = None

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
        return explore(world, self.strategy, self.config, choice, look_limit=self.look_limit)


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


_SIDE = 100.0  # [m]
_CLEAR = 3  # from walls, of the start [cells]


def read_floor_plan(path: str | Path, cell: float = 0.5, side: float = _SIDE) -> PlanarWorld:
    """Read a floor plan, enlarged or reduced so that its longer side is `side` [m].

    The sensor of the studies sees a seventh of a world's side; so it does here, whatever the size
    of the building. A cell is occupied where any pixel in it is not surely free. The start is the
    place nearest to the middle that lies in the largest free part and clear of walls.

    Args:
        path: of the YAML file that names image and thresholds (ROS map_server, trinary mode).
        cell: edge of a cell [m].
        side: see above.

    Raises:
        InvalidInputError: file or image cannot be read, or there is no free space.
    """
    text = _read(Path(path))
    image = cv2.imread(str(Path(path).parent / _value(text, "image", path)), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InvalidInputError("floor plan", f"{path}: its image cannot be read")
    shade = image.astype(np.float64) / 255.0
    occupancy = shade if _value(text, "negate", path) == "1" else 1.0 - shade
    is_free = occupancy < float(_value(text, "free_thresh", path))
    rows, columns = np.flatnonzero(is_free.any(axis=1)), np.flatnonzero(is_free.any(axis=0))
    if not len(rows):
        raise InvalidInputError("floor plan", f"{path}: nothing in it is free")
    part = is_free[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1][::-1].T
    occupied = np.pad(~_resampled(part, round(side / cell)), 1, constant_values=True)
    start = (np.array(_middle(occupied)) + 0.5) * cell
    return PlanarWorld(Path(path).stem, "floor plans", occupied, cell, start)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InvalidInputError("floor plan", f"{path} cannot be read ({error})") from error


def _value(text: str, key: str, path: str | Path) -> str:
    found = re.search(rf"^{key}:\s*(\S+)", text, re.MULTILINE)
    if found is None:
        raise InvalidInputError("floor plan", f"{path}: no entry '{key}'")
    return found.group(1)


def _resampled(free: BoolArray, cells: int) -> BoolArray:
    """A grid with so many cells along the longer side; a cell is free where all its pixels are."""
    scale = max(free.shape) / cells
    shape = tuple(max(1, int(n / scale)) for n in free.shape)
    edges = [np.floor(np.arange(n + 1) * scale).astype(int) for n in shape]
    blocked = np.zeros((free.shape[0] + 1, free.shape[1] + 1))
    blocked[1:, 1:] = np.cumsum(np.cumsum(~free, axis=0), axis=1)
    low = [np.minimum(part[:-1], n - 1) for part, n in zip(edges, free.shape, strict=True)]
    high = [
        np.maximum(np.minimum(part[1:], n), first + 1)
        for part, n, first in zip(edges, free.shape, low, strict=True)
    ]
    at = np.ix_
    sums = blocked[at(high[0], high[1])] - blocked[at(low[0], high[1])]
    sums += blocked[at(low[0], low[1])] - blocked[at(high[0], low[1])]
    return np.asarray(sums == 0)


def _middle(occupied: BoolArray) -> tuple[int, int]:
    """The cell nearest to the middle in the largest free part, clear of walls where possible."""
    labels, count = ndimage.label(~occupied)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    largest = labels == sizes.argmax()
    gaps = ndimage.distance_transform_edt(largest)
    cells = np.argwhere(gaps >= min(_CLEAR, gaps.max()))
    offsets = np.linalg.norm(cells - 0.5 * np.array(occupied.shape), axis=1)
    i, j = cells[offsets.argmin()]
    return int(i), int(j)
