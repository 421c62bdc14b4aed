"""Finding the points of a scan that lie on the robot's own body.

A point belongs to the body when its error can have carried it there from one of the body's solids,
grown by a margin: when its signed distance d to the solid satisfies

    d <= margin + sigmas * sqrt(n^T C n),

n the unit direction from the nearest point of the solid to the point, C the point's covariance. All
solids are convex, so the half-space behind that nearest point holds the solid, and every point
within `sigmas` Mahalanobis distances of the grown solid is found; compared with the largest
standard deviation in place of sqrt(n^T C n), points that merely pass beside the body stay.

Beside and behind the outlines of a body a matcher sets points that are on neither the body nor the
scene. The camera that is on the body cannot see through it, so with `rays` every point is dropped
whose ray meets a solid grown by the margin, or less where the solid is near to the camera: what
moves it there are angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Box, ConvexPolytope, Cylinder, PlacedSolid, Sphere
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.mapping.scans.body_kernels import (
    BOX,
    CYLINDER,
    POLYTOPE,
    SPHERE,
    SolidArrays,
    mark,
)

_DIAGONAL_FIRST = np.array([0, 4, 8, 1, 2, 5])  # xx, yy, zz, xy, xz, yz of a 3x3 matrix
_DIAGONAL_FIRST_OF_SIX = np.array([0, 3, 5, 1, 2, 4])  # of (xx, xy, xz, yy, yz, zz)


@dataclass(frozen=True)
class BodyFilterConfig:
    """How far the body is grown.

    Raises:
        ConfigError: a value is out of its range.
    """

    margin: float = parameter(
        0.02,
        "Growth of the body's solids, for what the robot description and the joint positions "
        "leave open.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    sigmas: float = setting(
        3.0,
        "Further growth, in standard deviations of the point along the direction from the body.",
        low=0.0,
        high=6.0,
    )
    default_sigma: float = setting(
        0.02,
        "Standard deviation of a point, along each axis, whose covariance is unknown.",
        unit="m",
        low=0.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


def body_mask(
    points: ArrayLike,
    covariances: ArrayLike | None,
    solids: Sequence[PlacedSolid],
    config: BodyFilterConfig | None = None,
    rays: bool = False,
) -> NDArray[np.bool_]:
    """Mark the points that may lie on a body, or behind it; see the module for the rule.

    Args:
        points: shape (..., 3), sensor frame [m]; NaN = no measurement, never marked.
        covariances: shape (..., 3, 3), or (..., 6) as (xx, xy, xz, yy, yz, zz), sensor frame
            [m^2]; None if unknown, not finite where unknown.
        solids: the body, placed in the sensor frame.
        config: how far the body is grown.
        rays: whether points are marked too that the sensor, at the origin, would see through the
            body: it sees the body there, so such a point is a mismatch.

    Returns:
        True for a point to be dropped, shape (...).

    Raises:
        InvalidInputError: shapes do not fit or a solid is of an unknown type.
    """
    settings = config or BodyFilterConfig()
    cloud = _floats(points)
    if cloud.shape[-1:] != (3,):
        raise InvalidInputError("points", f"shape {cloud.shape}, expected (..., 3)")
    rows = np.ascontiguousarray(cloud.reshape(-1, 3))
    table, columns = _covariance_rows(covariances, cloud.shape[:-1], settings.default_sigma)
    mask = np.zeros(len(rows), dtype=np.bool_)
    if solids:
        arrays = pack_solids(solids)
        mark(
            arrays, rows, table, columns,
            settings.margin, settings.sigmas, settings.default_sigma**2, rays, mask,
        )  # fmt: skip
    return mask.reshape(cloud.shape[:-1])


def pack_solids(solids: Sequence[PlacedSolid]) -> SolidArrays:
    """Lay solids out as plain arrays for the kernel.

    Raises:
        InvalidInputError: a solid is of an unknown type.
    """
    packed = [_kind_size_planes(placed) for placed in solids]
    planes = [item[2] for item in packed]
    centers = np.array([placed.transform[:3, 3] for placed in solids], dtype=np.float64)
    radii = np.array([placed.solid.bounding_radius for placed in solids])
    middle = 0.5 * (centers.min(axis=0) + centers.max(axis=0))
    return SolidArrays(
        kinds=np.array([item[0] for item in packed], dtype=np.int64),
        sizes=np.array([item[1] for item in packed], dtype=np.float64),
        plane_starts=np.cumsum([0, *(len(item) for item in planes)]),
        planes=np.concatenate([np.zeros((0, 4)), *planes]),
        centers=centers,
        rotations=np.array([placed.transform[:3, :3] for placed in solids], dtype=np.float64),
        radii=radii,
        middle=middle,
        reach=float((np.linalg.norm(centers - middle, axis=1) + radii).max()),
    )


def _kind_size_planes(
    placed: PlacedSolid,
) -> tuple[int, tuple[float, float, float], NDArray[np.float64]]:
    solid, none = placed.solid, np.zeros((0, 4))
    if isinstance(solid, Sphere):
        return SPHERE, (solid.radius, 0.0, 0.0), none
    if isinstance(solid, Box):
        x, y, z = solid.size
        return BOX, (0.5 * x, 0.5 * y, 0.5 * z), none
    if isinstance(solid, Cylinder):
        return CYLINDER, (solid.radius, 0.5 * solid.length, 0.0), none
    if isinstance(solid, ConvexPolytope):
        return POLYTOPE, (0.0, 0.0, 0.0), np.column_stack([solid.normals, solid.offsets])
    raise InvalidInputError("solids", f"'{placed.name}' is of the unknown {type(solid)}")


def _covariance_rows(
    covariances: ArrayLike | None, shape: tuple[int, ...], default_sigma: float
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """Rows of numbers, one per point or one for all, and where xx, yy, zz, xy, xz, yz are."""
    if covariances is None:
        one = np.diag(np.full(3, default_sigma**2)).reshape(1, 9)
        return one.astype(np.float32), _DIAGONAL_FIRST
    table = _floats(covariances)
    if table.shape == (*shape, 3, 3):
        return np.ascontiguousarray(table.reshape(-1, 9)), _DIAGONAL_FIRST
    if table.shape == (*shape, 6):
        return np.ascontiguousarray(table.reshape(-1, 6)), _DIAGONAL_FIRST_OF_SIX
    raise InvalidInputError(
        "covariances", f"shape {table.shape}, expected {(*shape, 3, 3)} or {(*shape, 6)}"
    )


def _floats(values: ArrayLike) -> NDArray[np.floating]:
    """As float32 where it is that already, else as float64."""
    array = np.asarray(values)
    return array if array.dtype == np.float32 else array.astype(np.float64)
