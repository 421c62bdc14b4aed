"""Ways to choose the next view, by name; all are asked in the same loop.

The five of Sujan and Dubowsky (2005, section on results): random, raster, largest_unknown,
smallest_known, largest_information; and look_ahead, which searches sequences of a few views.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.ranking.look_ahead import LookAhead, LookAheadConfig
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores, Strategy
from infomap_ros.views.sampling.coarse_views import full_volume


class LargestInformation:
    """The view with the largest rating of eq. (11)."""

    requires_positive_utility = True

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """The ratings themselves."""
        return Scores(ratings.ratings)


class RandomChoice:
    """Any view. A previous goal is kept, or the robot would never arrive."""

    requires_positive_utility = False

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Random numbers, the largest for the previous goal."""
        values = options.rng.random(len(options))
        if options.previous is not None:
            values[options.previous] = 1.0
        return Scores(values)


class LargestUnknown:
    """The view with the largest unknown volume in sight, up to where known obstacles hide it."""

    requires_positive_utility = False

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Unknown volumes [m^3]."""
        return Scores(options.coarse_views.unknown)


class SmallestKnown:
    """The view that maps the smallest previously mapped region, "frontier" in the paper.

    A view into a near wall, or out of the task's region, would map the smallest region of all.
    So views are compared by the unknown share of what is in sight, where a tenth of the field of
    view counts as known besides.
    """

    requires_positive_utility = False

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Unknown share of the volume in sight."""
        coarse_views = options.coarse_views
        seen = coarse_views.known + coarse_views.unknown + 0.1 * full_volume(options.situation)
        return Scores(coarse_views.unknown / seen)


class Raster:
    """The next place in a sequence of rows from which no view was taken yet.

    Places are the cells of a grid, headings the sectors of a turn by fields of view. Of the cells
    and headings that have candidates and no view, the first is taken: row by row, each row against
    the direction of the one before.
    """

    requires_positive_utility = False

    def __init__(self, spacing: float = 0.4) -> None:
        """Edge of a cell as a share of the camera's range."""
        self._spacing = spacing

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the place in the sequence; a place already taken comes after all others."""
        order = self._order(options, options.poses)
        taken = self._order(options, options.situation.past_views)
        behind = np.isin(order, taken) * (order.max(initial=0.0) + 1.0)
        return Scores(-(order + behind))

    def _order(self, options: Options, poses: FloatArray) -> FloatArray:
        """Place of poses in the sequence, shape (M, 4, 4) -> (M,), a whole number."""
        situation = options.situation
        cell = self._spacing * situation.max_range
        sectors = max(1, math.ceil(2.0 * math.pi / situation.camera.field_of_view[0]))
        columns, rows = np.floor(poses[:, :2, 3] / cell).T
        first, width = self._extent(options, cell)
        along, across = columns - first[0], rows - first[1]
        along = np.where(across % 2 == 0, along, width - 1 - along)
        azimuth = np.arctan2(poses[:, 1, 2], poses[:, 0, 2]) / (2.0 * math.pi) + 0.5
        sector = np.minimum(np.floor(azimuth * sectors), sectors - 1)
        return np.asarray((across * width + along) * sectors + sector)

    def _extent(self, options: Options, cell: float) -> tuple[FloatArray, float]:
        """First cell of the grid and its width in cells: the region, or what is known of it."""
        region, size = options.situation.region, options.surroundings.voxel_size
        bounds = options.situation.voxel_map.bounds()
        known = (np.zeros(3), np.zeros(3)) if bounds is None else bounds
        low = np.where(np.isfinite(region.low), region.low, known[0] * size)
        high = np.where(np.isfinite(region.high), region.high, (known[1] + 1) * size)
        margin = options.situation.max_range
        first = np.floor((low[:2] - margin) / cell)
        return first, float(np.floor((high[0] + margin) / cell) - first[0] + 1.0)


def strategies(look_ahead: LookAheadConfig | None = None) -> dict[str, Callable[[], Strategy]]:
    """The strategies that come with the package, by name."""
    return {
        "random": RandomChoice,
        "raster": Raster,
        "largest_unknown": LargestUnknown,
        "smallest_known": SmallestKnown,
        "largest_information": LargestInformation,
        "look_ahead": lambda: LookAhead(look_ahead),
    }


def make_strategy(name: str, look_ahead: LookAheadConfig | None = None) -> Strategy:
    """Create a strategy.

    Args:
        name: of one that comes with the package, or the dotted path of a class, as in
            ``my_package.my_module.MyStrategy``, which is created without arguments.
        look_ahead: configuration of the strategy of that name.

    Raises:
        ConfigError: there is no such strategy, the class cannot be imported or created, or it
            lacks what `Strategy` asks for.
    """
    known = strategies(look_ahead)
    if name in known:
        return known[name]()
    module_name, _, class_name = name.rpartition(".")
    if not module_name:
        choices = ", ".join(known)
        raise ConfigError("strategy", name, f"one of {choices}, or the dotted path of a class")
    try:
        found = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise ConfigError("strategy", name, f"a class that can be imported ({error})") from error
    try:
        strategy = found()
    except TypeError as error:
        raise ConfigError("strategy", name, f"a class without arguments ({error})") from error
    if not callable(getattr(strategy, "score", None)) or not hasattr(
        strategy, "requires_positive_utility"
    ):
        raise ConfigError("strategy", name, "a class with 'score' and 'requires_positive_utility'")
    checked: Strategy = strategy
    return checked
