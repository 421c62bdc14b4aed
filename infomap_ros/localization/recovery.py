"""Finding back: to known places, after tracking has failed, and after the camera was lost."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.localization.consensus import agreeing, find_pose
from infomap_ros.localization.fiducial_filter import FiducialFilter
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.observations import FiducialObservations
from infomap_ros.localization.range_view import RangeView
from infomap_ros.localization.scene_fiducials import SceneFiducials, joined
from infomap_ros.localization.sight import Measured

_SIGMAS = 3.0  # of the pose, within which a fiducial is looked for
_EXPECTED = 15  # fiducials that ought to be in view, from which on their absence says something


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
        found = self._scene.recall_anywhere(view)
        every = joined(seen, found)
        if is_lost and self._count_agreeing(every) < self._config.recovery_fiducials:
            self._scene.drop(found.ids)
            return 0, f"{len(found)} known fiducials recognised, not enough agree"
        update = self._filter.update(every)
        if not update.is_consistent:
            self._scene.drop(found.ids)
            return 0, update.reason
        self._scene.note(every, update)
        return len(update.used), "found again" if is_lost else ""

    def return_to_known(self, view: RangeView) -> int:
        """Use known fiducials that ought to be in view but are not followed: removes drift.

        Returns:
            Number of those found.
        """
        pose, covariance = self._filter.pose
        found = self._scene.recall(view, pose, self._search_radius(covariance))
        if not len(found):
            return 0
        update = self._filter.update(found)
        self._scene.note(found, update)
        if not update.is_consistent:
            self._scene.drop(found.ids)
        return len(update.used)

    def may_go_on(self, view: RangeView) -> bool:
        """Whether a pose that rests on the expected motion alone may be built upon.

        Where known fiducials ought to be in view, and the view shows enough to choose others, but
        tracking and recognition did not find them, the camera is not where it is thought to be.
        """
        known = self._filter.fiducials()
        expected = self._scene.expected_in_view(known, self._filter.pose[0])
        if np.count_nonzero(expected) < _EXPECTED:
            return True
        return not self._scene.shows_enough(view)

    def _search_radius(self, covariance: np.ndarray) -> float:
        """How far from its expected place a fiducial at the mean distance may appear [px]."""
        known = self._filter.fiducials()
        away = np.linalg.norm(known.positions - self._filter.pose[0][:3, 3], axis=1)
        distance = float(np.median(away)) if len(away) else 1.0
        position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1]) ** 0.5
        rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) ** 0.5
        angle = _SIGMAS * float(np.hypot(position / max(distance, 0.1), rotation))
        return min(self._camera.fx * angle + 4.0, 0.25 * self._camera.width)

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
        pose = find_pose(points, covariances, measured, gate, self._config.filter.trials)
        if pose is None:
            return 0
        turn = invert_transform(pose)[:3, :3]
        inside = turn.T @ covariances @ turn
        return int(np.count_nonzero(agreeing(pose, points, inside, measured, gate)))
