"""What the localizer is told and what it tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from infomap_ros.geometry import PlacedSolid, PoseUncertainty
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap

State = Literal["tracking", "coasting", "lost", "searching"]


@dataclass(frozen=True, eq=False)
class LocalizedCamera:
    """What is known of the camera at the stamp of a view.

    Attributes:
        stamp: of the view [ns].
        state: ``tracking``: the pose rests on this view; ``coasting``: on the expected motion
            since one before; ``lost``: it is not known; ``searching``: it was never known, because
            the target was not seen yet.
        T_map_camera: the pose, shape (4, 4); None when lost or searching.
        covariance: in the map frame, shape (6, 6); None likewise.
        uncertainty: the covariance in its parts; None likewise.
        reason: why it is not tracking, or what happened; empty where there is nothing to say.
        tracked: number of fiducials that the pose rests on.
        is_keyframe: whether the pose was kept, see `Localizer.keyframes`.
        target_seen: whether the target corrected the pose.
        contradicted: whether known fiducials are missed that ought to be in view.
    """

    stamp: int
    state: State
    T_map_camera: FloatArray | None
    covariance: FloatArray | None
    reason: str = ""
    tracked: int = 0
    is_keyframe: bool = False
    target_seen: bool = False
    contradicted: bool = False
    uncertainty: PoseUncertainty | None = None


@dataclass(frozen=True)
class Choice:
    """What decides on new fiducials, see `Localizer.locate`."""

    voxel_map: VoxelMap | None
    body: Sequence[PlacedSolid]
    others: Sequence[PlacedSolid]
