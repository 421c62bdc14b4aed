"""How well the pose of a scan is known after its keyframes were corrected.

The pose of a scan is that of the keyframe before it and a short way on. What the correction tells
of the keyframe it tells of the scan; the short way is as uncertain as it was:

    C_scan = A C_keyframe,now A^T + max(C_scan,then - A C_keyframe,then A^T, 0)

A carries an error of the keyframe's pose to the place of the scan, the maximum is that of the
eigenvalues, and "then" is when the keyframe was first heard of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import carry_covariance, check_covariance, check_transforms
from infomap_ros.geometry.pose_uncertainty import positive_part
from infomap_ros.geometry.transforms import FloatArray


class KeyframeCovariances:
    """Keeps what was first and what was last heard of each keyframe."""

    def __init__(self) -> None:
        self._as_of = -(2**62)
        self._first: dict[int, FloatArray] = {}
        self._stamps: NDArray[np.int64] = np.zeros(0, np.int64)
        self._places, self._now = np.zeros((0, 3)), np.zeros((0, 6, 6))

    def hear(
        self, as_of: int, stamps: ArrayLike, transforms: ArrayLike, covariances: ArrayLike
    ) -> None:
        """Poses of keyframes with their covariances; see `PoseCorrections.hear`.

        Args:
            as_of: the moment whose image was used last for them [ns].
            stamps: of the keyframes, shape (K,) [ns].
            transforms: T_map_sensor, shape (K, 4, 4).
            covariances: of the poses, in the map frame, shape (K, 6, 6).

        Raises:
            InvalidInputError: a pose or a covariance is none, or their numbers differ.
        """
        moments = np.asarray(stamps, np.int64)
        poses = check_transforms(transforms, "keyframe poses")
        given = np.asarray(covariances, np.float64)
        if moments.shape != (len(poses),) or given.shape != (len(poses), 6, 6):
            counts = f"{moments.shape} stamps, {given.shape}, {len(poses)} poses"
            raise InvalidInputError("keyframe covariances", counts)
        checked = [check_covariance(each, 6, "covariance of a keyframe") for each in given]
        if as_of < self._as_of:
            self._first.clear()
        self._as_of, order = as_of, np.argsort(moments, kind="stable")
        self._stamps, self._places = moments[order], poses[order, :3, 3]
        self._now = np.array(checked).reshape(-1, 6, 6)[order]
        for stamp, covariance in zip(self._stamps.tolist(), self._now, strict=True):
            self._first.setdefault(stamp, covariance)

    def of_scan(
        self, stamp: int, transform: FloatArray, before: FloatArray | None
    ) -> FloatArray | None:
        """The covariance of a scan's corrected pose, shape (6, 6).

        Args:
            stamp: of the scan [ns].
            transform: its corrected pose T_map_sensor, shape (4, 4).
            before: covariance of its pose as it came, shape (6, 6).

        Returns:
            None, for the one it had, where that is unknown or nothing was heard.
        """
        if before is None or not len(self._stamps):
            return None
        place = max(int(np.searchsorted(self._stamps, stamp, side="right")) - 1, 0)
        lever = transform[:3, 3] - self._places[place]
        now, then = self._now[place], self._first[int(self._stamps[place])]
        return carry_covariance(now, lever) + positive_part(before - carry_covariance(then, lever))
