"""Where the camera is: Fig. 9 of Sujan and Dubowsky (2005), doi:10.1177/0278364905051774.

Initialize against the target, or call the place where the camera begins the origin; then, for every
view: expect the motion, track the fiducials, solve and filter, ask whether the pose is certain
enough and whether new fiducials are needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    check_covariance,
    check_transform,
    invert_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.config import Fiducials, FilterUpdate, KeptPoses
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import FreeMotion
from infomap_ros.localization.filter.hypothesis_choice import CONTRADICTION, AdaptiveNoise
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localized_camera import Choice, LocalizedCamera, State
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.recovery import Recovery
from infomap_ros.localization.scene_fiducials import SceneFiducials
from infomap_ros.localization.target.scene_tags import SceneTags
from infomap_ros.localization.target.target import TargetDetector
from infomap_ros.localization.target.watch import MAX_ROTATION_SIGMA, TargetWatch, is_certain, moved
from infomap_ros.mapping import VoxelMap


class KnownMap:
    """The part of a localizer that is asked what it knows.

    Args:
        pose_filter: holds poses and fiducials.
        scene: holds how fiducials look and from where they were seen.
    """

    def __init__(self, pose_filter: FiducialFilter, scene: SceneFiducials) -> None:
        self._filter, self._scene = pose_filter, scene

    def keyframes(self) -> KeptPoses:
        """The kept poses as they are known now."""
        return self._filter.kept_poses()

    def forget_keyframes(self) -> None:
        """Forget the kept poses, as when the clock that they were stamped by is no more."""
        self._filter.forget_poses(self._filter.kept_poses().stamps)

    def fiducials(self) -> Fiducials:
        """The scene's fiducials as they are known now."""
        return self._filter.fiducials()

    def move_map(self, T_new_old: FloatArray, covariance: FloatArray) -> None:
        """Put the map's frame elsewhere, as when it is learnt where a teammate's map lies.

        Args:
            T_new_old: the frame as it was, in the new one, shape (4, 4).
            covariance: of that, in the new frame, shape (6, 6).

        Raises:
            InvalidInputError: the transform is not rigid, or the covariance is none.
        """
        transform = check_transform(T_new_old, "T_new_old")
        self._filter.move(transform, check_covariance(covariance, 6))
        self._scene.move(transform)


_LEAST_VARIANCE = 1e-10  # of a given pose [m^2 and rad^2], as who points at a plan gives no height
_ANYWHERE = (3.0, 3.0, 3.0, 1.0, 1.0, 1.0)  # sigmas of the motion of a camera that is lost [m, rad]
# Views in a row in which fiducials ought to be seen and are not, after which the camera is lost.
_MAX_CONTRADICTED_VIEWS = 3
# Sigmas are enlarged by at most this factor where fiducials disagree by more than their sigmas, as
# with imperfect calibration.
_MAX_NOISE_FACTOR = 8.0


