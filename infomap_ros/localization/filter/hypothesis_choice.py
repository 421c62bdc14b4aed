"""Which explanation of an image is right, if any can be trusted.

How much larger the errors of a camera's measurements are than their stated noise.

The stated sigmas are those of image and matching noise. Imperfect calibration, a rolling shutter or
the systematic error of a depth camera come on top and are not known beforehand, but show: fiducials
disagree by more than their sigmas. The sigmas are multiplied by a common factor that follows what
is seen (innovation-based adaptation: R. K. Mehra, IEEE Transactions on Automatic Control 17(5),
1972, doi:10.1109/TAC.1972.1100100), never below 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig, FilterUpdate
from infomap_ros.localization.filter.consensus import agreeing, find_pose
from infomap_ros.localization.filter.history import FiducialHistory
from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.lie import skews
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.pose_hypothesis import (
    Expectation,
    Group,
    Hypothesis,
    examine,
    examine_with_or_without_prior,
    least_gain,
)
from infomap_ros.localization.filter.sight import BoolArray, Measured, Sight

# Which fiducials of an image could be found out if they were mistaken for others.
#
# A fiducial that was mistaken for another one is found out by those that contradict it. Where the
# image shows one or two fiducials of a place that is known only roughly relative to everything else
# in view, nothing contradicts them wherever they are seen, and they would pull the whole place
# along.
#
# The redundancy of a measurement tells how much of a gross error of it its own residual shows
# (W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission
# 2(5), 1968; W. Foerstner, "Reliability analysis of parameter estimation in linear models with
# applications to mensuration problems in computer vision", CVGIP 40, 1987,
# doi:10.1016/0734-189X(87)90144-5). Of m equal witnesses of something unknown it is 1 - 1/m. What
# counts here is by how much it is smaller than it would be if only the camera's pose were unknown.

_GROSS = 1.0  # [px], sigma of pixels for which redundancy is given
_POSE = 1e-9  # that keeps few fiducials from leaving the pose undetermined, of its information


def controlled(sight: Sight, jacobian: FloatArray, least: float) -> BoolArray:
    """Which fiducials of an image would be found out, shape (M,).

    The one of which most is hidden is left out until little enough of all others is. All pixels
    count as equally exact, to a pixel: mistakes are no smaller, and a witness of a mistake need
    not be exact.

    Args:
        sight: what is known of M fiducials before the image.
        jacobian: derivatives of their values by d, shape (M, 3, 3).
        least: share of an error that must show beside the map's uncertainty, below 1.

    Raises:
        numpy.linalg.LinAlgError: the covariance is singular.
    """
    count = len(jacobian)
    over = (jacobian @ sight.covariance.reshape(count, 3, -1)).reshape(3 * count, -1)
    S = (over.reshape(3 * count, count, 1, 3) @ jacobian.transpose(0, 2, 1)).reshape(3 * count, -1)
    noise = sight.measured.variances.copy()
    noise[:, :2] = np.maximum(noise[:, :2], _GROSS**2)
    S[np.diag_indices(3 * count)] += noise.ravel()
    inverse: FloatArray = np.asarray(np.linalg.inv(S))
    by_pose = _pose_derivatives(sight, jacobian)
    left = np.ones(count, bool)
    while left.any():
        shown = _blocks(inverse, noise)
        by_map = np.subtract(_shown_of_a_known_map(by_pose, noise, left), shown)
        hidden = np.linalg.eigvalsh(by_map)[:, -1] - (1.0 - least)
        worst = int(np.where(left, hidden, -1.0).argmax())
        if hidden[worst] <= 0.0:
            break
        left[worst] = False
        inverse = _without(inverse, worst)
    return left


def _blocks(inverse: FloatArray, noise: FloatArray) -> FloatArray:
    """Redundancy of each fiducial's pixel, shape (M, 2, 2), from the inverse of S."""
    each, sigmas = np.arange(len(noise)), np.sqrt(noise[:, :2])
    blocks = inverse.reshape(len(noise), 3, len(noise), 3)[each, :2, each, :2]
    return np.asarray(sigmas[:, :, None] * blocks * sigmas[:, None, :])


def _pose_derivatives(sight: Sight, jacobian: FloatArray) -> FloatArray:
    """Derivatives of the values by a motion of the camera, shape (M, 3, 6)."""
    lever = -skews(sight.points @ sight.rotation.T)
    return np.concatenate([jacobian, jacobian @ lever], axis=2)


