"""Terms of the rating: what a view gives, what it costs, and how risky it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, LOG_ODDS_QUANTUM
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import MotionTimes, Situation

LocalizationError = Callable[[Situation, FloatArray, FloatArray], FloatArray]
"""Error accumulated on the path to views: situation, poses (M, 4, 4), lengths of the paths (M,) [m]
-> growth of the position sigma (M,) [m]."""


POSITION_PER_METER, POSITION_PER_RADIAN = 0.03, 0.005
"""Position sigma by odometry alone after one meter, and after turning by one radian [m]."""
ROTATION_PER_METER, ROTATION_PER_RADIAN = 0.01, 0.02
"""Rotation sigma likewise [rad]; the variances grow in proportion to the length."""


class OdometryDrift:
    """Localization error LE of eq. (11), until landmarks on the way can be predicted.

    The pose covariance at the end of the path is the present one, turned into the position error
    that a heading error causes over the path, plus what odometry adds.
    """

    def __call__(self, situation: Situation, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Error of the views, shape (M,) [m].

        Args:
            situation: pose and covariance now.
            poses: ``T_map_camera``, shape (M, 4, 4).
            lengths: of the paths there, shape (M,) [m].
        """
        before = float(np.trace(situation.pose_covariance[:3, :3]))
        turns = rotation_angles(situation.T_map_camera, poses)
        position = POSITION_PER_METER**2 * lengths + POSITION_PER_RADIAN**2 * turns
        added = ROTATION_PER_METER**2 * lengths + ROTATION_PER_RADIAN**2 * turns
        # A heading error moves the end of a path of length s by s; one that grows on the path in
        # proportion to it, by s / sqrt(3).
        heading = situation.pose_covariance[5, 5]
        position = position + lengths**2 * (heading + added / 3.0)
        return np.asarray(np.sqrt(before + position) - np.sqrt(before))


def rotation_vectors(T_map_camera: FloatArray, poses: FloatArray) -> FloatArray:
    """Rotations from one pose to others, about the axes of the map, (M, 4, 4) -> (M, 3) [rad]."""
    turns = poses[:, :3, :3] @ T_map_camera[:3, :3].T
    return np.asarray(Rotation.from_matrix(turns).as_rotvec()).reshape(-1, 3)


def rotation_angles(T_map_camera: FloatArray, poses: FloatArray) -> FloatArray:
    """Angles of these rotations, (M, 4, 4) -> (M,) [rad]."""
    return np.asarray(np.linalg.norm(rotation_vectors(T_map_camera, poses), axis=1))


# Over which views become unlike: distance [m], azimuth and elevation [rad].
_LIKE_DISTANCE, _LIKE_AZIMUTH, _LIKE_ELEVATION = 1.5, 0.6, 0.15
# Over which the share that a view has told says less of others: [m], [rad].
_TRUST_DISTANCE, TRUST_AZIMUTH = 4.0, 3.0
_TRUST_CREDIT = 0.3  # so many views count as if they had told all


class RatingTerm(Protocol):
    """One term of the sum in eq. (11).

    Attributes:
        name: key in a rated view's terms.
        unit: of its values. Values in "bits", or whatever the source of the information counts
            in, are divided by the information of a full unknown view before they are weighted.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102

    def __call__(self, options: Options) -> FloatArray:
        """Value of the term for each view, shape (M,)."""


class Information:
    """NI of eq. (11): what the view is expected to tell about the task's region."""

    name, unit = "information", "bits"

    def __call__(self, options: Options) -> FloatArray:
        """Information of each view, shape (M,)."""
        return options.information


class InterestTerm:
    """What interests add to the information, or take from it.

    The information of a view is spread over what a few of its rays see in the task's region that
    is not known to be empty; each place counts with its weight.
    """

    name, unit = "interest", "bits"

    def __call__(self, options: Options) -> FloatArray:
        """Added information of each view, shape (M,); negative where less is wanted."""
        if not options.situation.interests:
            return np.zeros(len(options))
        return np.asarray(options.information * (options.coarse_views.wanted - 1.0))


class TeammatesTerm:
    """What teammates are about to see themselves, as a loss of the information that is wanted."""

    name, unit = "teammates", "bits"

    def __call__(self, options: Options) -> FloatArray:
        """Lost information of each view, shape (M,), at most 0."""
        if not options.situation.teammates:
            return np.zeros(len(options))
        return np.asarray(options.information * options.coarse_views.wanted * (options.left - 1.0))


