"""What the planar studies have in common: drawn worlds, voxels, candidates, sensor."""

from __future__ import annotations

from dataclasses import dataclass, field

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.studies.planar.sensor import SensorConfig
from infomap_ros.studies.planar.tasks import WorldName


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
