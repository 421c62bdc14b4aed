"""Finding back: to known places, after tracking has failed, and after the camera was lost."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.consensus import agreeing, find_pose
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.sight import Measured
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.scene_fiducials import SceneFiducials, joined

_SIGMAS = 3.0  # of the pose, within which a fiducial is looked for
_ANYWHERE = 0.2  # of the image's width, a search radius beyond which all of it is searched
_EXPECTED = 10  # fiducials that ought to be seen, from which on their absence says something
_HIDDEN = 0.34  # of a contradiction, when what is missed may be hidden
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

    def recover(
        self, view: RangeView, seen: FiducialObservations, is_lost: bool
    ) -> tuple[int, str]:
        """Find the pose again by all fiducials that can be recognised in a view.

        Args:
            view: that was tracked last, in vain.
            seen: what tracking has found.
            is_lost: the pose may be any; then more fiducials have to agree.

        Returns:
            Number of fiducials that the pose rests on, 0 and the reason where it was not found.
        """
        pose, covariance = self._filter.pose
        radius = self._search_radius(covariance)
        reason = "no known fiducial recognised"
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
        return 0, reason

    def _update(self, every: FiducialObservations, is_lost: bool) -> tuple[int, str]:
        if is_lost and self._count_agreeing(every) < self._config.recovery_fiducials:
            return 0, f"{len(every)} known fiducials recognised, not enough agree"
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
        radius = min(self._search_radius(covariance), 0.25 * self._camera.width)
        found = self._scene.recall(view, pose, radius)
        if not len(found):
            return 0
        update = self._filter.update(found)
        self._scene.set_aside(np.setdiff1d(found.ids, update.used))
        return len(update.used)

    def contradiction(self, view: RangeView, seen: FiducialObservations) -> float:
        """How much a view speaks against where the camera is thought to be.

        Fiducials ought to be seen, by where they are and from where they were seen before, but
        neither tracking nor recognition has found them.

        Args:
            view: the last one.
            seen: what tracking has found.

        Returns:
            1, or less where something nearer may hide them; 0 where nothing speaks against it.
        """
        wanted, hidden = self._scene.ought_to_be_seen(view, self._filter.pose[0])
        if len(wanted) < _EXPECTED or np.isin(wanted, seen.ids).mean() >= _FOUND:
            return 0.0
        if not self._scene.shows_enough(view):
            return 0.0
        return _HIDDEN if hidden.mean() > 0.5 else 1.0

    def _search_radius(self, covariance: FloatArray) -> float:
        """How far from its expected place a fiducial at the mean distance may appear [px]."""
        known = self._filter.fiducials()
        away = np.linalg.norm(known.positions - self._filter.pose[0][:3, 3], axis=1)
        distance = float(np.median(away)) if len(away) else 1.0
        position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1]) ** 0.5
        rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) ** 0.5
        angle = _SIGMAS * float(np.hypot(position / max(distance, 0.1), rotation))
        return self._camera.fx * angle + 4.0

    def _count_agreeing(self, observations: FiducialObservations) -> int:
        """How many fiducials agree on one pose, wherever that is."""
        known = self._filter.fiducials()
        held = np.isin(observations.ids, known.ids)
        if np.count_nonzero(held) < self._config.recovery_fiducials:
            return 0
        chosen = observations.select(held)
        order = np.argsort(known.ids)
        rows = order[np.searchsorted(known.ids, chosen.ids, sorter=order)]
        measured = Measured.of(self._camera, chosen)
        points, covariances = known.positions[rows], known.covariances[rows]
        gate = float(chdtri(3, 1.0 - self._config.filter.fiducial_gate))
        found = find_pose(points, covariances, measured, gate, self._config.filter.trials)
        if found is None:
            return 0
        pose, _ = found
        turn = invert_transform(pose)[:3, :3]
        inside = turn.T @ covariances @ turn
        return int(np.count_nonzero(agreeing(pose, points, inside, measured, gate)))
