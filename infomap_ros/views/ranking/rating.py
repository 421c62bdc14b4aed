"""The rating of candidate views, eqs. (10) and (11) of Sujan and Dubowsky 2005."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.decision import ReachResult
from infomap_ros.views.information.gains import voxel_observation
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.terms import (
    Distance,
    Duration,
    Information,
    InterestTerm,
    LocalizationError,
    LocalizationErrorTerm,
    RatingTerm,
    Repetition,
    Risk,
    TeammatesTerm,
)
from infomap_ros.views.situation import MotionTimes, Situation

_COUNTED = 4  # the first terms say what of the information counts


@dataclass(frozen=True)
class RatingConfig:
    """Weights of the rating.

    Ratings count in full views: 1 is what the camera would be told by a view into nothing but
    unknown space. Bits per voxel grow with the third power of the resolution and with the field of
    view; measured against a full view they do neither, so weights keep their meaning.

    Raises:
        ConfigError: a value is out of its range.
    """

    information_weight: float = parameter(
        1.0, "w_NI of eq. (11), also for what interests add and others take.", low=0.0, high=1e6
    )
    distance_weight: float = parameter(
        0.01,
        "w_d of eq. (11): so many full views must a unit of distance bring to be worth while.",
        low=0.0,
        high=1e6,
    )
    cost: str = parameter(
        "distance",
        "Unit in which getting to a view costs: distance of eq. (10), or seconds of driving, "
        "turning, moving the arm and looking.",
        choices=("distance", "seconds"),
    )
    time_weight: float = parameter(
        0.0025,
        "Instead of distance_weight where the cost is in seconds: so many full views must a second "
        "bring. The default is distance_weight at 0.25 m/s.",
        unit="1/s",
        low=0.0,
        high=1e6,
    )
    localization_weight: float = parameter(
        1.0,
        "w_LE of eq. (11), on the information that a scan loses by the growth of the pose's sigma.",
        low=0.0,
        high=1e6,
    )
    repetition_weight: float = setting(
        1.0,
        "Weight of what like views promised and did not bring, against w_NI.",
        low=0.0,
        high=1e6,
    )
    teammate_sigma: float = setting(
        0.5,
        "Width of the Gaussian by which the risk falls off around a teammate.",
        unit="m",
        low=0.01,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Ratings:
    """Ratings of views.

    Attributes:
        terms: value of each term by name, in its own unit, shape (M,) each.
        ratings: RF of eq. (11), shape (M,) [full views].
        shares: what counts of the information, by interests, teammates and repetition, shape (M,)
            [full views].
        config: the weights.
        cost: what getting from view to view costs.
    """

    terms: dict[str, FloatArray]
    ratings: FloatArray
    shares: FloatArray
    config: RatingConfig
    cost: Cost

    @property
    def distances(self) -> FloatArray:
        """What it costs to get to each view, as a distance, shape (M,)."""
        return self.terms[self.cost.term.name] * self.cost.distance_per_unit


@dataclass(frozen=True)
class Cost:
    """What it costs to get to a view, d of eq. (10), in the unit that was asked for.

    Strategies discount what comes late by distance, and therefore count in distances: a second is
    the distance that the base drives in it.

    Attributes:
        term: tells it.
        weight: w_d of eq. (11) [full views per unit of the term].
        distance_per_unit: distance that a unit of the term counts as.
        includes_look: whether the term counts the look itself.
    """

    term: Distance | Duration
    weight: float
    distance_per_unit: float
    includes_look: bool

    @classmethod
    def of(cls, config: RatingConfig, times: MotionTimes) -> Cost:
        """The cost by a configuration, for a robot with these speeds."""
        if config.cost == "seconds":
            return cls(Duration(times), config.time_weight, times.speed, True)
        distance = Distance()
        return cls(distance, config.distance_weight, 1.0, False)

    @property
    def weight_of_distance(self) -> float:
        """The weight of a unit of distance [full views]."""
        return self.weight / self.distance_per_unit

    def between(self, start: FloatArray, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Cost from one pose, (4, 4), to others, (M, 4, 4), as distances, shape (M,).

        Args:
            start: where the camera is.
            poses: views.
            lengths: of the paths, shape (M,) [m].
        """
        return self.term.between(start, poses, lengths) * self.distance_per_unit

    def surcharge(self, planned: ReachResult, assumed: float, length: float) -> float:
        """What a planned motion costs beyond what the rating has assumed [full views].

        Args:
            planned: the motion.
            assumed: value of the term.
            length: of the path of the camera, as the term took it [m].
        """
        if isinstance(self.term, Distance):
            excess = planned.travel - length
            return self.weight * self.term.mean_weight * excess if 0.0 < excess < np.inf else 0.0
        excess = planned.seconds - assumed
        return self.weight * excess if np.isfinite(excess) else 0.0


