"""What a localizer knows of its map: keyframes, fiducials, and the frame in which they are."""

from __future__ import annotations

from infomap_ros.geometry import check_covariance, check_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.records import Fiducials, KeptPoses
from infomap_ros.localization.scene_fiducials import SceneFiducials


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
