"""The nearest frontier.

B. Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997,
doi:10.1109/CIRA.1997.613851.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.baselines.frontiers import find_frontiers, turned_views
from infomap_ros.studies.baselines.proposals import places_of, scores_of, told_by
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_TURNS = 12
_NOTHING = 0.002  # a view that tells less shows nothing of a frontier [full views]


class NearestFrontier:
    """Goes to the frontier with the shortest way to its center, and looks where most is unknown.

    The paper's robot looks all around when it has arrived. A sensor with a narrower field of view
    looks at what tells most, and again as long as a frontier is left there.
    """

    requires_positive_utility = False

    def __init__(self) -> None:
        self._proposed = np.empty((0, 4, 4))

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """The centers of all frontiers, with directions all around."""
        found = find_frontiers(situation, surroundings)
        places = np.array([frontier.center for frontier in found]).reshape(-1, 3)
        self._proposed = turned_views(places, _TURNS)
        return self._proposed

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the way to the frontier [m]; of directions at one place, by information.

        Views that tell nothing, or were taken in vain, come last.
        """
        places = places_of(options, self._proposed)
        told = told_by(options, ratings, places)
        lengths = np.where(told > _NOTHING, options.path_lengths[places], np.inf)
        values = -np.where(np.isfinite(lengths), lengths, 1e6) + 1e-3 * told
        return Scores(scores_of(options, places, values, ratings.ratings))
