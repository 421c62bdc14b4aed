"""A map that follows the poses of its scans as they are corrected."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PoseUncertainty,
    carry_covariance,
    check_covariance,
    check_transform,
    check_transforms,
    float_array,
)
from infomap_ros.geometry.pose_uncertainty import positive_part
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.correction.reintegration import (
    Reintegration,
    ReintegrationReport,
    moved_scans,
)
from infomap_ros.mapping.correction.scan_store import (
    ScanKey,
    ScanStore,
    ScanStoreConfig,
    forget_body,
)
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.mapping.voxel_map import VoxelMap


class CorrectableMap:
    """Integrates scans, receives corrected poses, and corrects the map a little at a time.

    Args:
        voxel_map: what it holds already stays where it is.
        store: how many scans are kept.
        config: when they follow.

    Attributes:
        voxel_map: the map.
        store: its scans.
    """

    def __init__(self, voxel_map: VoxelMap, store: ScanStoreConfig | None = None) -> None:
        self.voxel_map = voxel_map
        kept = store or ScanStoreConfig()
        base = voxel_map if kept.memory and voxel_map.known_voxels else None
        self.store = ScanStore(voxel_map.config, kept, base)
        self._corrections, self._covariances = PoseCorrections(), KeyframeCovariances()
        self._came: dict[ScanKey, FloatArray | None] = {}  # covariances of poses as they came
        self._work: Reintegration | None = None

    @property
    def is_correcting(self) -> bool:
        """Whether a correction has begun and is not finished."""
        return self._work is not None

    def memory_bytes(self) -> int:
        """Memory in use by the map and its scans [bytes]; the work on a correction not counted."""
        return self.voxel_map.memory_bytes() + self.store.memory_bytes()

    def integrate(
        self,
        stamp: int,
        points: ArrayLike,
        T_map_sensor: ArrayLike,
        covariances: ArrayLike | None = None,
        pose_covariance: ArrayLike | PoseUncertainty | None = None,
        camera: PinholeCamera | None = None,
        error_correlation: float | None = None,
        sensor: str = "",
    ) -> IntegrationReport:
        """Add a scan as `VoxelMap.integrate` does; of a `sensor` as `KeptScan` names it.

        Raises:
            InvalidInputError: as there.
            CapacityError: as there.
        """
        arguments = (points, T_map_sensor, covariances, pose_covariance, camera, error_correlation)
        report = self.store.integrate(self.voxel_map, stamp, *arguments, sensor)
        if self.store.config.memory:
            self._corrections.add(stamp, check_transform(T_map_sensor), sensor)
            self._came[stamp, sensor] = _covariance(pose_covariance)
        self._freeze()
        return report

    def receive_poses(
        self,
        as_of: int,
        stamps: ArrayLike,
        transforms: ArrayLike,
        covariances: ArrayLike | None = None,
    ) -> None:
        """Take corrected poses; see `PoseCorrections.receive_poses`.

        Args:
            as_of: the moment whose image was used last for them [ns].
            stamps: of the keyframes, shape (K,) [ns].
            transforms: T_map_sensor, shape (K, 4, 4).
            covariances: of the poses, shape (K, 6, 6); scans keep theirs where not given.

        Raises:
            InvalidInputError: a pose or a covariance is none, or the stamps do not fit.
        """
        if covariances is not None:
            self._covariances.receive_poses(as_of, stamps, transforms, covariances)
        self._corrections.receive_poses(as_of, stamps, transforms)

    def forget_body(
        self,
        solids: Sequence[PlacedSolid],
        config: BodyFilterConfig | None = None,
        ground: FloatArray | None = None,
    ) -> int:
        """Take a body out of the map and its scans that was not known when they were fused.

        A correction that has begun begins again.

        Args:
            solids: of the body, placed in the map.
            config: how far it is grown.
            ground: that on which it stands and which stays, as `body_removal.forget_body` takes it.

        Returns:
            Number of occupied voxels that are unknown now.
        """
        self.store.forget_body(solids, config, ground)
        forgotten = forget_body(self.voxel_map, solids, config, ground)
        if self._work is not None:
            self._work = None
            self.begin_correction()
        return forgotten

    def begin_correction(self) -> bool:
        """Begin to correct the map where scans belong elsewhere by now; whether there are any."""
        if self._work is None:
            moved = moved_scans(self.store, self._poses(), self.voxel_map)
            if moved:
                self._work = Reintegration(self.voxel_map, self.store, moved)
        return self._work is not None

    def correct_more(self) -> ReintegrationReport | None:
        """Do a part of the correction, as long as about one scan takes.

        Returns:
            What was done when this was the last part, else None.

        Raises:
            CapacityError: map and work do not fit into the memory limit. The correction is given
                up, the map is as it was.
        """
        work, self._work = self._work, None
        if work is None:
            return None
        if work.step():
            self._work = work
            return None
        report = work.finish()
        self._freeze()
        return report

    def correct(self) -> ReintegrationReport | None:
        """Correct the map at once; None where no scan belongs elsewhere.

        Raises:
            CapacityError: as `correct_more`.
        """
        report = None
        if self.begin_correction():
            while report is None:
                report = self.correct_more()
        return report

    def _poses(self) -> dict[ScanKey, tuple[FloatArray, FloatArray | None]]:
        """Where the scans belong by now, and how well that is known."""
        known = self._covariances
        return {
            key: (pose, known.of_scan(key[0], pose, self._came.get(key)))
            for key, (pose, _) in self._corrections.poses.items()
        }

    def _freeze(self) -> None:
        """Give up scans beyond the memory, but not while the map is being corrected."""
        if self._work is None and self.store.freeze_excess():
            self._corrections.keep_only(scan.key for scan in self.store)
            self._came = {scan.key: self._came.get(scan.key) for scan in self.store}


def _covariance(given: ArrayLike | PoseUncertainty | None) -> FloatArray | None:
    """Of a pose as a whole, shape (6, 6)."""
    if given is None:
        return None
    whole = given.covariance if isinstance(given, PoseUncertainty) else given
    return float_array(whole, "pose_covariance")


# The pose of a scan is that of the keyframe before it and a short way on. What the correction
# tells of the keyframe it tells of the scan; the short motion is as uncertain as it was:
#
#     C_scan = A C_keyframe,now A^T + max(C_scan,then - A C_keyframe,then A^T, 0)
#
# A carries an error of the keyframe's pose to the place of the scan, the maximum is that of the
# eigenvalues, and "then" is when the keyframe was first received.


class KeyframeCovariances:
    """Keeps the first and the last received pose of each keyframe."""

    def __init__(self) -> None:
        self._as_of = -(2**62)
        self._first: dict[int, FloatArray] = {}
        self._stamps: NDArray[np.int64] = np.zeros(0, np.int64)
        self._places, self._now = np.zeros((0, 3)), np.zeros((0, 6, 6))

    def receive_poses(
        self, as_of: int, stamps: ArrayLike, transforms: ArrayLike, covariances: ArrayLike
    ) -> None:
        """Poses of keyframes with their covariances; see `PoseCorrections.receive_poses`.

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
            None, for the one it had, where that is unknown or nothing was received.
        """
        if before is None or not len(self._stamps):
            return None
        place = max(int(np.searchsorted(self._stamps, stamp, side="right")) - 1, 0)
        lever = transform[:3, 3] - self._places[place]
        now, then = self._now[place], self._first[int(self._stamps[place])]
        return carry_covariance(now, lever) + positive_part(before - carry_covariance(then, lever))


# Localization corrects the poses of keyframes; scans are taken at other moments too. Between two
# keyframes a scan is tied to the one before it: it moves as that one does, and what was measured
# between the two stays as it was. A keyframe that localization no longer keeps moves as the
# nearest one before it that it keeps, or else the first one after it. So do scans of the robot's
# other sensors: the motion is one in the frame of the map.

_HISTORY = 50


class _Keyframes(NamedTuple):
    """What was received: poses of keyframes, and the moment at which they were so."""

    as_of: int
    stamps: NDArray[np.int64]
    transforms: FloatArray


class _Correction(NamedTuple):
    """How keyframes moved: ``T_new = motion @ T_old``, and the poses that they have now."""

    as_of: int
    stamps: NDArray[np.int64]
    motions: FloatArray
    transforms: FloatArray

    def apply(self, key: ScanKey, transform: FloatArray) -> FloatArray:
        """The pose of a scan that was taken before the correction, after it."""
        stamp, sensor = key
        place = int(np.searchsorted(self.stamps, stamp, side="right")) - 1
        if place >= 0 and self.stamps[place] == stamp and not sensor:
            return self.transforms[place]
        return np.asarray(self.motions[max(place, 0)] @ transform)


class PoseCorrections:
    """Keeps poses of scans up to date with the poses of keyframes."""

    def __init__(self) -> None:
        self._latest: _Keyframes | None = None
        self._history: deque[_Correction] = deque(maxlen=_HISTORY)
        self._poses: dict[ScanKey, FloatArray] = {}

    @property
    def poses(self) -> dict[ScanKey, tuple[FloatArray, None]]:
        """T_map_sensor of each scan, as `moved_scans` takes it."""
        return {key: (transform, None) for key, transform in self._poses.items()}

    def add(self, stamp: int, transform: FloatArray, sensor: str = "") -> None:
        """A scan, with the pose that was given for its stamp.

        The pose is from before the corrections of later moments that were received already.

        Args:
            stamp: of the scan [ns].
            transform: T_map_sensor, shape (4, 4).
            sensor: as of `KeptScan`.
        """
        key = stamp, sensor
        for correction in self._history:
            if correction.as_of > stamp:
                transform = correction.apply(key, transform)
        self._poses[key] = transform

    def keep_only(self, keys: Iterable[ScanKey]) -> None:
        """Forget all scans but these."""
        self._poses = {key: self._poses[key] for key in keys if key in self._poses}

    def receive_poses(self, as_of: int, stamps: ArrayLike, transforms: ArrayLike) -> None:
        """Poses of keyframes.

        When `as_of` goes backwards (a bag starts again), what was received before is of no use any
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
        latest = _Keyframes(as_of, moments[order], poses[order])
        before, self._latest = self._latest, latest
        if before is None:
            return
        if as_of < before.as_of:
            self._history.clear()
            return
        correction = _correction(before, latest)
        if correction is not None:
            self._correct(correction)

    def _correct(self, correction: _Correction) -> None:
        self._history.append(correction)
        for key, transform in self._poses.items():
            if key[0] < correction.as_of:
                self._poses[key] = correction.apply(key, transform)


def _correction(before: _Keyframes, after: _Keyframes) -> _Correction | None:
    """How the keyframes that both know have moved; None where none has."""
    stamps, old, new = np.intersect1d(
        before.stamps, after.stamps, assume_unique=False, return_indices=True
    )
    if not len(stamps) or np.array_equal(before.transforms[old], after.transforms[new]):
        return None
    motions = after.transforms[new] @ np.linalg.inv(before.transforms[old])
    return _Correction(after.as_of, stamps, motions, after.transforms[new])
