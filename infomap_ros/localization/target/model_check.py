"""Does a pose of the model explain the range image? Agreement, occlusion, and seeing through.

Every point of the model's surface that the camera should see is compared with the range measured
in its pixel. Farther: the camera looks through the model, which speaks against the pose. Nearer:
something hides it. A patch of a larger surface, as of a wall, has neighbors that go on beyond the
model's outline, which also speaks against the pose.

Does the range map distinguish two poses of a model, or are they nearly the same to it?

A nearly symmetric model, turned onto itself, differs from itself in a few places alone. Whether all
of the visible surface agrees says little then: those places have to speak, and for one pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.model_scene import ModelShape
from infomap_ros.stereo import RangeCloud

_FACING = 0.25  # cosine between ray and normal below which a surface is not compared
_FEWEST = 30
_OPEN = 0.7  # share of an outline that is open for an object that stands on something
_VAGUE = 5.0  # a depth with 3 sigma above so many tolerances says nothing


class Agreement(NamedTuple):
    """How a pose agrees with a range image.

    Attributes:
        agreeing: share of the comparable surface where the range is as predicted.
        seen_through: share of it where the range is larger.
        hidden: share of it where the range is smaller.
        open_outline: share of the outline beyond which the surface does not go on.
        residual: rms of what agrees, in units of the tolerance.
        compared: points that were compared.
    """

    agreeing: float
    seen_through: float
    hidden: float
    open_outline: float
    residual: float
    compared: int

    @property
    def score(self) -> float:
        """From 0 to 1: what agrees, less what is seen through, for an outline that is open."""
        shape = min(1.0, self.open_outline / _OPEN)
        return max(0.0, self.agreeing - self.seen_through) * shape

    def text(self) -> str:
        """For messages."""
        return (
            f"{self.agreeing:.0%} of the visible surface agrees, {self.seen_through:.0%} is seen "
            f"through, {self.hidden:.0%} is hidden, {self.open_outline:.0%} of the outline is open"
        )


NOTHING = Agreement(0.0, 0.0, 0.0, 0.0, 1.0, 0)


def visible_points(shape: ModelShape, pose: FloatArray, spacing: float) -> NDArray[np.int64]:
    """Points of a model that face the camera and are not behind others of it.

    Args:
        shape: of the model.
        pose: ``T_camera_model``, shape (4, 4).
        spacing: of the points [m].

    Returns:
        Indices, shape (V,).
    """
    points = transform_points(pose, shape.points)
    normals = shape.normals @ pose[:3, :3].T
    lengths = np.linalg.norm(points, axis=1)
    cosines = -np.einsum("ni,ni->n", points, normals) / np.maximum(lengths, 1e-12)
    facing = np.flatnonzero((cosines > _FACING) & (points[:, 2] > 0.0))
    if not len(facing):
        return facing
    # A look of its own: cells of two spacings at the nearest depth.
    across = points[facing, :2] / points[facing, 2:]
    cell = 2.0 * spacing / float(points[facing, 2].min())
    cells = np.floor((across - across.min(axis=0)) / cell).astype(np.int64)
    keys = cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1]
    nearest = np.full(int(keys.max()) + 1, np.inf)
    np.minimum.at(nearest, keys, points[facing, 2])
    slope = np.sqrt(1.0 / cosines[facing] ** 2 - 1.0)
    slack = spacing * (1.5 + 3.0 * slope)  # of depth within a cell
    return facing[points[facing, 2] < nearest[keys] + slack]


def check_pose(
    shape: ModelShape, pose: FloatArray, cloud: RangeCloud, spacing: float, tolerance: float
) -> Agreement:
    """Compare a pose with a range image.

    Args:
        shape: of the model, points `spacing` apart.
        pose: ``T_camera_model``, shape (4, 4).
        cloud: the range map.
        spacing: [m].
        tolerance: difference of depth that counts as agreement, beside 3 sigma [m].
    """
    seen = visible_points(shape, pose, spacing)
    points = transform_points(pose, shape.points[seen])
    measured, sigma = ranges_at(cloud, points)
    known = np.isfinite(measured) & (3.0 * sigma < _VAGUE * tolerance)
    if known.sum() < _FEWEST or known.sum() < 0.3 * len(seen):
        return NOTHING
    limit = np.maximum(tolerance, 3.0 * sigma[known])
    beyond = (measured - points[:, 2])[known]
    agrees = np.abs(beyond) <= limit
    ratio = beyond[agrees] / limit[agrees]
    return Agreement(
        float(agrees.mean()),
        float((beyond > limit).mean()),
        float((beyond < -limit).mean()),
        _open_outline(points, cloud, spacing, tolerance),
        float(np.sqrt(np.mean(ratio**2))) if agrees.any() else 1.0,
        int(known.sum()),
    )


def flat_share(shape: ModelShape, pose: FloatArray, spacing: float, tolerance: float) -> float:
    """Share of the visible surface that lies on one plane, which could be anything's.

    Args:
        shape: of the model, points `spacing` apart.
        pose: ``T_camera_model``, shape (4, 4).
        spacing: [m].
        tolerance: distance from the plane that counts as on it [m].
    """
    seen = visible_points(shape, pose, spacing)
    if not len(seen):
        return 1.0
    points, normals = shape.points[seen], shape.normals[seen]
    some = slice(None, None, max(1, len(seen) // 60))
    offsets = np.einsum("ni,ni->n", points[some], normals[some])
    on = np.abs(points @ normals[some].T - offsets) < tolerance
    return float(on.mean(axis=0).max())


def ranges_at(cloud: RangeCloud, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Depth and its sigma in the pixels of points, shape (N,) each [m]; NaN where none."""
    u, v, inside = _pixels(cloud, points)
    depth, sigma = np.full(len(points), np.nan), np.full(len(points), np.nan)
    depth[inside] = cloud.range_image[v[inside], u[inside]]
    sigma[inside] = np.sqrt(cloud.packed[v[inside], u[inside], 9])
    return depth, sigma


