"""When the poses of keyframes are worth being sent: where there is a new one, or one has moved."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.filter.config import KeptPoses
from infomap_ros.localization.localized_camera import LocalizedCamera

LEAST_CORRECTION = 0.002  # [m], and as many radians


class KeyframeChanges:
    """Remembers the poses that were given out last.

    Args:
        min_correction: smallest motion of a keyframe that matters [m], or turn [rad].
    """

    def __init__(self, min_correction: float = LEAST_CORRECTION) -> None:
        self._min_correction = min_correction
        self._last: KeptPoses | None = None

    def after(self, result: LocalizedCamera, kept: KeptPoses | None) -> KeptPoses | None:
        """The keyframes after a view, where they have changed since they were given out last."""
        if kept is None or not len(kept):
            return None
        if result.is_keyframe or self._last is None or self._have_moved(self._last, kept):
            self._last = kept
            return kept
        return None

    def _have_moved(self, before: KeptPoses, now: KeptPoses) -> bool:
        _, old, new = np.intersect1d(before.stamps, now.stamps, return_indices=True)
        change = now.transforms[new] - before.transforms[old]
        distance = np.linalg.norm(change[:, :3, 3], axis=1).max(initial=0.0)
        angle = np.linalg.norm(change[:, :3, :3], axis=(1, 2)).max(initial=0.0) / np.sqrt(2.0)
        return bool(max(distance, angle) > self._min_correction)
