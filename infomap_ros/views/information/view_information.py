"""The information of candidate views as the choice asks for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.views.information.expected_information import METRICS, Metric, expected_information
from infomap_ros.views.information.field import VisibleField, workers_of
from infomap_ros.views.information.gains import field_around
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.voxel_gains import VoxelGains, view_gains
from infomap_ros.views.situation import Situation

_BITS = "expected_entropy_reduction"  # the metric that counts bits of the map


class ExpectedInformation:
    """Information by one of the metrics, an `InformationSource`."""

    def __init__(
        self,
        metric: str | Metric = "expected_entropy_reduction",
        config: InformationConfig | None = None,
        quick_ray_spacing: float = 0.05,
        threads: int = 2,
    ) -> None:
        """Choose what counts as information.

        Args:
            metric: the name of one of `METRICS`, or a function.
            config: rays and sensor.
            quick_ray_spacing: angle between the rays of the first ranking of all candidates [rad].
            threads: that share the rays.

        Raises:
            ConfigError: there is no such metric.
        """
        if isinstance(metric, str) and metric not in METRICS:
            raise ConfigError("metric", metric, "one of " + ", ".join(METRICS))
        self._metric, self._threads = metric, threads
        name = metric if isinstance(metric, str) else metric.__name__
        self.unit = "bits" if name == _BITS else f"of {name}"
        self._config = config or InformationConfig()
        spacing = max(quick_ray_spacing, self._config.ray_spacing)
        self._quick_config = replace(self._config, ray_spacing=spacing)
        self._full_views: dict[tuple[VoxelMapConfig, PinholeCamera, float, bool], float] = {}

    @property
    def config(self) -> InformationConfig:
        """Rays and sensor."""
        return self._config

    def quick(
        self, situation: Situation, positions: FloatArray, rotations: FloatArray
    ) -> FloatArray:
        """Of all orientations (P, O, 3, 3) at positions (P, 3), with few rays: (P, O)."""
        poses = np.tile(np.eye(4), (*rotations.shape[:2], 1, 1))
        poses[..., :3, :3] = rotations
        poses[..., :3, 3] = positions[:, None]
        values = self._evaluate(situation, poses.reshape(-1, 4, 4), self._quick_config)
        return values.reshape(rotations.shape[:2])

    def exact(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """Of views ``T_map_camera``, shape (M, 4, 4): (M,)."""
        return self._evaluate(situation, poses, self._config)

    def full_view(self, situation: Situation) -> float:
        """Of a view into nothing but unknown space.

        By the same metric, so that shares of it do not depend on the metric's unit. 0 for metrics
        that unknown space tells nothing.
        """
        settings, planar = situation.voxel_map.config, situation.is_planar
        key = (settings, situation.camera, situation.max_range, planar)
        if key not in self._full_views:
            nothing = VoxelMap(situation.voxel_map.config)
            value = expected_information(
                nothing,
                np.eye(4)[None],
                situation.camera,
                situation.max_range,
                self._metric,
                _fitting(self._config, situation),
            )
            self._full_views[key] = float(value[0])
        return self._full_views[key]

    def gains(self, situation: Situation, poses: FloatArray) -> list[VoxelGains]:
        """Voxels that each view, (M, 4, 4), informs, by the expected reduction of entropy."""
        found: dict[int, VoxelGains] = {}
        if len(poses) == 0:
            return []
        config, field = _fitting(self._config, situation), self._field_about(situation, poses)

        def gather(_: int, first: int, last: int) -> None:
            for index in range(first, last):
                found[index] = view_gains(
                    situation.promising_map,
                    poses[index],
                    situation.camera,
                    situation.max_range,
                    config,
                    self._region(situation),
                    field,
                )

        workers_of(self._threads).run(gather, len(poses))
        return [found[index] for index in range(len(poses))]

    def _evaluate(
        self, situation: Situation, poses: FloatArray, config: InformationConfig
    ) -> FloatArray:
        return expected_information(
            situation.promising_map,
            poses,
            situation.camera,
            situation.max_range,
            self._metric,
            _fitting(config, situation),
            self._region(situation),
            self._threads,
        )

    def _field_about(self, situation: Situation, poses: FloatArray) -> VisibleField:
        """What of the map can be seen from views, (M, 4, 4)."""
        config = _fitting(self._config, situation)
        return field_around(situation.promising_map, poses[:, :3, 3], situation.max_range, config)

    @staticmethod
    def _region(situation: Situation) -> FloatArray:
        """Box of the voxels that count, shape (2, 3) [m, map]."""
        return np.stack([situation.region.low, situation.region.high])


def _fitting(config: InformationConfig, situation: Situation) -> InformationConfig:
    """The configuration for a task in a plane or in space."""
    return replace(config, planar=True) if situation.is_planar else config