def _pixels(
    cloud: RangeCloud, points: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    pixels = np.nan_to_num(cloud.camera.project(points), nan=-1e6)
    u, v = np.rint(np.clip(pixels, -1e6, 1e6)).astype(np.int64).T
    inside = (u >= 0) & (v >= 0) & (u < cloud.camera.width) & (v < cloud.camera.height)
    return u, v, inside


def _open_outline(points: FloatArray, cloud: RangeCloud, spacing: float, tolerance: float) -> float:
    """Share of the places just outside the model's outline where its surface does not go on."""
    camera = cloud.camera
    size = spacing * camera.fx / float(points[:, 2].mean())  # of a point in the image [px]
    cells = np.rint(camera.project(points) / (2.0 * size)).astype(np.int64)
    low = cells.min(axis=0) - 2
    shape = cells.max(axis=0) - low + 3
    depth = np.full(shape, np.inf)
    np.minimum.at(depth, tuple((cells - low).T), points[:, 2])
    own = np.isfinite(depth)
    around, count = np.zeros(shape), np.zeros(shape)
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        neighbor = np.roll(np.where(own, depth, 0.0), step, axis=(0, 1))
        around += neighbor
        count += neighbor > 0.0
    rim = ~own & (count > 0)
    places = np.argwhere(rim)
    pixels = np.rint((places + low) * 2.0 * size).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    if inside.sum() < 8:
        return 0.0
    expected = (around[rim] / count[rim])[inside]
    measured = cloud.range_image[pixels[inside, 1], pixels[inside, 0]]
    goes_on = np.abs(measured - expected) <= tolerance + 2.0 * spacing
    return float(1.0 - goes_on.mean())


_APART = 2.0  # limits of agreement between two surfaces that are distinguished


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
        own, missed = self._distinguish(cloud, pose, rival)
        other, found = self._distinguish(cloud, rival, pose)
        return Evidence(own + other, missed + (other - found))

    def _distinguish(
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