def _shown_of_a_known_map(by_pose: FloatArray, noise: FloatArray, left: BoolArray) -> FloatArray:
    """Redundancy of each pixel if nothing but the camera's pose is unknown, shape (M, 2, 2)."""
    white = by_pose / np.sqrt(noise)[:, :, None]
    flat = white[left].reshape(-1, 6)
    information = flat.T @ flat
    information += _POSE * np.diag(np.diag(information))
    pixels = white[:, :2]
    return np.asarray(np.eye(2) - pixels @ np.linalg.solve(information, pixels.transpose(0, 2, 1)))


def _without(inverse: FloatArray, index: int) -> FloatArray:
    """The inverse of the covariance of the others; rows and columns of this one are zero."""
    own = slice(3 * index, 3 * index + 3)
    rows = inverse[own]
    rest = inverse - rows.T @ np.linalg.solve(rows[:, own], rows)
    rest[own], rest[:, own] = 0.0, 0.0
    return np.asarray(rest)


CONTRADICTION = "the motion that the fiducials show contradicts the expected one"
DISAGREEMENT = "the fiducials do not agree on one pose"
AMBIGUITY = "two groups of fiducials show different motions"
MINORITY = "too few of the fiducials agree on one pose"
UNSUPPORTED = "too few of the fiducials would be found out if they were wrong"
CONTESTED = (DISAGREEMENT, AMBIGUITY, MINORITY)
_MOST = 3
_SUSPICIOUS = 0.01  # probability of a motion so far from its prior
_LEAST = 3  # fiducials that agree on some motion by chance


@dataclass(frozen=True, eq=False)
class Image:
    """The known fiducials of an image.

    Attributes:
        ids: shape (M,).
        indices: of them in the state, shape (M,).
        measured: their measurements.
    """

    ids: NDArray[np.int64]
    indices: NDArray[np.int64]
    measured: Measured


def explain(
    state: InvariantState,
    prior: MotionPrior,
    image: Image,
    history: FiducialHistory,
    config: FiducialFilterConfig,
) -> tuple[Hypothesis | None, str, bool]:
    """The explanation of an image, why there is none, and whether it overrules the prior.

    Args:
        state: before the motion.
        prior: of the motion.
        image: known fiducials.
        history: of the fiducials.
        config: gates.
    """
    admitted = history.is_trusted(image.ids)
    established = admitted & history.is_established(image.ids)
    # Those that are new may have been added on a body that moves: they do not decide.
    enough = np.count_nonzero(established) >= 2 * config.min_fiducials
    voters = established if enough else admitted
    contested = history.is_contested(image.ids)
    found = hypotheses(state, prior, image, voters, config)
    chosen, reason = choose(found, contested, int(voters.sum()), config)
    overruled = False
    if reason == CONTRADICTION:
        wider = overruled_prior(prior, found, voters, established, config)
        if wider is None:
            return None, reason, False
        overruled = True
        found = hypotheses(state, wider, image, voters, config)
        chosen, reason = choose(found, contested, int(voters.sum()), config)
        if chosen is not None and least_gain(state, chosen, image.indices) < config.overruling_gain:
            return None, CONTRADICTION, False
    if chosen is not None:
        chosen = _supported(state, _joined(state, chosen, image, admitted, config), image, config)
        reason = "" if chosen is not None else UNSUPPORTED
    if chosen is None and not overruled:
        chosen = _by_landmarks(state, prior, image, admitted & (image.ids < 0), config)
        reason = reason if chosen is None else ""
    return chosen, reason, overruled


def _by_landmarks(
    state: InvariantState,
    prior: MotionPrior,
    image: Image,
    landmarks: BoolArray,
    config: FiducialFilterConfig,
) -> Hypothesis | None:
    """What the landmarks of a mask, shape (M,), say, be it one: each is what it is taken for."""
    expected = Expectation.at(state, prior, state.T_map_camera @ prior.T_before_after)
    group = Group(image.indices, image.measured, landmarks, landmarks)
    found = examine(state, expected, group, config, least=1)
    if found is None or 2 * found.count <= np.count_nonzero(landmarks):
        return None
    is_sound = found.has_plausible_residuals(config) and found.has_plausible_motion(config)
    return found if is_sound else None