class Rating:
    """Rates views by eq. (11), with more terms than its three where these are asked for.

    ``RF = (sum_k w_k t_k) (1 - P)``. LE counts by the information that it costs
    (`infomap_ros.views.ranking.rating`). The printed product would rate a risky view
    higher than a safe one wherever costs exceed gains; there the sum is multiplied by ``1 + P``
    instead.
    """

    def __init__(
        self,
        config: RatingConfig | None = None,
        camera_radius: float = 0.1,
        localization_error: LocalizationError | None = None,
        more_terms: Sequence[tuple[RatingTerm, float]] = (),
    ) -> None:
        """Set the terms up.

        Args:
            config: weights.
            camera_radius: of the ball that is looked at for risk [m].
            localization_error: model of LE; odometry drift where not given.
            more_terms: further terms with their weights: full views per unit of the term, or, for
                a term in bits, a factor like `information_weight`; negative for costs.
        """
        self.config = config or RatingConfig()
        settings, weight = self.config, self.config.information_weight
        self._terms: list[tuple[RatingTerm, float]] = [
            (Information(), weight),
            (InterestTerm(), weight),
            (TeammatesTerm(), weight),
            (Repetition(), weight * settings.repetition_weight),
            *more_terms,
        ]
        self._localization_error = LocalizationErrorTerm(localization_error)
        self._risk = Risk(camera_radius, self.config.teammate_sigma)

    def rate(self, options: Options) -> Ratings:
        """Rate views."""
        cost = Cost.of(self.config, options.situation.times)
        gains, more = self._terms[:_COUNTED], self._terms[_COUNTED:]
        terms = [*gains, (cost.term, -cost.weight), *more]
        values = {term.name: term(options) for term, _ in terms}
        total = np.zeros(len(options))
        for term, weight in terms:
            unit = options.full_view if term.unit == "bits" else 1.0
            total += weight * values[term.name] / unit
        errors = values[self._localization_error.name] = self._localization_error(options)
        if self.config.localization_weight > 0.0:
            loss = pose_information_loss(options.situation, options.source.config, errors)
            total -= self.config.localization_weight * loss
        risk = self._risk(options)
        values[self._risk.name] = risk
        shares = np.zeros(len(options))
        for term, weight in gains:
            share = weight / max(self.config.information_weight, 1e-12)
            shares += share * values[term.name] / options.full_view
        return Ratings(values, total - risk * np.abs(total), shares, self.config, cost)


# A scan is merged with the pose error that all its points share, once. A surface voxel gets from
# it the variance r^2 + s^2 along its normal instead of r^2, where r is the sigma of the range in
# a voxel (`observation_value.voxel_observation`) and s the pose's sigma along the normal. So the
# scan tells
#
#     b(s) = 0.5 log2((r^2 + s^2) / r^2)
#
# bits less about where the surface is, and a path on which s grows from s0 to s1 costs b(s1) -
# b(s0) bits in each surface voxel that the view sees. A surface that fills the image, faces the
# camera and is L away has n = Omega L^2 / v^2 voxels of size v, with the image's solid angle
# Omega. For L stands half the camera's range. Over the bits F of a view into nothing but unknown
# space this is
#
#     LE = n (b(s1) - b(s0)) / F    [full views]
#
# which is subtracted with the weight 1. F is proportional to Omega as well, so that the field of
# view does not count. With v the number n grows as v^-2 and F as v^-3: in finer maps a millimeter
# costs a smaller share of a full view, as their full views tell more. Normals point anywhere, so
# s^2 is a third of the trace of the position covariance. A pair of 640 x 480 pixels, f = 457 px
# and 12 cm between the cameras, has r = 9 mm at 2 m; where s is 6 mm, growth of the root of the
# trace by 1 mm costs 0.0013 full views in voxels of 5 cm and 0.0009 in voxels of 2 cm, and growth
# by 10 mm 0.014 and 0.010.
#
# Not counted: what the rotation error moves, and that an offset of the whole map (the target's
# error) is in every scan and cannot be avoided by another path.

_SURFACE = 0.5
"""Distance of the surface that fills the image, as a share of the camera's range."""


def pose_information_loss(
    situation: Situation, sensor: InformationConfig, errors: ArrayLike
) -> FloatArray:
    """Share of a full view that scans lose by the growth of the pose's sigma; see the module.

    Args:
        situation: pose covariance, camera and map now.
        sensor: noise law.
        errors: growth of the position sigma (root of the trace) up to each view, shape (M,) [m].

    Returns:
        Shape (M,) [full views]; negative where the pose gets better known.
    """
    grid, camera = situation.voxel_map.config, situation.camera
    distance = _SURFACE * situation.max_range
    across, down = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    solid_angle = 4.0 * np.arctan2(across * down, np.sqrt(1.0 + across**2 + down**2))
    voxels = solid_angle * (distance / grid.voxel_size) ** 2
    bits = lost_bits(range_variance(situation, sensor), situation.pose_covariance, errors)
    return voxels * bits / _bits_of(sensor).full_view(situation)


def range_variance(situation: Situation, sensor: InformationConfig) -> float:
    """Variance of a surface in a voxel of that surface by one scan from a known pose [m^2]."""
    distance = _SURFACE * situation.max_range
    sigma, _ = voxel_observation(distance, situation.voxel_map.config, sensor)
    return float(sigma) ** 2


def lost_bits(variance: float, covariance: FloatArray, errors: ArrayLike) -> FloatArray:
    """Bits that a scan loses in a surface voxel, shape (M,).

    Args:
        variance: of the surface in the voxel by a scan from a known pose [m^2].
        covariance: of the pose now, shape (6, 6).
        errors: growth of the root of its position's trace, shape (M,) [m].
    """
    before = float(np.trace(covariance[:3, :3]))
    after = np.maximum(np.sqrt(before) + np.asarray(errors, dtype=np.float64), 0.0) ** 2
    return np.asarray(0.5 * np.log2((variance + after / 3.0) / (variance + before / 3.0)))


@lru_cache(maxsize=8)
def _bits_of(sensor: InformationConfig) -> ExpectedInformation:
    """Counts full views in bits, whatever metric rates the candidates."""
    return ExpectedInformation(config=sensor)
