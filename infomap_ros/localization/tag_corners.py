"""Corners of tags to a fraction of a pixel, each with a covariance from the image itself.

Along each edge of the black square the position of the edge is measured on profiles across it, as
that which keeps the sum of grey between the level of the black and that of the white beside it
(Tabatabai and Mitchell 1984, doi:10.1109/TPAMI.1984.4767502, with the first moment alone, which
symmetric blur does not bias). Lines are fitted to these, and neighbours are intersected.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

_PER_PIXEL = 4  # samples of a profile per pixel
_FEWEST = 5  # profiles along an edge
_ENDS = 0.1  # share of an edge at either end that the other edge's blur reaches


class TagCorners(NamedTuple):
    """Corners of one tag.

    Attributes:
        pixels: shape (4, 2) [px].
        covariances: shape (4, 2, 2) [px^2].
    """

    pixels: FloatArray
    covariances: FloatArray


def refine_corners(
    image: NDArray[np.uint8], corners: FloatArray, cells: int, min_contrast: float
) -> TagCorners | None:
    """Measure the corners of the black square of a tag.

    Args:
        image: grey image, shape (H, W).
        corners: where they are within a pixel or two, clockwise, shape (4, 2) [px].
        cells: cells along the edge of the tag: white and black reach one cell from it.
        min_contrast: smallest difference of white and black [grey levels].

    Returns:
        The corners, or None where an edge is not dark inside and bright outside all along, or
        its line reaches beyond the image.
    """
    for _ in range(2):  # the second time from the refined corners
        reach = _reach(corners, cells)
        lines = [
            _fit_edge(image, corners[i], corners[(i + 1) % 4], reach, min_contrast)
            for i in range(4)
        ]
        if any(line is None for line in lines):
            return None
        found = [_intersect(lines[i - 1], lines[i]) for i in range(4)]  # type: ignore[arg-type]
        pixels = np.stack([point for point, _ in found])
        if np.abs(pixels - corners).max() > max(2.0, reach):
            return None
        corners = pixels
    return TagCorners(corners, np.stack([covariance for _, covariance in found]))


class _Line(NamedTuple):
    """An edge: ``normal @ p = offset + slope * (s - middle)``, s along it."""

    start: FloatArray  # (2,) [px]
    along: FloatArray  # (2,) unit
    normal: FloatArray  # (2,) unit, out of the tag
    offset: float  # [px] of the line at s = 0 from `start` along the normal
    slope: float
    length: float  # [px]
    covariance: FloatArray  # (2, 2) of offset and slope


def _reach(corners: FloatArray, cells: int) -> float:
    """How far a profile goes to either side [px]: most of a cell where it is shortest."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    x, y = corners.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    return float(np.clip(0.8 * area / (edges.max() * cells), 1.5, 5.0))


def _fit_edge(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray, reach: float, min_contrast: float
) -> _Line | None:
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    normal = np.array([along[1], -along[0]])
    count = max(_FEWEST, int((1.0 - 2.0 * _ENDS) * length))
    s = np.linspace(_ENDS, 1.0 - _ENDS, count) * length
    across = np.linspace(-reach, reach, 2 * int(np.ceil(reach * _PER_PIXEL)) + 1)
    places = start + s[:, None, None] * along + across[:, None] * normal
    if places.min() < 0.0 or (places.reshape(-1, 2).max(axis=0) > _last(image)).any():
        return None
    u, v = (places[..., axis].astype(np.float32) for axis in (0, 1))
    profiles = cv2.remap(image, u, v, cv2.INTER_LINEAR).astype(np.float64)
    edge = _edge_positions(profiles, reach, min_contrast)
    if edge is None:
        return None
    return _fit_line(start, along, s, edge, length)


def _last(image: NDArray[np.uint8]) -> FloatArray:
    return np.array([image.shape[1] - 1.0, image.shape[0] - 1.0])


def _edge_positions(profiles: FloatArray, reach: float, min_contrast: float) -> FloatArray | None:
    """Where each profile, shape (M, S), steps from dark to bright [px]; None if it does not."""
    ends = max(2, profiles.shape[1] // 6)
    # The levels vary slowly along an edge: lighting. A line through them all is steadier.
    dark = _smooth_level(profiles[:, :ends].mean(axis=1))
    bright = _smooth_level(profiles[:, -ends:].mean(axis=1))
    if (bright - dark < min_contrast).any():
        return None
    share = (profiles - dark[:, None]) / (bright - dark)[:, None]
    mean = (share[:, 1:] + share[:, :-1]).mean(axis=1) / 2.0
    return np.asarray(reach * (1.0 - 2.0 * mean))


def _smooth_level(values: FloatArray) -> FloatArray:
    """A straight line through noisy levels along an edge, robust by one rejection."""
    s = np.linspace(-1.0, 1.0, len(values))
    keep = np.abs(values - np.median(values)) <= 3.0 * max(
        float(np.median(np.abs(values - np.median(values)))), 2.0
    )
    if keep.sum() < 3:
        keep[:] = True
    return np.asarray(np.polyval(np.polyfit(s[keep], values[keep], 1), s))


def _fit_line(
    start: FloatArray, along: FloatArray, s: FloatArray, edge: FloatArray, length: float
) -> _Line:
    """Least squares with Huber's weights (doi:10.1214/aoms/1177703732)."""
    design = np.column_stack([np.ones_like(s), s])
    weights = np.ones_like(s)
    for _ in range(4):
        normal_matrix = design.T @ (weights[:, None] * design)
        offset, slope = np.linalg.solve(normal_matrix, design.T @ (weights * edge))
        residual = edge - offset - slope * s
        spread = max(1.4826 * float(np.median(np.abs(residual))), 0.02)
        weights = np.minimum(1.0, 1.5 * spread / np.maximum(np.abs(residual), 1e-12))
    variance = float(np.sum(weights * residual**2) / max(weights.sum() - 2.0, 1.0))
    covariance = variance * np.linalg.inv(normal_matrix)
    normal = np.array([along[1], -along[0]])
    return _Line(start, along, normal, float(offset), float(slope), length, np.asarray(covariance))


def _intersect(first: _Line, second: _Line) -> tuple[FloatArray, FloatArray]:
    """Corner where two edges meet (the end of the first, the start of the second), covariance."""
    directions = [line.along + line.slope * line.normal for line in (first, second)]
    origins = [line.start + line.offset * line.normal for line in (first, second)]
    normals = np.stack([np.array([d[1], -d[0]]) / np.linalg.norm(d) for d in directions])
    inverse = np.linalg.inv(normals)
    corner = inverse @ [n @ o for n, o in zip(normals, origins, strict=True)]
    variances = []
    for line, s in ((first, first.length), (second, 0.0)):
        row = np.array([1.0, s])
        variances.append(row @ line.covariance @ row)
    return corner, inverse @ np.diag(variances) @ inverse.T
