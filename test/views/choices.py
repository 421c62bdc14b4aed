"""Views to choose from, with information that a test prescribes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infomap_ros.views.information.view_information import VoxelGains
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.sampling.surroundings import survey
from infomap_ros.views.situation import Situation


class Prescribed:
    """An information source with given values and given voxels per view, by camera position x."""

    unit, config = "bits", InformationConfig()

    def __init__(self, gains: dict[float, dict[int, float]] | None = None, full: float = 100.0):
        self._gains, self._full = gains or {}, full

    def quick(
        self, situation: Situation, positions: np.ndarray, rotations: np.ndarray
    ) -> np.ndarray:
        return np.array([[self._total(place)] * rotations.shape[1] for place in positions])

    def exact(self, situation: Situation, poses: np.ndarray) -> np.ndarray:
        return np.array([self._total(pose[:3, 3]) for pose in poses])

    def full_view(self, situation: Situation) -> float:
        return self._full

    def gains(self, situation: Situation, poses: np.ndarray) -> list[VoxelGains]:
        return [self._of(pose[:3, 3]) for pose in poses]

    def _of(self, place: np.ndarray) -> VoxelGains:
        gains = self._gains.get(round(float(place[0]), 3), {})
        keys = sorted(gains)
        return VoxelGains(np.array(keys, np.int64), np.array([gains[key] for key in keys]))

    def _total(self, place: np.ndarray) -> float:
        return self._of(place).total


def options_of(
    situation: Situation,
    poses: Sequence[np.ndarray],
    information: Sequence[float],
    full: float = 100.0,
    fine: bool = True,
    source: Prescribed | None = None,
    previous: int | None = None,
) -> Options:
    """Options with given information."""
    return Options(
        situation,
        survey(situation),
        np.array(poses).reshape(-1, 4, 4),
        np.array(information, dtype=float),
        full,
        source or Prescribed(full=full),
        np.random.default_rng(0),
        previous,
        fine,
    )
