"""What a strategy is: something that ranks views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation


@dataclass(frozen=True, eq=False)
class Scores:
    """How a strategy ranks views.

    Attributes:
        values: the larger the better, shape (M,); only compared with each other.
        plans: by view, which views it is meant to be followed by, in that order.
    """

    values: FloatArray
    plans: Mapping[int, tuple[int, ...]] = field(default_factory=dict)


class Strategy(Protocol):
    """Ranks views.

    Attributes:
        requires_positive_utility: whether a view must be worth its cost by the rating to be chosen.
    """

    @property
    def requires_positive_utility(self) -> bool: ...  # noqa: D102

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Rank the views.

        Asked twice: for all views, with information good enough for a first ranking, and for the
        best of these that the robot may reach, with ``options.fine`` set; the second answer counts.
        """


@runtime_checkable
class ProposesViews(Protocol):
    """What a strategy may have besides: views of its own to choose from."""

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """Further candidates ``T_map_camera``, shape (E, 4, 4); tested and rated like all others.

        Asked before each choice. A view that passes the tests is found among the options by its
        unchanged pose.
        """
