"""Where the camera is: Fig. 9 of Sujan and Dubowsky (2005), doi:10.1177/0278364905051774.

Initialise against the target, or call the place where the camera begins the origin; then, for every
view: expect the motion, track the fiducials, solve and filter, ask whether the pose is certain
enough and whether new fiducials are needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    PinholeCamera,
    check_covariance,
    check_transform,
    invert_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter_records import Fiducials, KeptPoses
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.motion_prior import MotionPrior, free_motion
from infomap_ros.localization.range_view import RangeView
from infomap_ros.localization.recovery import Recovery
from infomap_ros.localization.scene_fiducials import SceneFiducials
from infomap_ros.localization.target import TargetDetector
from infomap_ros.localization.target_watch import TargetWatch, moved
from infomap_ros.mapping import VoxelMap

State = Literal["tracking", "coasting", "lost", "searching"]


@dataclass(frozen=True, eq=False)
class Localisation:
    """What is known of the camera at the stamp of a view.

    Attributes:
        stamp: of the view [ns].
        state: ``tracking``: the pose rests on this view; ``coasting``: on the expected motion
            since one before; ``lost``: it is not known; ``searching``: it was never known, because
            the target was not seen yet.
        T_map_camera: the pose, shape (4, 4); None when lost or searching.
        covariance: in the map frame, shape (6, 6); None likewise.
        reason: why it is not tracking, or what happened; empty where there is nothing to say.
        tracked: number of fiducials that the pose rests on.
        is_keyframe: whether the pose was kept, see `Localizer.keyframes`.
        target_seen: whether the target corrected the pose.
    """

    stamp: int
    state: State
    T_map_camera: FloatArray | None
    covariance: FloatArray | None
    reason: str = ""
    tracked: int = 0
    is_keyframe: bool = False
    target_seen: bool = False


class Localizer:
    """Follows a camera and says when it cannot.

    Args:
        camera: rectified left camera, or depth camera.
        config: parameters.
        detector: of the target, whose frame is the map; without one the map is where the camera
            begins.
        T_map_camera: where the camera begins, shape (4, 4), where there is no target; the identity
            where not given.
        covariance: of that pose in the map, shape (6, 6); zero where it defines the map.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        config: LocalizerConfig | None = None,
        detector: TargetDetector | None = None,
        T_map_camera: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
    ) -> None:
        self.config = config or LocalizerConfig()
        self._begin_at = np.eye(4) if T_map_camera is None else check_transform(T_map_camera)
        self._begin_covariance = (
            np.zeros((6, 6)) if covariance is None else check_covariance(covariance, 6)
        )
        self._filter = FiducialFilter(camera, self.config.filter)
        self._scene = SceneFiducials(camera, self.config, self._filter)
        self._watch = TargetWatch(detector, self.config)
        self._recovery = Recovery(camera, self.config, self._filter, self._scene)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next view initialises anew."""
        self._filter.start(self._begin_at, self._begin_covariance)
        self._scene.clear()
        self._watch.clear()
        self._state: State = "searching"
        self._stamp = self._fixed = -(2**62)
        self._keyframe = np.eye(4)
        self._step = (np.eye(4), 0.0)  # last motion and its duration [s]

    def keyframes(self) -> KeptPoses:
        """The kept poses as they are known now."""
        return self._filter.kept_poses()

    def fiducials(self) -> Fiducials:
        """The scene's fiducials as they are known now."""
        return self._filter.fiducials()

    def locate(
        self,
        view: RangeView,
        prior: MotionPrior | None = None,
        voxel_map: VoxelMap | None = None,
        *,
        keep: bool = False,
    ) -> Localisation:
        """Tell where the camera was when a view was taken.

        Args:
            view: later than those before.
            prior: of the camera's motion since the view before, from odometry and joints; None
                where nothing is known of it.
            voxel_map: for the certainty of new fiducials, eq. (19).
            keep: keep the pose as a keyframe wherever it is.

        Raises:
            InvalidInputError: the view is not later than the one before.
        """
        if view.stamp <= self._stamp:
            raise InvalidInputError("view", f"{view.stamp} ns is not later than {self._stamp} ns")
        if self._state == "searching":
            return self._initialise(view, voxel_map)
        before = self._filter.pose[0]
        tracked, reason = self._track(view, prior)
        sighted = self._watch.correct(view, self._filter, tracked > 0)
        if sighted == "contradicted":
            self._state = "searching"
            return self._initialise(view, voxel_map)
        self._judge(view, tracked > 0 or sighted == "corrected", prior is not None)
        self._note_step(view, before)
        self._replace_fiducials(view, tracked, voxel_map)
        return self._conclude(view, reason or self._watch.reason, tracked, sighted != "", keep)

    def _initialise(self, view: RangeView, voxel_map: VoxelMap | None) -> Localisation:
        """Against the target where there is one, else here is where the map begins."""
        pose, covariance = self._begin_at, self._begin_covariance
        if self._watch.exists:
            sighting = self._watch.sight(view)
            if sighting is None:
                self._stamp = view.stamp
                return Localisation(view.stamp, "searching", None, None, self._watch.reason)
            pose, covariance = sighting.camera_pose()
        self._filter.start(pose, covariance)
        self._scene.clear()
        self._scene.replenish(view, voxel_map)
        self._state, self._fixed, self._stamp = "tracking", view.stamp, view.stamp
        return self._conclude(view, "initialised", 0, self._watch.exists, True)

    def _track(self, view: RangeView, prior: MotionPrior | None) -> tuple[int, str]:
        """Expect the motion, track the fiducials, solve and filter; how many, or why not."""
        seconds = 1e-9 * (view.stamp - self._stamp)
        seen = self._scene.follow(view, self._expected_pose(prior, seconds))
        if self._state == "tracking" and self._scene.stands_still(seen, prior):
            return len(seen), ""
        if self._state != "lost":
            self._filter.predict(prior or free_motion(seconds, self.config.free_motion))
            update = self._filter.update(seen)
            if update.is_consistent:
                self._scene.note(seen, update)
                return len(update.used), ""
        return self._recovery.recover(view, seen, self._state == "lost")

    def _expected_pose(self, prior: MotionPrior | None, seconds: float) -> FloatArray | None:
        """Where to look for the fiducials, shape (4, 4): by the prior, or as the camera moved."""
        if self._state == "lost":
            return None
        pose = self._filter.pose[0]
        if prior is not None:
            return pose @ prior.T_before_after
        motion, duration = self._step
        steady = self._state == "tracking" and 0.5 * duration < seconds < 2.0 * duration
        return pose @ motion if steady else pose

    def _judge(self, view: RangeView, is_fixed: bool, is_informed: bool) -> None:
        """Is the localisation certain enough?"""
        if is_fixed:
            self._state, self._fixed = "tracking", view.stamp
            return
        coasted = 1e-9 * (view.stamp - self._fixed)
        certain = self._is_certain() and coasted <= self.config.max_coasting
        self._state = "coasting" if certain and self._state != "lost" else "lost"

    def _is_certain(self) -> bool:
        covariance = self._filter.pose[1]
        position, rotation = covariance[:3, :3], covariance[3:, 3:]
        limits = self.config.max_position_sigma**2, self.config.max_rotation_sigma**2
        largest = (float(np.linalg.eigvalsh(part)[-1]) for part in (position, rotation))
        return all(value <= limit for value, limit in zip(largest, limits, strict=True))

    def _note_step(self, view: RangeView, before: FloatArray) -> None:
        motion = invert_transform(before) @ self._filter.pose[0]
        self._step = (motion, 1e-9 * (view.stamp - self._stamp))
        self._stamp = view.stamp

    def _replace_fiducials(self, view: RangeView, tracked: int, voxel_map: VoxelMap | None) -> None:
        """Are new fiducials needed? Known ones that ought to be in view go first."""
        if self._state == "lost" or tracked >= self.config.fewest_fiducials:
            return
        if self._state == "coasting" and not self._recovery.may_go_on(view):
            self._state = "lost"
            return
        if self._state == "tracking":
            self._recovery.return_to_known(view)
        self._scene.replenish(view, voxel_map)

    def _conclude(
        self, view: RangeView, reason: str, tracked: int, target_seen: bool, keep: bool
    ) -> Localisation:
        if self._state == "lost":
            return Localisation(view.stamp, "lost", None, None, reason)
        pose, covariance = self._filter.pose
        is_keyframe = keep or moved(self._keyframe, pose, self.config)
        if is_keyframe:
            self._filter.keep_pose(view.stamp)
            self._keyframe = pose
        return Localisation(
            view.stamp, self._state, pose, covariance, reason, tracked, is_keyframe, target_seen
        )