class Localizer(KnownMap):
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
        given = np.zeros((6, 6)) if covariance is None else covariance
        self._begin_covariance = check_covariance(given, 6)
        pose_filter = FiducialFilter(camera, self.config.filter)
        tags = SceneTags(self.config.scene_tags, getattr(detector, "board", None))
        super().__init__(pose_filter, SceneFiducials(camera, self.config, pose_filter, tags))
        self._watch = TargetWatch(detector)
        self._recovery = Recovery(camera, self.config, self._filter, self._scene)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next view initializes anew."""
        self._filter.start(self._begin_at, self._begin_covariance)
        self._scene.clear()
        self._watch.clear()
        self._state: State = "searching"
        self._stamp = self._fixed = -(2**62)
        self._keyframe = self._recalled = np.eye(4)
        self._free_motion = FreeMotion()
        self._coasted, self._contradicted = 0, 0.0  # views in a row
        self._is_resumed = False
        self._noise = AdaptiveNoise(_MAX_NOISE_FACTOR)

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that it knows, as arrays that can be written to a file; see `resume`."""
        own = {
            "stamp": np.array(self._stamp),
            "was_known": np.array(self._state in ("tracking", "coasting")),
            "was_placed": np.array(self._state != "searching"),
            "keyframe": self._keyframe,
        }
        of_filter = {f"filter_{name}": array for name, array in self._filter.state().items()}
        return own | self._scene.state() | of_filter

    def resume(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on in the map of a localizer that was ended.

        With a prior of the motion since its last view, the next view goes on from its pose; without
        one the camera counts as lost until it is found by appearance or by the target.

        Args:
            state: of that localizer's `state`; made with the same configuration.

        Raises:
            InvalidInputError: it does not fit this localizer's configuration.
        """
        self.reset()
        if not bool(state["was_placed"]):
            return
        filter_state = {
            name.removeprefix("filter_"): array
            for name, array in state.items()
            if name.startswith("filter_")
        }
        self._filter.resume(filter_state)
        self._scene.resume(state)
        self._keyframe = self._recalled = np.array(state["keyframe"])
        self._stamp = self._fixed = int(state["stamp"])
        self._state, self._is_resumed = "coasting", True
        if not bool(state["was_known"]):
            self._lose()

    def move_map(self, T_new_old: FloatArray, covariance: FloatArray) -> None:
        """Put the map's frame elsewhere; see `KnownMap.move_map`.

        Raises:
            InvalidInputError: as there, or the map's frame is that of the target.
        """
        if self._watch.exists:
            raise InvalidInputError("T_new_old", "the map is the target's, which stays")
        super().move_map(T_new_old, covariance)
        self._keyframe, self._recalled = T_new_old @ self._keyframe, T_new_old @ self._recalled

    @property
    def is_lost(self) -> bool:
        """Whether it has a map in which it does not know where the camera is."""
        return self._state == "lost"

    @property
    def last_pose(self) -> FloatArray:
        """Where the camera was taken to be last, shape (4, 4) [map]."""
        return self._filter.pose[0]

    def place_camera(self, T_map_camera: ArrayLike, covariance: ArrayLike) -> None:
        """Take from a user where a camera is that was lost; fiducials that it sees correct it.

        Args:
            T_map_camera: at the last view, shape (4, 4).
            covariance: of that, shape (6, 6).

        Raises:
            InvalidInputError: that is no pose, or one so uncertain that the camera stays lost.
        """
        pose = check_transform(T_map_camera, "T_map_camera")
        given = check_covariance(covariance, 6)
        if not is_certain(given, self.config):
            limits = self.config.max_position_sigma, MAX_ROTATION_SIGMA
            words = f"beyond max_position_sigma {limits[0]} m or {limits[1]} rad of rotation"
            raise InvalidInputError("covariance", f"is {words}, so the camera would stay lost")
        known = given + _LEAST_VARIANCE * np.eye(6)
        self._filter.predict(MotionPrior(invert_transform(self._filter.pose[0]) @ pose, known))
        self._filter.observe_pose(pose, known)
        self._state, self._fixed = "coasting", self._stamp
        self._coasted, self._contradicted = 0, 0.0

    def locate(
        self,
        view: RangeView,
        prior: MotionPrior | None = None,
        voxel_map: VoxelMap | None = None,
        *,
        keep: bool = False,
        body: Sequence[PlacedSolid] = (),
        others: Sequence[PlacedSolid] = (),
        turn: FloatArray | None = None,
    ) -> LocalizedCamera:
        """Tell where the camera was when a view was taken.

        Args:
            view: later than those before.
            prior: of the camera's motion since the view before, from odometry and joints; None
                where nothing is known of it.
            voxel_map: for the certainty of new fiducials, eq. (19).
            keep: keep the pose as a keyframe wherever it is.
            body: of the robot, placed in the camera frame: it carries no fiducials.
            others: what moves by itself, as teammates, placed in the map: likewise.
            turn: of the camera since the view before by a gyroscope, ``R_before_now``, shape
                (3, 3), which counts where nothing else is known of its motion.

        Raises:
            InvalidInputError: the view is not later than the one before.
        """
        if view.stamp <= self._stamp:
            raise InvalidInputError("view", f"{view.stamp} ns is not later than {self._stamp} ns")
        chosen = Choice(voxel_map, body, others)
        if self._state == "searching":
            return self._initialize(view, chosen)
        self._wake(view, prior)
        self._free_motion.turn = turn
        before = None if self._state == "lost" else self._filter.pose[0]
        seen = self._follow(view, prior)
        tracked, reason = self._solve(view, seen, prior)
        sighted = self._watch.correct(view, self._filter, tracked > 0)
        if sighted == "contradicted":
            return self._initialize(view, chosen)
        if prior is not None and prior.is_rest:
            self._fixed += view.stamp - self._stamp  # a robot that stands is where it was
        self._judge(view, seen, tracked > 0 or sighted == "corrected")
        self._note_step(view, before, tracked > 0)
        self._replace_fiducials(view, tracked, chosen)
        return self._conclude(view, reason or self._watch.reason, tracked, sighted != "", keep)

    def _initialize(self, view: RangeView, chosen: Choice) -> LocalizedCamera:
        """Against the target where there is one, else here is where the map begins."""
        self._stamp, self._state = view.stamp, "searching"
        pose, covariance = self._begin_at, self._begin_covariance
        if self._watch.exists:
            sighting = self._watch.sight(view)
            if sighting is None:
                return LocalizedCamera(view.stamp, "searching", None, None, self._watch.reason)
            pose, covariance = sighting.camera_pose()
        calibration = self.config.calibration.sigmas(view.disparity_unit)
        self._filter.start(pose, covariance, calibration)
        self._scene.clear()
        self._scene.replenish(view, self.config.wanted_fiducials, chosen)
        self._state, self._fixed = "tracking", view.stamp
        return self._conclude(view, "initialized", 0, self._watch.exists, True)

    def _wake(self, view: RangeView, prior: MotionPrior | None) -> None:
        """After `resume`: without a prior the camera may have been carried anywhere."""
        if self._is_resumed:
            self._is_resumed, self._fixed = False, view.stamp
            if prior is None:
                self._lose()

    def _follow(self, view: RangeView, prior: MotionPrior | None) -> FiducialObservations:
        """Track the fiducials, from where they are expected."""
        if self._state == "lost":
            return self._scene.follow(view, None)
        pose = self._filter.pose[0]
        if prior is not None:
            return self._scene.follow(view, pose @ prior.T_before_after)
        if self._state == "tracking" or self._free_motion.turn is not None:
            pose = pose @ self._free_motion.expected(self._since(view)).T_before_after
        return self._scene.follow(view, pose)

    def _since(self, view: RangeView) -> float:
        """Time since the view before [s]."""
        return 1e-9 * (view.stamp - self._stamp)

    def _solve(
        self, view: RangeView, seen: FiducialObservations, prior: MotionPrior | None
    ) -> tuple[int, str]:
        """Expect the motion, solve and filter: how many fiducials the pose rests on, or why not."""
        if self._state == "tracking" and self._scene.stands_still(seen, prior):
            return len(seen), ""
        if prior is not None:
            self._filter.predict(prior)
        elif self._state != "lost":
            self._filter.predict(self._free_motion.expected(self._since(view)))
        if self._state != "lost":
            update = self._update(seen)
            if prior is None:
                update = self._faster(view, seen, update)
            if update.is_consistent:
                self._noise.note(update)
                self._scene.note(seen, update)
                return len(update.used), ""
        seen = self._noise.applied(seen)
        return self._recovery.recover(view, seen, self._state == "lost", prior)

    def _faster(
        self, view: RangeView, seen: FiducialObservations, update: FilterUpdate
    ) -> FilterUpdate:
        """Where the fiducials contradict the motion that a free camera was expected to make."""
        if update.reason != CONTRADICTION:
            return update
        for more in self._free_motion.wider(self._since(view)):
            faster = self._update(seen, more)
            if faster.is_consistent:
                return faster
        return update

    def _update(self, seen: FiducialObservations, more: MotionPrior | None = None) -> FilterUpdate:
        """Filter; where the fiducials disagree, with larger sigmas."""
        usual = self._noise.factor
        update = self._filter.update(self._noise.applied(seen), more)
        while self._noise.may_explain(update.reason) and self._noise.grow():
            update = self._filter.update(self._noise.applied(seen), more)
        if not update.is_consistent:
            self._noise.factor = usual
        return update

    def _judge(self, view: RangeView, seen: FiducialObservations, is_fixed: bool) -> None:
        """Is the localization certain enough?"""
        if is_fixed:
            self._state, self._fixed = "tracking", view.stamp
            self._coasted, self._contradicted = 0, 0.0
        elif self._state != "lost":
            self._coasted += 1
            against = self._recovery.contradiction(view, seen)
            self._contradicted = self._contradicted + against if against else 0.0
            in_time = 1e-9 * (view.stamp - self._fixed) <= self.config.max_coasting
            believed = in_time and self._contradicted < _MAX_CONTRADICTED_VIEWS
            self._state = "coasting"
            if not (believed and is_certain(self._filter.covariance_by_calibration, self.config)):
                self._lose()

    def _lose(self) -> None:
        """From now on the camera may be anywhere."""
        if self._state != "lost":
            self._state = "lost"
            self._recovery.lose()
            self._filter.predict(MotionPrior(np.eye(4), np.diag(np.square(_ANYWHERE))))

    def _note_step(self, view: RangeView, before: FloatArray | None, is_fixed: bool) -> None:
        if before is not None and is_fixed:
            motion = invert_transform(before) @ self._filter.pose[0]
            self._free_motion.note(motion, self._since(view))
        elif self._state == "lost":
            self._free_motion.clear()
        self._stamp = view.stamp

    def _replace_fiducials(self, view: RangeView, tracked: int, chosen: Choice) -> None:
        """Known fiducials that ought to be in view are used again; are new ones needed?

        A pose that rests on the expected motion is built upon only from its second view on, and
        while nothing contradicts it.
        """
        if self._state == "lost":
            return
        if self._state == "coasting":
            if self._coasted < 2 or self._contradicted:
                return
            self._scene.set_aside()
        elif moved(self._recalled, self._filter.pose[0]):
            tracked += self._recovery.return_to_known(view)
            self._recalled = self._filter.pose[0]
        few = tracked < self.config.fewest_fiducials
        wanted = self.config.wanted_fiducials - tracked if few else 0
        self._scene.replenish(view, wanted, chosen)

    def _conclude(
        self, view: RangeView, reason: str, tracked: int, target_seen: bool, keep: bool
    ) -> LocalizedCamera:
        if self._state == "lost":
            return LocalizedCamera(view.stamp, "lost", None, None, reason)
        pose, covariance = self._filter.pose
        is_keyframe = keep or moved(self._keyframe, pose)
        if is_keyframe:
            self._filter.keep_pose(view.stamp)
            self._keyframe = pose
        parts = self._filter.divide_covariance(is_keyframe=is_keyframe)
        outcome = pose, covariance, reason, tracked, is_keyframe, target_seen
        return LocalizedCamera(view.stamp, self._state, *outcome, self._contradicted > 0.0, parts)
