"""How views are chosen in the planar studies: lengths in units of the sensor's range."""

from __future__ import annotations

from infomap_ros.views.next_best_view import NextBestViewConfig
from infomap_ros.views.ranking.look_ahead import LookAheadConfig
from infomap_ros.views.ranking.rating import RatingConfig
from infomap_ros.views.sampling.candidates import CandidateConfig
from infomap_ros.views.sampling.orientations import OrientationConfig
from infomap_ros.views.sampling.surroundings import SurroundingsConfig
from infomap_ros.views.selection import SelectionConfig

_RATING_ALONE, _DISCOUNTED = 0.4, 0.1  # what a way of one range costs [full views]
_REFINED = 80  # views whose information is evaluated exactly


def planar_choice(
    max_range: float, cell: float, candidates: int = 400, strategy: str = ""
) -> NextBestViewConfig:
    """The choice for a sensor of this range [m] in a world with cells of this edge [m].

    The sensor has no body, no noise and knows its pose, so that neither room, margins nor the
    localization error count. All of the world is searched at once.

    Args:
        max_range: see above.
        cell: see above.
        candidates: number of candidate views.
        strategy: by which is chosen. One that ranks by the rating alone needs a higher cost of
            the way than those that discount what comes late.
    """
    cost_of_range = _RATING_ALONE if strategy == "largest_information" else _DISCOUNTED
    return NextBestViewConfig(
        surroundings=SurroundingsConfig(
            surface_margin=0, camera_radius=0.0, start_radius=cell, horizon=1000.0, cell=cell
        ),
        candidates=CandidateConfig(
            candidates=candidates,
            local_radius=max_range,
            periphery_share=0.4,
            teammate_clearance=0.2 * max_range,
        ),
        orientations=OrientationConfig(
            directed=3, spread=1, lowest_elevation=0.0, highest_elevation=0.0
        ),
        rating=RatingConfig(
            distance_weight=cost_of_range / max_range,
            localization_weight=0.0,
            teammate_sigma=0.1 * max_range,
        ),
        selection=SelectionConfig(min_rating=-1e6, refined=_REFINED),
        look_ahead=LookAheadConfig(
            depth=8,
            views=_REFINED,
            beam=8,
            discount_distance=max_range,
            cost_of_view=max_range / 30.0,
            unlike_distance=0.15 * max_range,
        ),
    )
