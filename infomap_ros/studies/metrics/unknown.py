"""What the metrics say of a view that is wholly unknown, partly known, or wholly known.

A planar sensor stands in an empty world. All that lies nearer than some distance is mapped as free;
the rest of the view is unknown. A metric that tells what is new is 0 where nothing is unknown and
grows with the unknown.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.planar.sensor import SensorConfig, level_pose, take_scan
from infomap_ros.studies.planar.world import PlanarWorld
from infomap_ros.views.information.expected_information import METRICS, expected_information
from infomap_ros.views.information.information_config import InformationConfig

_SIDE = 44  # of the empty world [m]
_MIDDLE = 0.5 * _SIDE + 0.5  # the middle of a cell


def unknown_shares(levels: int = 41) -> FloatArray:
    """Shares of the view that are unknown, from 0 to 1, shape (levels,)."""
    return np.linspace(0.0, 1.0, levels)


def values_by_share(
    shares: FloatArray, sensor: SensorConfig | None = None
) -> dict[str, FloatArray]:
    """What each metric says of a view of which these shares are unknown.

    Args:
        shares: in [0, 1], shape (N,).
        sensor: of the view; that of the planar studies by default.

    Returns:
        Values by metric, shape (N,) each, in the metric's unit.
    """
    settings = sensor or SensorConfig()
    pose = level_pose(np.full(2, _MIDDLE), 0.0, 1.0)
    config = InformationConfig(min_range=0.0, range_noise=0.0, pixel_angle=1e-4, planar=True)
    region = np.array([[0.0, 0.0, 0.0], [_SIDE, _SIDE, 1.0]])
    maps = [_mapped_up_to(settings, settings.max_range * float(np.sqrt(1.0 - s))) for s in shares]

    def value(metric: str, known: VoxelMap) -> float:
        view = settings.camera, settings.max_range
        return float(expected_information(known, pose[None], *view, metric, config, region)[0])

    return {metric: np.array([value(metric, known) for known in maps]) for metric in METRICS}


def _mapped_up_to(sensor: SensorConfig, distance: float) -> VoxelMap:
    """A map in which all of the view that is nearer than a distance [m] is free."""
    if distance <= 0.0:
        return VoxelMap(sensor.map_config(1.0))
    near, world = replace(sensor, max_range=max(distance, 0.1)), _empty()
    voxel_map = VoxelMap(near.map_config(1.0))
    take_scan(world.truth, near, level_pose(world.start, 0.0, 1.0), voxel_map)
    return voxel_map


def _empty() -> PlanarWorld:
    """A square without obstacles; the sensor stands in its middle."""
    occupied = np.pad(np.zeros((_SIDE - 2, _SIDE - 2), np.bool_), 1, constant_values=True)
    return PlanarWorld("empty", "empty", occupied, 1.0, np.full(2, _MIDDLE))
