"""The target: the common object whose frame is the map, and what seeing it tells.

A detector looks for one kind of target in one view. It either says where the target is, with a
covariance, or refuses and says why; it never guesses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    carry_covariance,
    check_covariance,
    check_transform,
    invert_transform,
    skew,
)
from infomap_ros.geometry.transforms import FloatArray

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView

RefusalReason = Literal[
    "not in view", "ambiguous", "inconsistent", "too uncertain", "range contradicts size"
]


@dataclass(frozen=True, eq=False)
class TargetSighting:
    """Where the target is, seen from the camera.

    Attributes:
        T_camera_target: pose of the target in the optical frame of the camera, shape (4, 4).
        covariance: of that pose in the camera frame, shape (6, 6), order and error model of
            `geometry.transforms`.
        score: from 0 to 1, how completely the view agrees with the target.
        detector: name of what found it, for messages.

    Raises:
        InvalidInputError: the pose is not rigid, the covariance is none, or the score is out of
            range.
    """

    T_camera_target: FloatArray
    covariance: FloatArray
    score: float
    detector: str

    def __post_init__(self) -> None:
        if not 0.0 <= self.score <= 1.0:
            raise InvalidInputError("score", f"is {self.score}, expected 0 to 1")
        pose = check_transform(self.T_camera_target, "T_camera_target")
        object.__setattr__(self, "T_camera_target", pose)
        object.__setattr__(self, "covariance", check_covariance(self.covariance, 6))

    def camera_pose(self) -> tuple[FloatArray, FloatArray]:
        """The other way round: pose of the camera in the target's frame.

        Returns:
            ``T_target_camera``, shape (4, 4), and its covariance in the target's frame, (6, 6).
        """
        return invert_pose(self.T_camera_target, self.covariance)

    def of_frame(self, T_target_frame: FloatArray) -> TargetSighting:
        """The same sighting for another frame that is fixed to the target.

        Args:
            T_target_frame: where that frame is, shape (4, 4), known exactly.
        """
        lever = self.T_camera_target[:3, :3] @ T_target_frame[:3, 3]
        return TargetSighting(
            self.T_camera_target @ T_target_frame,
            carry_covariance(self.covariance, lever),
            self.score,
            self.detector,
        )


@dataclass(frozen=True)
class TargetRefusal:
    """Why a view does not tell where the target is.

    Attributes:
        reason: one of a few fixed phrases, for counting: ``not in view``; ``ambiguous``, when two
            poses explain the view; ``inconsistent``, when none explains it; ``too uncertain``;
            ``range contradicts size``, when the measured range does not fit the size of the target,
            as with a board that was printed to a wrong scale.
        detail: numbers and circumstances, for a human.
        detector: name of what refused.
    """

    reason: RefusalReason
    detail: str = field(default="")
    detector: str = field(default="")


class TargetDetector(Protocol):
    """Looks for the target in one view."""

    def detect(self, view: RangeView) -> TargetSighting | TargetRefusal:
        """Find the target, or say why not.

        Args:
            view: image and range of one stamp.
        """
        ...


def invert_pose(T_a_b: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Invert a pose with its covariance.

    Args:
        T_a_b: shape (4, 4).
        covariance: in frame a, shape (6, 6).

    Returns:
        ``T_b_a`` and its covariance in frame b, to first order.
    """
    inverse = invert_transform(T_a_b)
    back = np.zeros((6, 6))
    back[:3, :3] = -inverse[:3, :3]
    back[:3, 3:] = -inverse[:3, :3] @ skew(T_a_b[:3, 3])
    back[3:, 3:] = -inverse[:3, :3]
    return inverse, back @ covariance @ back.T
