"""The explorations of a study: many, over the cores, each kept in a file as soon as it is done."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.planar.explore import (
    Exploration,
    ExplorationConfig,
    explore,
    explore_together,
    planar_choice,
)
from infomap_ros.studies.planar.world import BoolArray, PlanarWorld, SensorConfig, make_world
from infomap_ros.studies.runs import Kept, run_all


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
    """One exploration: implements `infomap_ros.studies.runs.Task`.

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


@dataclass(frozen=True)
class DrawnWorldsConfig:
    """Worlds drawn from seeds, and how they are seen.

    Raises:
        ConfigError: a value is out of its range.
    """

    kinds: tuple[str, ...] = parameter(("clutter", "rooms", "caves"), "Kinds of drawn worlds.")
    worlds: int = parameter(
        10, "Drawn worlds of each kind; 0: the paper's alone.", low=0, high=1000
    )
    seed: int = parameter(0, "Of the first world of each kind.", low=0)
    cell: float = parameter(
        1.0, "Edge of a cell of the worlds and of a voxel of the maps.", unit="m", low=0.1, high=5.0
    )
    candidates: int = parameter(400, "Candidate views of each choice.", low=10, high=100_000)
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        check_config(self)

    def drawn(self, number: int) -> list[WorldName]:
        """One world of each kind: the first for number 0."""
        return [WorldName(kind, self.seed + number, cell=self.cell) for kind in self.kinds]


@dataclass(frozen=True)
class OneSensorConfig(DrawnWorldsConfig):
    """Studies of one sensor, whose coverage is looked at by scans and by the distance.

    Raises:
        ConfigError: a value is out of its range.
    """

    scans: int = parameter(100, "Scans of the figures.", low=2, high=10_000)
    reach: float = parameter(
        1000.0, "Coverage is averaged over this distance.", unit="m", low=1.0, high=1e6
    )


def fraction_at(distance: FloatArray, fraction: FloatArray, at: FloatArray) -> FloatArray:
    """Fraction mapped when the sensor has moved so far: that of the last scan before.

    Args:
        distance: moved until each scan, ascending, shape (K,) [m].
        fraction: mapped after each scan, shape (K,).
        at: distances, shape (N,) [m]; beyond the last scan its fraction stays.

    Returns:
        Shape (N,).
    """
    last = np.searchsorted(distance, at, side="right") - 1
    return np.asarray(np.where(last >= 0, fraction[np.maximum(last, 0)], 0.0))


def area_under_coverage(distance: FloatArray, fraction: FloatArray, reach: float) -> float:
    """Mean fraction mapped over the first `reach` meters, in [0, 1]; see `fraction_at`."""
    edges = np.concatenate([distance[distance < reach], [reach]])
    steps = np.diff(edges)
    return float(fraction[: len(steps)] @ steps / reach)


def distance_to(distance: FloatArray, fraction: FloatArray, share: float) -> float:
    """Distance moved when that share was first mapped [m]; inf if it never was."""
    reached = np.flatnonzero(fraction >= share)
    return float(distance[reached[0]]) if len(reached) else float("inf")


@dataclass(frozen=True)
class Saving:
    """Share of distance that one exploration saves against another, to the same fraction mapped.

    Attributes:
        share: 1 - distance / other distance; negative where the other one moved less.
        kind: "exact"; "at least", where the other never got so far, so that all its distance counts
            and the true one is longer; "at most", where the own never did; "unknown" (and NaN)
            where neither did, or the other one ended before it had moved as far as the own.
    """

    share: float
    kind: str


def saving(own: tuple[float, float], other: tuple[float, float]) -> Saving:
    """Compare distances to a fraction mapped, of which either may be censored.

    Args:
        own: distance to the fraction, inf if it was not reached, and distance until the end [m].
        other: the same of the other exploration.

    Returns:
        What is saved. Not to arrive never counts in one's favor: "at most" is at most 0.
    """
    arrived, came = np.isfinite(own[0]), np.isfinite(other[0])
    if arrived and came:
        return Saving(1.0 - own[0] / max(other[0], 1e-9), "exact")
    if arrived and other[1] >= own[0]:
        return Saving(1.0 - own[0] / max(other[1], 1e-9), "at least")
    if came:
        return Saving(min(1.0 - own[1] / max(other[0], 1e-9), 0.0), "at most")
    return Saving(float("nan"), "unknown")