def _joined(
    state: InvariantState,
    chosen: Hypothesis,
    image: Image,
    admitted: BoolArray,
    config: FiducialFilterConfig,
) -> Hypothesis:
    """The chosen hypothesis, joined by those that did not vote and agree with it."""
    group = Group(image.indices, image.measured, chosen.members, admitted)
    joined = examine(state, chosen.expectation, group, config)
    if joined is None or not (
        joined.has_plausible_residuals(config) and joined.has_plausible_motion(config)
    ):
        return chosen
    return joined if joined.count >= chosen.count else chosen


def _supported(
    state: InvariantState, chosen: Hypothesis, image: Image, config: FiducialFilterConfig
) -> Hypothesis | None:
    """The chosen hypothesis without those that nothing would contradict if they were wrong.

    None where too few are left, or these do not agree.
    """
    members = np.flatnonzero(chosen.members)
    sight = chosen.expectation.sight(state, image.indices[members], image.measured.select(members))
    enough = controlled(sight, chosen.correction.jacobian, config.min_redundancy)
    enough |= image.ids[members] < 0
    if enough.all():
        return chosen
    rest, undecided = chosen.members.copy(), np.zeros(len(image.ids), bool)
    rest[members[~enough]], undecided[members[~enough]] = False, True
    if np.count_nonzero(rest) < config.min_fiducials:
        return None
    smaller = examine(
        state, chosen.expectation, Group(image.indices, image.measured, rest, rest), config
    )
    if smaller is None or smaller.count < config.min_fiducials:
        return None
    return replace(smaller, undecided=undecided)


def hypotheses(
    state: InvariantState,
    prior: MotionPrior,
    image: Image,
    admitted: BoolArray,
    config: FiducialFilterConfig,
) -> list[Hypothesis]:
    """Explanations of an image, each by other fiducials: largest group first, as RANSAC finds them.

    Args:
        state: before the motion.
        prior: of the motion.
        image: known fiducials.
        admitted: those that may serve, shape (M,).
        config: gates.
    """
    indices, measured = image.indices, image.measured
    turn = state.T_map_camera[:3, :3] @ prior.T_before_after[:3, :3]
    covariances = turn.T @ _relative_covariances(state, indices) @ turn
    positions = state.positions[indices]
    gate = float(chdtri(3, 1.0 - config.fiducial_gate))
    remaining = admitted.copy()
    found: list[Hypothesis] = []
    for _ in range(_MOST):
        if np.count_nonzero(remaining) <= _LEAST:
            break
        some = np.flatnonzero(remaining)
        part = (positions[some], covariances[some], measured.select(some), gate)
        first = find_pose(*part, config.trials)
        if first is None:
            break
        pose, sample = first
        members = np.zeros(len(indices), bool)
        members[some] = agreeing(pose, *part)
        members[some[sample]] = True
        expectation = Expectation.at(state, prior, invert_transform(pose))
        group = Group(indices, measured, members, admitted)
        hypothesis = examine_with_or_without_prior(state, expectation, group, config)
        remaining &= ~members
        if hypothesis is not None:
            found.append(hypothesis)
            remaining &= ~hypothesis.members
    return found


def choose(
    found: Sequence[Hypothesis], contested: BoolArray, known: int, config: FiducialFilterConfig
) -> tuple[Hypothesis | None, str]:
    """The hypothesis to believe, or None and the reason.

    Args:
        found: the hypotheses.
        contested: fiducials of the image that last contradicted each other, shape (M,).
        known: number of known fiducials in the image.
        config: gates.
    """
    if known < config.min_fiducials:
        return None, f"{known} known fiducials in view, {config.min_fiducials} needed"
    sound = [one for one in found if one.has_plausible_residuals(config)]
    if not sound:
        return None, DISAGREEMENT
    plausible = sorted(
        (one for one in sound if one.has_plausible_motion(config)), key=lambda one: -one.count
    )
    if not plausible:
        return None, CONTRADICTION
    best = plausible[0]
    if best.count < config.min_fiducials:
        return None, DISAGREEMENT
    others = [one for one in found if one is not best and one.has_plausible_motion(config)]
    if any(_is_rival(one, best, config) for one in others):
        return None, AMBIGUITY
    # Who wins must not hang on what happens to be in view.
    was_contested = 2 * np.count_nonzero(best.members & contested) > best.count
    needed, count = config.majority * known, best.count
    if was_contested:
        # Those that did not vote count too, or they would keep all others from being believed.
        needed, count = config.overruling_share * len(contested), _witnesses(best, config)
    least = max(config.min_fiducials, config.ambiguity * best.count)
    excluded = sum(
        one.count for one in sound if one.count >= least and not one.has_plausible_motion(config)
    )
    if count + excluded < needed:
        return None, MINORITY
    return best, ""