class Repetition:
    """What views like it have promised before, and not told: sky, mirrors, walls without texture.

    What a view that was taken still promises is taken off views like it, the less the more they
    differ in position and direction (a Gaussian). As other space in such a direction keeps its
    promises as badly, a view loses at least the share that views of its elevation have failed to
    tell, averaged over a wider surrounding.
    """

    name, unit = "repetition", "bits"

    def __init__(self) -> None:
        self._near = np.array((_LIKE_DISTANCE, _LIKE_AZIMUTH, _LIKE_ELEVATION))
        self._wide = np.array((_TRUST_DISTANCE, TRUST_AZIMUTH, _LIKE_ELEVATION))

    def __call__(self, options: Options) -> FloatArray:
        """Lost information of each view, shape (M,), at most 0."""
        alike = _likeness(options.poses, options.recent_views, self._near)
        lost = (options.left_over[:, None] * alike).max(axis=0, initial=0.0)
        lost = np.maximum(lost, options.information * self._broken(options))
        return np.asarray(-np.minimum(lost, options.information))

    def _broken(self, options: Options) -> FloatArray:
        """Share of its information that each view is not trusted to tell, shape (M,)."""
        kept, views = options.situation.kept_shares, options.situation.past_views
        rated = np.flatnonzero(np.isfinite(kept))
        alike = _likeness(options.poses, views[rated], self._wide)
        missed = ((1.0 - kept[rated])[:, None] * alike).sum(axis=0)
        return np.asarray(missed / (alike.sum(axis=0) + _TRUST_CREDIT))


def _likeness(poses: FloatArray, past: FloatArray, widths: FloatArray) -> FloatArray:
    """How alike views are, (M, 4, 4) and (V, 4, 4) -> (V, M), in [0, 1].

    `widths` are the distance [m], azimuth and elevation [rad] over which they become unlike.
    """
    azimuths, elevations = _directions(poses)
    others, tilts = _directions(past)
    gaps = np.linalg.norm(poses[None, :, :3, 3] - past[:, None, :3, 3], axis=2)
    turns = np.remainder(azimuths - others[:, None] + np.pi, 2.0 * np.pi) - np.pi
    turns *= np.cos(0.5 * (elevations + tilts[:, None]))
    apart = np.stack([gaps, turns, elevations - tilts[:, None]], axis=-1) / widths
    return np.asarray(np.exp(-0.5 * (apart**2).sum(axis=-1)))


