"""Where scans belong, from corrected poses of some moments.

Localization corrects the poses of keyframes; scans are taken at other moments too. Between two
keyframes a scan is tied to the one before it: it moves as that one does, and what was measured
between the two stays as it was. A keyframe that localization no longer keeps moves as the nearest
one before it that it keeps, or else the first one after it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transforms
from infomap_ros.geometry.transforms import FloatArray

_HISTORY = 50


class _Keyframes(NamedTuple):
    """What was heard: poses of keyframes, and the moment at which they were so."""

    as_of: int
    stamps: NDArray[np.int64]
    transforms: FloatArray


class _Correction(NamedTuple):
    """How keyframes moved: ``T_new = motion @ T_old``, and the poses that they have now."""

    as_of: int
    stamps: NDArray[np.int64]
    motions: FloatArray
    transforms: FloatArray

    def apply(self, stamp: int, transform: FloatArray) -> FloatArray:
        """The pose of a scan that was taken before the correction, after it."""
        place = int(np.searchsorted(self.stamps, stamp, side="right")) - 1
        if place >= 0 and self.stamps[place] == stamp:
            return self.transforms[place]
        return np.asarray(self.motions[max(place, 0)] @ transform)


class PoseCorrections:
    """Keeps poses of scans up to date with the poses of keyframes."""

    def __init__(self) -> None:
        self._heard: _Keyframes | None = None
        self._history: deque[_Correction] = deque(maxlen=_HISTORY)
        self._poses: dict[int, FloatArray] = {}

    @property
    def poses(self) -> dict[int, tuple[FloatArray, None]]:
        """T_map_sensor of each scan by its stamp, as `reintegrate` takes it."""
        return {stamp: (transform, None) for stamp, transform in self._poses.items()}

    def add(self, stamp: int, transform: FloatArray) -> None:
        """A scan, with the pose that was told for its stamp.

        The pose is from before the corrections of later moments that were heard already.

        Args:
            stamp: of the scan [ns].
            transform: T_map_sensor, shape (4, 4).
        """
        for correction in self._history:
            if correction.as_of > stamp:
                transform = correction.apply(stamp, transform)
        self._poses[stamp] = transform

    def keep_only(self, stamps: Iterable[int]) -> None:
        """Forget all scans but these."""
        self._poses = {stamp: self._poses[stamp] for stamp in stamps if stamp in self._poses}

    def hear(self, as_of: int, stamps: ArrayLike, transforms: ArrayLike) -> None:
        """Poses of keyframes.

        When `as_of` goes backwards (a bag starts again), what was heard before is of no use any
        more; scans stay where they are.

        Args:
            as_of: the moment whose image was used last for them [ns].
            stamps: of the keyframes, shape (K,) [ns].
            transforms: T_map_sensor, shape (K, 4, 4).

        Raises:
            InvalidInputError: a pose is none, or the stamps do not fit.
        """
        moments = np.asarray(stamps, np.int64)
        poses = check_transforms(transforms, "keyframe poses")
        if moments.shape != (len(poses),):
            raise InvalidInputError("keyframe stamps", f"shape {moments.shape}, {len(poses)} poses")
        order = np.argsort(moments, kind="stable")
        heard = _Keyframes(as_of, moments[order], poses[order])
        before, self._heard = self._heard, heard
        if before is None:
            return
        if as_of < before.as_of:
            self._history.clear()
            return
        correction = _correction(before, heard)
        if correction is not None:
            self._correct(correction)

    def _correct(self, correction: _Correction) -> None:
        self._history.append(correction)
        for stamp, transform in self._poses.items():
            if stamp < correction.as_of:
                self._poses[stamp] = correction.apply(stamp, transform)


def _correction(before: _Keyframes, after: _Keyframes) -> _Correction | None:
    """How the keyframes that both know have moved; None where none has."""
    stamps, old, new = np.intersect1d(
        before.stamps, after.stamps, assume_unique=False, return_indices=True
    )
    if not len(stamps) or np.array_equal(before.transforms[old], after.transforms[new]):
        return None
    motions = after.transforms[new] @ np.linalg.inv(before.transforms[old])
    return _Correction(after.as_of, stamps, motions, after.transforms[new])
