"""What the planar studies have in common: drawn worlds, voxels, candidates, sensor.

Figures of an exploration: what is mapped over the way, and what one saves against another.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.planar.tasks import WorldName
from infomap_ros.studies.planar.world import SensorConfig


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
    """Studies of one sensor, whose coverage is looked at by scans and by the way.

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
    """Share of the way that one exploration saves against another, to the same fraction mapped.

    Attributes:
        share: 1 - way / other way; negative where the other one moved less.
        kind: "exact"; "at least", where the other never got so far, so that its whole way counts
            and the true one is longer; "at most", where the own never did; "unknown" (and NaN)
            where neither did, or the other one ended before it had moved as far as the own.
    """

    share: float
    kind: str


def saving(own: tuple[float, float], other: tuple[float, float]) -> Saving:
    """Compare ways to a fraction mapped, of which either may be censored.

    Args:
        own: way to the fraction, inf if it was not reached, and way until the end [m].
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
