"""Scans become a map, and the map follows what becomes known of their poses. For one thread."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import FrameError, InvalidInputError
from infomap_ros.exploration.team.teammate_places import BodyInScan, on_bodies
from infomap_ros.geometry import (
    Box,
    PlacedSolid,
    PointCloudRecord,
    float_array,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.correction.reintegration import ReintegrationReport
from infomap_ros.mapping.correction.scan_store import ScanStore, ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.messages.motions import KeyframePoses
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.team.replica import moved_map

_MOST_WAITING = 20
"""Corrections that wait for the one at hand; beyond that the oldest is left out, as a later one
gives the poses of all keyframes anew."""
_NO_SCANS = ScanStoreConfig(memory=0.0)
_AS_IT_IS = BodyFilterConfig(margin=0.0, sigmas=0.0)  # a body that is not grown


class MapBuilder:
    """Fuses scans without the bodies of robots, and corrects the map by keyframes.

    A correction is carried out in full before the next one is looked at, so that the map does not
    depend on how long it takes.

    Args:
        voxel_map: what it holds already stays where it is.
        store: how many scans are kept, None for none.
        body: how far bodies are grown.
        assumed: covariance of poses that have none.

    Attributes:
        points_cut: number of points that were left out as they may lie on a robot.
        assumed_poses: number of poses whose covariance was assumed.
        corrections: number of corrections that moved scans.
    """

    def __init__(
        self,
        voxel_map: VoxelMap,
        store: ScanStoreConfig | None = None,
        body: BodyFilterConfig | None = None,
        assumed: AssumedPoseConfig | None = None,
    ) -> None:
        self._store = store
        self._body, self._assumed = body or BodyFilterConfig(), assumed or AssumedPoseConfig()
        self._keyframes: deque[KeyframePoses] = deque(maxlen=_MOST_WAITING)
        self._last: KeyframePoses | None = None
        self.points_cut = self.assumed_poses = self.corrections = 0
        self.replace(voxel_map)

    @property
    def map(self) -> VoxelMap:
        """The map as it is now."""
        self._corrected.voxel_map.origin = self._origin
        return self._corrected.voxel_map

    @property
    def scans(self) -> ScanStore:
        """The scans that are kept."""
        return self._corrected.store

    @property
    def keeps_scans(self) -> bool:
        """Whether scans are kept, so that corrections can move them."""
        return self._store is not None

    def keep_scans(self, store: ScanStoreConfig) -> None:
        """Keep scans from now on."""
        self._store = store
        self.replace(self.map)

    def replace(self, voxel_map: VoxelMap) -> None:
        """Go on with another map, whose content stays where it is.

        Where it names its origin, only poses of that origin are fused from now on; else the first
        pose that names one does it.
        """
        self._origin, self._last = voxel_map.origin, None
        store = self._store or _NO_SCANS
        self._corrected = CorrectableMap(voxel_map, store)
        self._keyframes.clear()

    def fuse(self, scan: Scan[PointCloudRecord]) -> IntegrationReport:
        """Add a scan.

        Raises:
            FrameError: its pose is in a map of another origin.
            InfomapError: the scan cannot be used; the map is as before.
        """
        cloud, pose = scan.cloud, scan.pose
        origin = 0 if pose.uncertainty is None else pose.uncertainty.origin
        self._check_origin("camera_pose", origin)
        points = self.without_bodies(cloud, scan)
        camera = fit_pinhole_camera(points) if points.ndim == 3 else None
        covariance = pose.covariance if pose.uncertainty is None else pose.uncertainty
        if covariance is None:
            covariance = self._assumed.covariance()
            self.assumed_poses += 1
        report = self._corrected.integrate(
            cloud.stamp,
            points,
            pose.transform,
            cloud.covariances,
            covariance,
            camera,
            cloud.error_correlation,
            pose.child_frame_id,
        )
        self._origin = self._origin or origin
        return report

    def forget_body(self, body: BodyInScan) -> int:
        """Take a teammate's body, placed in the map, out of what was fused before it was known.

        Returns:
            Number of occupied voxels that are unknown now.
        """
        grown = replace(self._body, margin=body.margin)
        return self._corrected.forget_body(body.solids, grown, body.ground)

    def clear_region(self, low: ArrayLike, high: ArrayLike) -> int:
        """Take what is occupied in a box out of the map, and the points in it out of its scans.

        Args:
            low: smallest x, y, z of the box, shape (3,) [m, map].
            high: largest x, y, z, shape (3,) [m, map].

        Returns:
            Number of occupied voxels that are unknown now.

        Raises:
            InvalidInputError: the box is empty or not finite.
        """
        first, last = float_array(low, "low"), float_array(high, "high")
        if not (np.isfinite([first, last]).all() and (first < last).all()):
            text = f"from {first.tolist()} to {last.tolist()}, expected finite, growing corners"
            raise InvalidInputError("region", text)
        x, y, z = (float(edge) for edge in last - first)
        box = PlacedSolid(Box((x, y, z)), make_transform(np.eye(3), 0.5 * (first + last)))
        return self._corrected.forget_body([box], _AS_IT_IS)

    @property
    def is_correcting(self) -> bool:
        """Whether scans are being put elsewhere, or it is to be seen whether they have to be."""
        return self._corrected.is_correcting or bool(self._keyframes)

    def add_keyframes(self, keyframes: KeyframePoses) -> None:
        """Take the poses of all keyframes as they are known now; `correct_more` acts on them.

        Where the same keyframes are given in another frame, all of the map is moved there at once.

        Raises:
            CapacityError: there is no room to move the map; it is as before.
            FrameError: they are in a map of another origin.
            InvalidInputError: a pose or a covariance is none, or the stamps do not fit.
        """
        if keyframes.origin != self._origin and (move := self._move_to(keyframes)) is not None:
            self._change_frame(keyframes, move)
            return
        self._check_origin("keyframe_poses", keyframes.origin)
        self._last = keyframes
        self._keyframes.append(keyframes)
        self._begin_correction()

    def _move_to(self, keyframes: KeyframePoses) -> FloatArray | None:
        """How the map has moved, by the newest keyframe known in both frames; None without one."""
        last = self._last
        if last is None or not self._origin or not keyframes.origin:
            return None
        _, old, new = np.intersect1d(last.stamps, keyframes.stamps, return_indices=True)
        if not len(old):
            return None
        T_old_camera, T_new_camera = last.transforms[old[-1]], keyframes.transforms[new[-1]]
        return np.asarray(T_new_camera @ invert_transform(T_old_camera))

    def _change_frame(self, keyframes: KeyframePoses, T_new_old: FloatArray) -> None:
        """Put the map into the frame of keyframes; no scan comes in between.

        Scans follow their keyframes; where some are not kept any more, the voxels move as they are.
        """
        corrected = self._corrected
        if self.keeps_scans and not self.scans.base.known_voxels:
            self.correct()
            corrected.receive_poses(
                keyframes.stamp, keyframes.stamps, keyframes.transforms, keyframes.covariances
            )
            corrected.correct()
        else:
            moved = moved_map(self.map, T_new_old)
            moved.sessions = self.map.sessions
            self.replace(moved)
        self.corrections += 1
        self._origin, self._last = keyframes.origin, keyframes

    def correct_more(self) -> ReintegrationReport | None:
        """Do a part of the correction, as long as about one scan takes.

        Returns:
            What was done when this was the last part of a correction, else None.

        Raises:
            CapacityError: it does not fit into memory; the map is as before.
        """
        report = self._corrected.correct_more()
        if report is not None:
            self.corrections += 1
            self._corrected.begin_correction()  # of scans that came late
        self._begin_correction()
        return report

    def correct(self, most: int | None = None) -> None:
        """Carry out all corrections; raises as `correct_more`.

        Args:
            most: number of parts after which the rest is left for later.
        """
        for _ in count() if most is None else range(most):
            if not self.is_correcting:
                break
            self.correct_more()

    def _begin_correction(self) -> None:
        """Look at all keyframes that were given meanwhile: the newest poses count."""
        if self._corrected.is_correcting or not self._keyframes:
            return
        while self._keyframes:
            new = self._keyframes.popleft()
            self._corrected.receive_poses(new.stamp, new.stamps, new.transforms, new.covariances)
        self._corrected.begin_correction()

    def _check_origin(self, what: str, origin: int) -> None:
        """Refuse poses that are not in this map.

        Raises:
            FrameError: they are not, or do not say it although those before did.
        """
        if self._origin and origin != self._origin:
            named = f"the map of origin {origin:08x}" if origin else "a map of unknown origin"
            raise FrameError(
                f"{what} in {named}, this map's origin is {self._origin:08x}; "
                "a reset begins it anew, localization's resume goes on in it"
            )

    def without_bodies(self, cloud: PointCloudRecord, scan: Scan[Any]) -> NDArray[np.float32]:
        """The points of a scan's cloud, NaN where they may lie on a robot."""
        if not scan.body and not scan.teammates:
            return cloud.points
        on_body = body_mask(cloud.points, cloud.covariances, scan.body, self._body, rays=True)
        on_body |= on_bodies(cloud.points, cloud.covariances, scan.teammates, self._body)
        if not on_body.any():
            return cloud.points
        self.points_cut += int(on_body.sum())
        points = cloud.points.copy()
        points[on_body] = np.nan
        return points
