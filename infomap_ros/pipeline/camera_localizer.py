"""The localizer with what it needs of the robot. Used by one thread."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError, SensorFaultError
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PoseRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import user_base, user_camera
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.config import Fiducials, KeptPoses
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.localization.target.target import TargetDetector
from infomap_ros.mapping import VoxelMap
from infomap_ros.pipeline.inertial import InertialReading

TARGET_ORIGIN = 1
"""Names the origin of each map whose frame is that of the target: it is the same whoever begins."""

_FROZEN_DISTANCE, _FROZEN_TURN = 0.03, 0.03  # [m, rad]: beyond the drift in an image or two

_LEAST_SIGMA = 1e-4
"""Of a pose that defines the map [m and rad]: in messages a covariance of zero means unknown."""


@dataclass(frozen=True)
class CameraLocalizerConfig:
    """What the localizer is made with.

    Attributes:
        localizer: its parameters.
        motion: how far odometry and kinematics are to be trusted.
        detector: of the target, None where there is none.
        start_tilt: how far the camera looks down at the beginning, where neither odometry nor
            target say what is up [rad].
        robot: id of the robot; 0 for one that works alone.
    """

    localizer: LocalizerConfig
    motion: KinematicMotion
    detector: TargetDetector | None
    start_tilt: float = 0.0
    robot: int = 0


class CameraLocalizer:
    """Makes a localizer when the camera is known, and gives it how the robot has moved."""

    def __init__(self, config: CameraLocalizerConfig) -> None:
        self._config = config
        self._localizer: Localizer | None = None
        self._camera: PinholeCamera | None = None
        self._posture: RobotPosture | None = None
        self._inertial: InertialReading | None = None
        self._saved: SavedLocalization | None = None
        self._is_tracking = True
        self._origin = 0
        self._still: tuple[NDArray[np.uint8], RobotPosture] | None = None

    def locate(
        self,
        view: RangeView,
        posture: RobotPosture | None,
        body: Sequence[PlacedSolid] = (),
        others: Sequence[PlacedSolid] = (),
        voxel_map: VoxelMap | None = None,
        inertial: InertialReading | None = None,
    ) -> LocalizedCamera:
        """Locate the camera.

        Args:
            view: later than those before.
            posture: of the robot at that time, None where it is not known.
            body: of the robot, placed in the camera's frame.
            others: bodies of teammates, placed in the map.
            voxel_map: for the certainty of new fiducials, eq. (19).
            inertial: what an inertial sensor on the camera tells of that time, if there is one.

        Raises:
            InvalidInputError: the view is not later than those before.
            SensorFaultError: the image is that of a view before, and the robot has moved since.
            MapFileError: what was saved does not fit; it is given up.
        """
        self._check_frozen(view, posture)
        if self._localizer is None or view.camera != self._camera:
            self._begin(view, posture, None if inertial is None else inertial.up)
        assert self._localizer is not None
        prior = self._prior(posture)
        turn = None if inertial is None else inertial.turn_since(self._inertial)
        self._posture, self._inertial = posture, inertial
        result = self._localizer.locate(view, prior, voxel_map, body=body, others=others, turn=turn)
        self._is_tracking = result.state == "tracking"
        if result.uncertainty is None:
            return result
        return replace(result, uncertainty=replace(result.uncertainty, origin=self._origin))

    def _check_frozen(self, view: RangeView, posture: RobotPosture | None) -> None:
        """Notice that images stand still while odometry and joints do not.

        Two images of a camera are never the same to the last bit.
        """
        still = self._still
        if posture is None or still is None or not np.array_equal(view.image, still[0]):
            self._still = None if posture is None else (view.image, posture)
            return
        moved = invert_transform(still[1].T_odom_camera) @ posture.T_odom_camera
        turn = float(Rotation.from_matrix(moved[:3, :3]).magnitude())
        if float(np.linalg.norm(moved[:3, 3])) > _FROZEN_DISTANCE or turn > _FROZEN_TURN:
            raise SensorFaultError("images are frozen while odometry moves")

    def _prior(self, posture: RobotPosture | None) -> MotionPrior | None:
        """Expected motion since the last view; None where odometry does not tell.

        The kinematics err at the two ends of a path. Where views on it have not given the pose,
        their errors there cancel: they are of the end of one part and the beginning of the next.
        """
        if self._posture is None or posture is None:
            return None
        motion = self._config.motion if self._is_tracking else self._config.motion.odometry_alone
        return motion.between(self._posture, posture)

    def reset(self) -> None:
        """Forget everything; the next view begins anew."""
        self._localizer = self._posture = self._inertial = self._saved = self._still = None
        self._is_tracking = True

    @property
    def origin(self) -> int:
        """Names the frame of the map, as in `PoseUncertainty`; 0 before the first view."""
        return self._origin

    def move_map(self, T_new_old: FloatArray, covariance: FloatArray, origin: int = 0) -> None:
        """Put the map's frame elsewhere; see `Localizer.move_map`.

        Args:
            T_new_old: the frame as it was, in the new one, shape (4, 4).
            covariance: of that, in the new frame, shape (6, 6).
            origin: names the new frame where that is another robot's; 0 where it has the old name.

        Raises:
            InvalidInputError: there is no map yet, it is that of a target, or that is no move.
        """
        if self._localizer is None:
            raise InvalidInputError("T_new_old", "there is no map yet")
        self._localizer.move_map(T_new_old, covariance)
        self._origin = origin or self._origin

    def place_base(self, given: PoseRecord) -> FloatArray | None:
        """Take from a user where the base of the robot is.

        A camera that is lost is there in the map as it is. Else it is known where it is, and the
        frame of the map is put so that the base is where it was said to be.

        Args:
            given: pose of the base in the map.

        Returns:
            How the map's frame has moved, ``T_new_old``, shape (4, 4); None where it has not.

        Raises:
            InvalidInputError: it is not known where the camera is on the base, the map is that of
                a target, or the pose is too uncertain.
        """
        if self._localizer is None or self._posture is None:
            raise InvalidInputError("initialpose", "no view with odometry was located yet")
        T_base_camera = self._posture.T_base_camera
        T_map_base = self._localizer.last_pose @ invert_transform(T_base_camera)
        if self._localizer.is_lost:
            camera = user_camera(given, T_map_base, T_base_camera)
            assert camera.covariance is not None
            self._localizer.place_camera(camera.transform, camera.covariance)
            return None
        T_new_old = user_base(given, T_map_base) @ invert_transform(T_map_base)
        self._localizer.move_map(T_new_old, np.zeros((6, 6)))
        return T_new_old

    def lose_track(self) -> None:
        """Keep the map; where the camera is in it has to be found out."""
        saved = self.saved()
        self.reset()
        self._saved = saved.without_pose() if saved is not None else None

    def saved(self) -> SavedLocalization | None:
        """What is known, for a file; None before the first view."""
        if self._localizer is None:
            return self._saved
        return SavedLocalization(self._localizer.state(), self._posture, self._origin)

    def resume(self, saved: SavedLocalization) -> None:
        """Go on from what was saved, with the next view."""
        self.reset()
        self._saved = saved

    def keyframes(self) -> KeptPoses | None:
        """The kept poses as they are known now, None before the first view."""
        return None if self._localizer is None else self._localizer.keyframes()

    def fiducials(self) -> Fiducials | None:
        """The scene's fiducials as they are known now, None before the first view."""
        return None if self._localizer is None else self._localizer.fiducials()

    def _begin(self, view: RangeView, posture: RobotPosture | None, up: FloatArray | None) -> None:
        """Make a localizer for a camera; it goes on from what was saved, if anything was."""
        self._localizer = self._make(view.camera, posture, up)
        self._posture = self._inertial = None
        self._camera = view.camera
        saved, self._saved = self._saved, None
        if saved is None:
            is_target = self._config.detector is not None
            self._origin = TARGET_ORIGIN if is_target else origin_of(view, self._config.robot)
            return
        if saved.stamp >= view.stamp:
            saved = saved.without_pose()
        saved.resume(self._localizer)
        self._origin = saved.origin
        self._posture = saved.posture

    def _make(
        self, camera: PinholeCamera, posture: RobotPosture | None, up: FloatArray | None
    ) -> Localizer:
        """A localizer whose map is the target's frame, or odometry's, or level.

        An inertial sensor tells what is level, or it is assumed.
        """
        start = looking_along_x(self._config.start_tilt) if up is None else level_by(up)
        covariance = _LEAST_SIGMA**2 * np.eye(6)
        if posture is not None:
            start = posture.T_odom_camera
            covariance = self._config.motion.config.kinematics_covariance()
        return Localizer(camera, self._config.localizer, self._config.detector, start, covariance)


