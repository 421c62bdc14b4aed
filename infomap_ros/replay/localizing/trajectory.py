"""Where the camera was at every view, as known then and as known in the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.records import KeptPoses


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses with their covariances.

    Attributes:
        stamps: shape (N,), int64 [ns], ascending.
        transforms: ``T_map_camera``, shape (N, 4, 4).
        covariances: in the map frame, shape (N, 6, 6).
    """

    stamps: NDArray[np.int64]
    transforms: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.stamps)


class TrajectoryRecorder:
    """Collects poses, and hangs each on the keyframe that is nearest before it.

    Keyframes are corrected later, by a known place or the target; what hangs on one follows it. A
    keyframe that is given up hangs on another one from then on.
    """

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._transforms: list[FloatArray] = []
        self._covariances: list[FloatArray] = []
        self._anchors: list[int] = []
        self._offsets: list[FloatArray] = []  # T_keyframe_camera
        self._given_up: dict[int, tuple[int, FloatArray]] = {}  # other keyframe, T_other_this
        self._kept: dict[int, FloatArray] = {}

    def add(self, stamp: int, pose: FloatArray, covariance: FloatArray, kept: KeptPoses) -> None:
        """Add a pose.

        Args:
            stamp: of the pose [ns].
            pose: ``T_map_camera``, shape (4, 4).
            covariance: in the map frame, shape (6, 6).
            kept: keyframes as they are known now; at least one.
        """
        now = dict(zip(kept.stamps.tolist(), kept.transforms, strict=True))
        for gone in self._kept.keys() - now.keys():
            other = min(self._kept.keys() & now.keys(), key=lambda one: abs(one - gone))
            offset = invert_transform(self._kept[other]) @ self._kept[gone]
            self._given_up[gone] = (other, offset)
        self._kept = now
        anchor = max(one for one in now if one <= stamp)
        self._stamps.append(stamp)
        self._transforms.append(pose)
        self._covariances.append(covariance)
        self._anchors.append(anchor)
        self._offsets.append(invert_transform(now[anchor]) @ pose)

    def known_then(self) -> Trajectory:
        """Each pose as it was known at its stamp."""
        return self._trajectory(self._transforms)

    def known_now(self) -> Trajectory:
        """Each pose after all corrections; the covariances are those of its stamp."""
        pairs = zip(self._anchors, self._offsets, strict=True)
        return self._trajectory([self._place(anchor) @ offset for anchor, offset in pairs])

    def _place(self, keyframe: int) -> FloatArray:
        if keyframe in self._kept:
            return self._kept[keyframe]
        other, offset = self._given_up[keyframe]
        return self._place(other) @ offset

    def _trajectory(self, transforms: list[FloatArray]) -> Trajectory:
        return Trajectory(
            np.array(self._stamps, dtype=np.int64),
            np.array(transforms).reshape(-1, 4, 4),
            np.array(self._covariances).reshape(-1, 6, 6),
        )