def _directions(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation of the optical axes of poses, (M, 4, 4) -> (M,) each [rad]."""
    axes = poses[:, :3, 2]
    return np.arctan2(axes[:, 1], axes[:, 0]), np.arcsin(np.clip(axes[:, 2], -1.0, 1.0))


class Distance:
    """d of eq. (10): weighted distance over the degrees of freedom of the camera.

    ``d = sqrt(sum (w_i (c_i - c'_i))^2)``, so alpha_i of the paper is ``w_i^2``. The position part
    is stretched by how much longer the path through known free space is than the straight line.
    """

    name, unit = "distance", "weighted m and rad"

    def __init__(
        self,
        position_weights: ArrayLike = (1.0, 1.0, 1.0),
        rotation_weights: ArrayLike = (0.2, 0.2, 0.2),
    ) -> None:
        """Weights of x, y, z [1/m] and of the rotation about x, y, z of the map [1/rad]."""
        self._position, self._rotation = np.array(position_weights), np.array(rotation_weights)

    @property
    def mean_weight(self) -> float:
        """Weight of a path over level ground [1/m]."""
        return float(np.mean(self._position[:2]))

    def __call__(self, options: Options) -> FloatArray:
        """Distance of each view, shape (M,)."""
        return self.between(options.situation.T_map_camera, options.poses, options.path_lengths)

    def between(self, start: FloatArray, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Distance from one pose, (4, 4), to others, (M, 4, 4), paths of `lengths` (M,) [m]."""
        offsets = poses[:, :3, 3] - start[:3, 3]
        straight = np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
        detour = np.maximum(np.where(np.isfinite(lengths), lengths, straight) / straight, 1.0)
        moved = detour * np.linalg.norm(offsets * self._position, axis=1)
        turns = rotation_vectors(start, poses)
        return np.hypot(moved, np.linalg.norm(turns * self._rotation, axis=1))


class Duration:
    """The cost of eq. (10) as the time of driving, turning, the arm's motion and the look [s].

    An estimate that needs no plan of motion: the arm alone brings the camera as far as it reaches;
    farther off the arm is folded, the base drives the path of the camera through free space and
    turns by as much as the camera does, and the arm unfolds. `Approach` puts the time of the
    planned motion in its place.
    """

    name, unit = "duration", "s"

    def __init__(self, times: MotionTimes) -> None:
        """Take the robot's speeds."""
        self._times = times

    def __call__(self, options: Options) -> FloatArray:
        """Time of each view, shape (M,) [s]."""
        return self.between(options.situation.T_map_camera, options.poses, options.path_lengths)

    def between(self, start: FloatArray, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Time from one pose, (4, 4), to others, (M, 4, 4), paths of `lengths` (M,) [m]."""
        times, turns = self._times, rotation_vectors(start, poses)
        straight = np.linalg.norm(poses[:, :3, 3] - start[:3, 3], axis=1)
        distances = np.maximum(np.where(np.isfinite(lengths), lengths, straight), straight)
        with_arm = np.linalg.norm(turns, axis=1) / times.arm_rate
        with_arm = np.maximum(with_arm, times.arm * straight / max(times.arm_reach, 1e-9))
        driven = distances / times.speed + np.abs(turns[:, 2]) / times.turn_rate + 2.0 * times.arm
        near = straight <= times.arm_reach
        return np.asarray(np.where(near, np.minimum(with_arm, driven), driven) + times.look)


class LocalizationErrorTerm:
    """LE of eq. (11), by a model that can be replaced."""

    name, unit = "localization_error", "m"

    def __init__(self, model: LocalizationError | None = None) -> None:
        self._model = model or OdometryDrift()

    def __call__(self, options: Options) -> FloatArray:
        """Accumulated localization error of each view, shape (M,)."""
        straight = np.linalg.norm(options.positions - options.situation.position, axis=1)
        lengths = np.where(np.isfinite(options.path_lengths), options.path_lengths, straight)
        return self._model(options.situation, options.poses, lengths)


class Risk:
    """P of eq. (11): the probability that the camera's place is occupied, or a teammate's.

    The largest probability of occupancy within the camera's ball; the voxels of a ball are seen
    together and thus far from independent. Nearness to a teammate, or to the view that it is
    heading for, counts as a probability that falls off like a Gaussian.
    """

    name, unit = "risk", ""

    def __init__(self, camera_radius: float, teammate_sigma: float) -> None:
        """Radius of the ball [m] and width of the Gaussian [m]."""
        self._radius, self._sigma = camera_radius, teammate_sigma

    def __call__(self, options: Options) -> FloatArray:
        """Risk of each view, shape (M,), within [0, 1]."""
        situation, positions = options.situation, options.positions
        safe = 1.0 - _occupancy(options.surroundings, positions, self._radius)
        here = np.linalg.norm(positions - situation.position, axis=1) < 1e-6
        safe[here] = 1.0  # it stands there unharmed
        for mate in situation.teammates:
            for place, radius in mate.places():
                gaps = np.maximum(np.linalg.norm(positions - place, axis=1) - radius, 0.0)
                safe *= 1.0 - np.exp(-0.5 * (gaps / self._sigma) ** 2)
        return np.asarray(1.0 - safe)


def _occupancy(surroundings: Surroundings, positions: FloatArray, radius: float) -> FloatArray:
    """Largest probability of occupancy within `radius` of positions, (N, 3) -> (N,)."""
    window = surroundings.window
    reach = int(radius / window.voxel_size + 1e-6)
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), axis=-1)
    steps = steps.reshape(-1, 3)
    steps = steps[(steps**2).sum(axis=1) <= (radius / window.voxel_size) ** 2 + 1e-6]
    places, index = np.unique(window.positions_of(positions), axis=0, return_inverse=True)
    near = np.clip(places[:, None] + steps, 0, np.array(window.quanta.shape) - 1)
    where = tuple(np.moveaxis(near, -1, 0))
    quanta = window.quanta[where].astype(np.float64)
    quanta[quanta == UNKNOWN_QUANTA] = 0.0
    probability = 1.0 / (1.0 + np.exp(-np.clip(quanta * LOG_ODDS_QUANTUM, -700.0, 700.0)))
    own_body = (surroundings.states[where] == FREE) & (window.quanta[where] == UNKNOWN_QUANTA)
    probability[own_body] = 0.0
    return np.asarray(probability.max(axis=1)[np.ravel(index)])
