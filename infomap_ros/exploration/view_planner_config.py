"""How the next view is chosen: the parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.motion.whole_body import ReachingConfig
from infomap_ros.views.next_best_view import NextBestViewConfig


@dataclass(frozen=True)
class ViewPlannerConfig:
    """How the next view is chosen.

    Raises:
        ConfigError: a value is out of its range.
    """

    strategy: str = parameter(
        "largest_information",
        "How views are ranked: random, raster, largest_unknown, smallest_known, "
        "largest_information, look_ahead, or the dotted path of a class of one's own.",
    )
    metric: str = parameter(
        "expected_entropy_reduction", "What counts as information, by the name of a metric."
    )
    predict_unknown: bool = parameter(
        False,
        "Whether unknown voxels near known ones have the average probability of their neighbors "
        "(the Markov chain of sec. 2.4 of the paper) instead of 0.5 when views are rated.",
    )
    max_range: float = parameter(
        4.0, "How far the camera measures well enough to map.", unit="m", low=0.1, high=1000.0
    )
    arm_views: int = setting(
        250, "Candidates that are drawn among the postures of the arm.", low=0, high=100_000
    )
    start_clearance: float = parameter(
        0.9,
        "Radius about the base's first place in which space that was never seen is taken for free, "
        "and unseen ground for even, so that it can move at all: have nothing stand there.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    rounds: int = setting(
        4,
        "When none of the views that were tried can be reached, others are drawn; so many times at "
        "most.",
        low=1,
        high=100,
    )
    thorough: float = setting(
        0.3,
        "Where no view is worth its cost and the task is not met yet, views are sought that close "
        "holes of the mapped surface, and then all others again: the distance and the localization "
        "error on it count by this share only, and so does the least information of the former. 1 "
        "gives up at once.",
        low=0.0,
        high=1.0,
    )
    threads: int = parameter(2, "Threads that evaluate views.", low=1, high=64)
    seed: int = parameter(1, "Seed of the candidates.", low=0)
    choice: NextBestViewConfig = field(default_factory=NextBestViewConfig)
    reaching: ReachingConfig = field(default_factory=ReachingConfig)

    def __post_init__(self) -> None:
        check_config(self)