def _witnesses(hypothesis: Hypothesis, config: FiducialFilterConfig) -> int:
    """How many fiducials of the image agree, be they its members or not."""
    gate = chdtri(3, 1.0 - config.fiducial_gate)
    agree = (hypothesis.innovations**2).sum(axis=1) <= gate
    return int(np.count_nonzero(agree | hypothesis.members))


def _is_rival(one: Hypothesis, best: Hypothesis, config: FiducialFilterConfig) -> bool:
    """Whether another group is large enough to be right, or agrees better with the prior."""
    fits_better = (
        one.count >= config.min_fiducials
        and best.motion_nis > chdtri(6, _SUSPICIOUS)
        and one.motion_nis < 0.5 * best.motion_nis
    )
    return one.count >= config.ambiguity * best.count or fits_better


def overruled_prior(
    prior: MotionPrior,
    found: Sequence[Hypothesis],
    voters: BoolArray,
    established: BoolArray,
    config: FiducialFilterConfig,
) -> MotionPrior | None:
    """The motion prior with as much uncertainty as the images show that it has.

    Wheels slip and arms are pushed: where nearly all fiducials, and enough that are known for
    long, agree with each other but not with the prior, it is the prior that is wrong. By how much
    it can be has a limit.

    Args:
        prior: of the motion.
        found: hypotheses that contradict it.
        voters: fiducials of the image that decide, shape (M,).
        established: those that were seen before they were last, shape (M,).
        config: shares.

    Returns:
        The prior that fits; None where the images do not suffice to overrule it.
    """
    for one in found:
        possible = one.motion_nis <= config.overruling_sigmas**2
        enough = possible and one.count >= config.overruling_share * np.count_nonzero(voters)
        known_long = np.count_nonzero(one.members & established) >= config.overruling_count
        if enough and known_long and one.has_plausible_residuals(config):
            return MotionPrior(prior.T_before_after, one.motion_nis * prior.covariance)
    return None


def _relative_covariances(state: InvariantState, indices: NDArray[np.int64]) -> FloatArray:
    """Of fiducials relative to the camera before the motion, in the map's axes, (M, 3, 3)."""
    count, each = len(indices), np.arange(len(indices))
    covariance, _ = state.apparent_covariance(indices, state.T_map_camera)
    return np.asarray(covariance.reshape(count, 3, count, 3)[each, :, each])


_DISAGREE = 1.2  # mean squared distance from which on the factor grows
_AGREE = 0.7  # below which it shrinks
_REJECTED = 0.2  # share of rejected fiducials from which on it grows
_GROWTH, _DECAY, _STEP = 1.2, 0.97, 2.0


class AdaptiveNoise:
    """Follows the factor.

    Attributes:
        factor: by which sigmas are multiplied.

    Args:
        largest: limit of the factor.
    """

    def __init__(self, largest: float) -> None:
        self._largest = largest
        self.factor = 1.0

    def applied(self, observations: FiducialObservations) -> FiducialObservations:
        """Observations with the sigmas that they are believed to have."""
        if self.factor == 1.0 or not len(observations):
            return observations
        return FiducialObservations(
            observations.ids,
            observations.pixels,
            observations.pixel_sigmas * self.factor,
            observations.inverse_depths,
            observations.inverse_depth_sigmas * self.factor,
        )

    def note(self, update: FilterUpdate) -> None:
        """Learn from a consistent update with the present factor."""
        mean = update.nis / max(update.degrees_of_freedom, 1)
        every = len(update.used) + len(update.rejected)
        rejected = len(update.rejected) / max(every, 1)
        if mean > _DISAGREE or rejected > _REJECTED:
            self.factor = min(self.factor * _GROWTH, self._largest)
        elif mean < _AGREE and rejected < 0.5 * _REJECTED:
            self.factor = max(self.factor * _DECAY, 1.0)

    def may_explain(self, reason: str) -> bool:
        """Whether larger sigmas may be why the filter has refused an image.

        Two groups that show different motions may be one group with a little more noise, but with
        much more noise everything would be one group.

        Args:
            reason: of `FilterUpdate`.
        """
        if reason == AMBIGUITY:
            return self.factor < _STEP
        return reason in (DISAGREEMENT, MINORITY)

    def grow(self) -> bool:
        """Try a clearly larger factor; False where the limit is reached."""
        if self.factor >= self._largest:
            return False
        self.factor = min(self.factor * _STEP, self._largest)
        return True
