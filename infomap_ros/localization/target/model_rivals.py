"""Does the range map tell two poses of a model apart, or are they nearly the same to it?

A nearly symmetric model, turned onto itself, differs from itself in a few places alone. Whether all
of the visible surface agrees says little then: those places have to speak, and for one pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.model_check import ranges_at, visible_points
from infomap_ros.localization.target.model_shape import ModelShape
from infomap_ros.stereo import RangeCloud

_APART = 2.0  # limits of agreement between two surfaces that are told apart
_VAGUE = 5.0  # a depth with 3 sigma above so many tolerances tells nothing


class Evidence(NamedTuple):
    """What the places say in which two poses differ.

    Attributes:
        places: points of either surface that the other one does not have, of known range.
        against: those of the first pose's that are not measured, and those of the other pose's
            that are.
    """

    places: int
    against: int

    @property
    def against_share(self) -> float:
        """Share that speaks against the first pose; 1 where nothing speaks."""
        return self.against / self.places if self.places else 1.0


class PoseComparison:
    """Compares poses of one model.

    Args:
        shape: points that are looked at.
        surface: points to which distances are measured, finer.
        spacing: of the points that are looked at [m].
        tolerance: difference of depth that counts as agreement, beside 3 sigma [m].
    """

    def __init__(
        self, shape: ModelShape, surface: ModelShape, spacing: float, tolerance: float
    ) -> None:
        self._shape, self._spacing, self._tolerance = shape, spacing, tolerance
        self._tree = KDTree(surface.points)

    def evidence(self, cloud: RangeCloud, pose: FloatArray, rival: FloatArray) -> Evidence:
        """What a range map says of a pose and its rival, ``T_camera_model`` each, shape (4, 4)."""
        own, missed = self._told_apart(cloud, pose, rival)
        other, found = self._told_apart(cloud, rival, pose)
        return Evidence(own + other, missed + (other - found))

    def _told_apart(
        self, cloud: RangeCloud, pose: FloatArray, other: FloatArray
    ) -> tuple[int, int]:
        """Visible points that the other pose does not have, and how many are not measured."""
        seen = visible_points(self._shape, pose, self._spacing)
        points = transform_points(pose, self._shape.points[seen])
        measured, sigma = ranges_at(cloud, points)
        limit = np.maximum(self._tolerance, 3.0 * sigma)
        known = np.isfinite(measured) & (limit < _VAGUE * self._tolerance)
        inside = transform_points(invert_transform(other), points[known])
        alone = self._tree.query(inside)[0] > _APART * limit[known]
        off = np.abs(measured[known] - points[known, 2]) > limit[known]
        return int(alone.sum()), int((alone & off).sum())