def origin_of(view: RangeView, robot: int = 0) -> int:
    """Names the origin of a map by the view with which it begins, and the robot that began it.

    A bag that starts again begins with the same view, so its map goes on; a camera that begins
    anew elsewhere sees another image at another time. Of two robots of a team the smaller id has
    the smaller origin, and that of a target is smaller than all.
    """
    named = zlib.crc32(np.ascontiguousarray(view.image).tobytes(), view.stamp & 0xFFFFFFFF)
    return robot << 16 | named & 0xFFFF if robot else max(named, TARGET_ORIGIN + 1)


def looking_along_x(tilt: float) -> FloatArray:
    """Optical frame at the origin of a level map, looking along x and down by `tilt` [rad].

    Returns:
        ``T_map_camera``, shape (4, 4).
    """
    down = Rotation.from_euler("y", tilt).as_matrix()
    return make_transform(down @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 0.0])


def level_by(up: FloatArray) -> FloatArray:
    """Optical frame at the origin of a level map, its optical axis above x.

    Args:
        up: unit vector against gravity in the optical frame, shape (3,).

    Returns:
        ``T_map_camera``, shape (4, 4). A camera that looks straight up or down has the upper edge
        of its image toward x where it looks down, and away from it where it looks up.
    """
    ahead = np.array([0.0, 0.0, 1.0])
    level = ahead - (ahead @ up) * up
    if np.linalg.norm(level) < _VERTICAL:
        level = np.array([0.0, np.sign(up[2]), 0.0])
        level = level - (level @ up) * up
    level = level / np.linalg.norm(level)
    return make_transform(np.array([level, np.cross(up, level), up]), [0.0, 0.0, 0.0])


_VERTICAL = 0.02  # [rad] from the vertical, within which a camera looks straight up or down
_LEAST_CORRECTION = 0.002  # motion of a keyframe that matters [m], and as many radians


class KeyframeChanges:
    """Remembers the poses that were given out last."""

    def __init__(self) -> None:
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
        return bool(max(distance, angle) > _LEAST_CORRECTION)
