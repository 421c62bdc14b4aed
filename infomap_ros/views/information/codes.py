"""What the codes of voxels mean to a view.

A code says how likely its voxel is occupied, whether it is known, and, where the precision of
surfaces counts, how uncertain the surface in it is. Codes fit in a byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM

EMPTY, UNKNOWN, SOLID, UNCERTAIN = 0, 1, 2, 3
"""Codes of voxels; the first of the uncertain ones, which follow each other by evidence."""

_CODES = 256
_MOST_UNCERTAIN = 62  # so that uncertain and predicted codes fit
_LEAST_LEVELS, _LEVEL_SPAN = 4, 64.0


@dataclass(frozen=True)
class CodeBook:
    """Codes for a choice of what is certain.

    After the codes of uncertain voxels come those of unknown voxels with a predicted probability,
    in the same order, and where `wanted_sigma` is positive those of surfaces that are less precise:
    by evidence (the last for a solid voxel), and for each by level of standard deviation.

    Attributes:
        certain_probability: known voxels less likely occupied are EMPTY, less likely empty SOLID.
        wanted_sigma: standard deviation of a surface along its normal that suffices [m]; 0 where
            the precision of surfaces does not count.

    Raises:
        ConfigError: the codes do not fit in a byte.
    """

    certain_probability: float
    wanted_sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.wanted_sigma > 0.0 and self._levels() < _LEAST_LEVELS:
            raise ConfigError(
                "certain_probability", self.certain_probability, "at least 0.001 with wanted_sigma"
            )

    @property
    def limit(self) -> int:
        """Largest evidence, for or against, of a voxel that is not certain [quanta]."""
        certain = math.log(1.0 / self.certain_probability - 1.0) / LOG_ODDS_QUANTUM
        return min(math.ceil(certain - 1e-9) - 1, _MOST_UNCERTAIN)

    @property
    def predicted(self) -> int:
        """First code of unknown voxels with a predicted probability."""
        return UNCERTAIN + 2 * self.limit + 1

    @property
    def surface(self) -> int:
        """First code of surfaces that are not precise enough."""
        return self.predicted + 2 * self.limit + 1

    @property
    def sigma_levels(self) -> FloatArray:
        """Standard deviations that codes of surfaces tell apart, ascending, shape (S,) [m]."""
        if self.wanted_sigma == 0.0:
            return np.zeros(0)
        share = (np.arange(self._levels()) + 1.0) / self._levels()
        return np.asarray(self.wanted_sigma * _LEVEL_SPAN**share)

    def probabilities(self) -> FloatArray:
        """Probability of occupancy of each code, shape (n,)."""
        evidence = np.arange(-self.limit, self.limit + 1) * LOG_ODDS_QUANTUM
        uncertain = 1.0 / (1.0 + np.exp(-evidence))
        surfaces = np.repeat([*uncertain[self.limit + 1 :], 1.0], len(self.sigma_levels))
        return np.concatenate([[0.0, 0.5, 1.0], uncertain, uncertain, surfaces])

    def known(self) -> NDArray[np.bool_]:
        """Which codes are those of known voxels, shape (n,)."""
        codes = np.arange(len(self.probabilities()))
        return (codes != UNKNOWN) & ((codes < self.predicted) | (codes >= self.surface))

    def sigmas(self) -> FloatArray:
        """Standard deviation of each code's surface, shape (n,) [m]; 0 where it does not count."""
        levels = np.tile(self.sigma_levels, self.limit + 1)
        return np.concatenate([np.zeros(self.surface), levels])

    def _levels(self) -> int:
        return (_CODES - self.surface) // (self.limit + 1)
