"""Finding back: to known places, after tracking has failed, and after the camera was lost."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.consensus import agreeing, find_pose
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.hypothesis_choice import UNSUPPORTED
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.shared_errors import invariant_difference, invariant_from_pose
from infomap_ros.localization.filter.sight import Measured
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.scene_fiducials import SceneFiducials, joined

_SIGMAS = 3.0  # of the pose, within which a fiducial is looked for
_ANYWHERE = 0.2  # of the image's width, a search radius beyond which all of it is searched
_EXPECTED = 10  # fiducials that ought to be seen, from which on their absence says something
_HIDDEN = 0.34  # of a contradiction, when what is missed may be hidden
_ROUGH = (0.005, 0.005, 0.005, 0.002, 0.002, 0.002)  # [m, rad] of a pose of some fiducials
_AGREEING = 12  # fiducials that must agree to find a lost camera again
_FOUND = 0.25  # share of them that must be seen for the camera to be where it is thought to be


class Recovery:
    """Looks for known fiducials by their appearance.

    Args:
        camera: that sees them.
        config: how much must agree.
        pose_filter: knows where they are.
        scene: finds them.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        config: LocalizerConfig,
        pose_filter: FiducialFilter,
        scene: SceneFiducials,
    ) -> None:
        self._camera, self._config = camera, config
        self._filter, self._scene = pose_filter, scene
        self._reckoned: MotionPrior | None = None  # from map to camera, since it was lost
        self._agreed = False  # whether what was recognized last agreed, though it was too little

    def lose(self) -> None:
        """The camera may be anywhere from now on; before the filter is told so."""
        self._reckoned = MotionPrior(*self._filter.pose)

    def recover(
        self,
        view: RangeView,
        seen: FiducialObservations,
        is_lost: bool,
        prior: MotionPrior | None = None,
    ) -> tuple[int, str]:
        """Find the pose again by all fiducials that can be recognized in a view.

        Args:
            view: that was tracked last, in vain.
            seen: what tracking has found.
            is_lost: the pose may be any; then more fiducials have to agree, and many more on a
                pose that is far from where odometry says.
            prior: of the camera's motion since the view before, where odometry tells it.

        Returns:
            Number of fiducials that the pose rests on, 0 and the reason where it was not found.
        """
        if self._reckoned is not None:
            self._reckoned = None if prior is None else self._reckoned.then(prior)
        pose, covariance = self._expected(is_lost)
        radius = self._search_radius(pose, covariance)
        reason = "no known fiducial recognized"
        for is_near in (True, False):
            if is_near and radius > _ANYWHERE * self._camera.width:
                continue
            if not is_near and not is_lost:
                continue
            near = self._scene.recall(view, pose, radius) if is_near else None
            found = self._scene.recall_anywhere(view) if near is None else near
            used, reason = self._update(joined(seen, found), is_lost)
            if used and is_lost:
                return used + self.return_to_known(view), "found again"
            if used:
                return used, ""
            self._scene.set_aside(found.ids)
        self._agreed = reason == UNSUPPORTED
        return 0, reason

    def _update(self, every: FiducialObservations, is_lost: bool) -> tuple[int, str]:
        if is_lost and not self._enough_agree(every):
            return 0, f"{len(every)} known fiducials recognized, not enough agree"
        update = self._filter.update(every)
        if not update.is_consistent:
            return 0, update.reason
        self._scene.note(every, update)
        return len(update.used), ""

    def return_to_known(self, view: RangeView) -> int:
        """Use known fiducials that ought to be in view but are not followed: removes drift.

        Returns:
            Number of those found.
        """
        pose, covariance = self._filter.pose
        radius = min(self._search_radius(pose, covariance), 0.25 * self._camera.width)
        found = self._scene.recall(view, pose, radius)
        if not len(found):
            return 0
        update = self._filter.update(found)
        self._scene.set_aside(np.setdiff1d(found.ids, update.used))
        return len(update.used)

    def contradiction(self, view: RangeView, seen: FiducialObservations) -> float:
        """How much a view speaks against where the camera is thought to be.

        Fiducials ought to be seen, by where they are and from where they were seen before, but
        neither tracking nor recognition has found them. After `recover`.

        Args:
            view: the last one.
            seen: what tracking has found.

        Returns:
            1, or less where something nearer may hide them; 0 where nothing speaks against it.
        """
        if self._agreed:
            return 0.0
        wanted, hidden = self._scene.ought_to_be_seen(view, self._filter.pose[0])
        if len(wanted) < _EXPECTED or np.isin(wanted, seen.ids).mean() >= _FOUND:
            return 0.0
        if not self._scene.shows_enough(view):
            return 0.0
        return _HIDDEN if hidden.mean() > 0.5 else 1.0

    def _expected(self, is_lost: bool) -> tuple[FloatArray, FloatArray]:
        """The pose, shape (4, 4), about which known fiducials are looked for first, and covariance.

        A lost camera may be anywhere, but most likely it is where odometry says since.
        """
        if not is_lost or self._reckoned is None:
            return self._filter.pose
        return self._reckoned.T_before_after, self._reckoned.covariance

    def _search_radius(self, pose: FloatArray, covariance: FloatArray) -> float:
        """How far from its expected place a fiducial at the mean distance may appear [px]."""
        known = self._filter.fiducials()
        away = np.linalg.norm(known.positions - pose[:3, 3], axis=1)
        distance = float(np.median(away)) if len(away) else 1.0
        position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1]) ** 0.5
        rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) ** 0.5
        angle = _SIGMAS * float(np.hypot(position / max(distance, 0.1), rotation))
        return self._camera.fx * angle + 4.0

    def _enough_agree(self, observations: FiducialObservations) -> bool:
        """Whether so many fiducials agree on one pose that a lost camera is there.

        On a pose where odometry says that the camera cannot be, twice as many, and nearly all of
        those that were recognized: walls repeat themselves.
        """
        known = self._filter.fiducials()
        chosen = observations.select(np.isin(observations.ids, known.ids))
        needed: float = _AGREEING
        if len(chosen) < needed:
            return False
        order = np.argsort(known.ids)
        rows = order[np.searchsorted(known.ids, chosen.ids, sorter=order)]
        points, covariances = known.positions[rows], known.covariances[rows]
        measured, config = Measured.of(self._camera, chosen), self._config.filter
        pose, count = _most_agree(points, covariances, measured, config)
        if count >= needed and self._is_elsewhere(pose):
            needed = max(2 * needed, config.overruling_share * len(chosen))
        return count >= needed

    def _is_elsewhere(self, pose: FloatArray) -> bool:
        """Whether a pose, shape (4, 4), is too far from where odometry says that the camera is."""
        if self._reckoned is None:
            return False
        error = invariant_difference(pose, self._reckoned.T_before_after)
        over = invariant_from_pose(self._reckoned.T_before_after[None])[0]
        spread = over @ self._reckoned.covariance @ over.T + np.diag(np.square(_ROUGH))
        distance = float(error @ np.linalg.solve(spread, error))
        return distance > self._config.filter.overruling_sigmas**2


def _most_agree(
    points: FloatArray, covariances: FloatArray, measured: Measured, config: FiducialFilterConfig
) -> tuple[FloatArray, int]:
    """The pose on which most fiducials agree, shape (4, 4), and how many; 0 for none."""
    gate = float(chdtri(3, 1.0 - config.fiducial_gate))
    try:
        found = find_pose(points, covariances, measured, gate, config.trials)
        if found is None:
            return np.eye(4), 0
        pose = invert_transform(found[0])
        inside = pose[:3, :3].T @ covariances @ pose[:3, :3]
        return pose, int(np.count_nonzero(agreeing(found[0], points, inside, measured, gate)))
    except np.linalg.LinAlgError:  # noise that vanishes in rounding beside what is not known
        return np.eye(4), 0
