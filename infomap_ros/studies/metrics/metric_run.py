"""One exploration of a planar world whose views are chosen by one metric."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.metrics.published_metrics import EVERY_METRIC
from infomap_ros.studies.planar.explore import ExplorationConfig, explore
from infomap_ros.studies.planar.sensor import SensorConfig, level_pose, take_scan
from infomap_ros.studies.planar.settings import planar_choice
from infomap_ros.studies.planar.tasks import WorldName
from infomap_ros.studies.planar.world import PlanarWorld
from infomap_ros.views.information.observation_value import entropy_of

STRATEGY = "largest_information"
"""By which all metrics are compared: it ranks by the rating of eq. (11) alone."""


@dataclass(frozen=True, eq=False)
class MetricRun:
    """What became of an exploration; entry k is that after scan k, shape (K,) each.

    Attributes:
        fraction: share of the mappable cells that are mapped, in [0, 1].
        distance: moved until then [m].
        seconds: that the choice of the view took, time of the processor [s].
        bits: by which the entropy of the mappable cells has fallen [bits].
        wrong: share of the mapped cells that are on the wrong side of p = 1/2, in [0, 1].
        views: place [m] and azimuth [rad] of each scan, shape (K, 3).
        ended: why it ended.
    """

    fraction: FloatArray
    distance: FloatArray
    seconds: FloatArray
    bits: FloatArray
    wrong: FloatArray
    views: FloatArray
    ended: str


@dataclass(frozen=True)
class MetricTask:
    """One exploration: implements `infomap_ros.studies.common.runs.Task`.

    Attributes:
        world: to be explored.
        metric: name of one of `EVERY_METRIC`.
        config: sensor, number of scans, seed.
        candidates: number of candidate views.
    """

    world: WorldName
    metric: str
    config: ExplorationConfig
    candidates: int

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{self.world}__{self.metric}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def run(self) -> MetricRun:
        """Explore, then measure what the same scans have told."""
        world, sensor = self.world.make(), self.config.sensor
        choice = planar_choice(sensor.max_range, world.cell, self.candidates, STRATEGY)
        metric = EVERY_METRIC.get(self.metric, self.metric)
        found = explore(world, STRATEGY, self.config, choice, metric=metric)
        bits, wrong = what_scans_tell(world, sensor, found.views)
        return MetricRun(
            found.fraction, found.distance, found.seconds, bits, wrong, found.views, found.ended
        )


def what_scans_tell(
    world: PlanarWorld, sensor: SensorConfig, views: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bits removed and share of wrong cells after each scan, shape (K,) each; see `MetricRun`.

    Args:
        world: that is measured.
        sensor: that measures.
        views: place [m] and azimuth [rad] of each scan, shape (K, 3).
    """
    voxel_map = VoxelMap(sensor.map_config(world.cell))
    cells = np.argwhere(world.mappable)
    places = np.column_stack([cells + 0.5, np.full(len(cells), 0.5)]) * world.cell
    is_solid = world.occupied[world.mappable]
    rows = []
    for x, y, azimuth in views:
        take_scan(world.truth, sensor, level_pose(np.array([x, y]), azimuth, world.cell), voxel_map)
        p, known = voxel_map.probability(places), voxel_map.is_known(places)
        left = np.where(known, entropy_of(p), 1.0)
        wrong = (p[known] > 0.5) != is_solid[known]
        rows.append((len(left) - float(left.sum()), float(wrong.mean()) if len(wrong) else 0.0))
    bits, shares = np.array(rows).T
    return bits, shares
