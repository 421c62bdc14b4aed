"""The surface of a map as the 3-D viewer draws it: one small record per voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.symmetric import smallest_axes
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import LEAST_EVIDENCE
from infomap_ros.mapping.voxels.keys import pack_all

LARGEST_SURFACE = 250_000
"""More voxels than this are merged to larger ones: a browser has to draw them smoothly."""

SIGMA_RANGE = (1e-4, 1.0)
"""Standard deviations that are told apart [m]; coded on a logarithmic scale."""

LOG_ODDS_RANGE = (0.0, 8.0)
"""Evidence that is told apart [nats]: probabilities from 0.5 to 0.9997."""


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """Surface voxels for drawing.

    Attributes:
        cells: index of the voxel above `first`, shape (K, 3), uint16.
        normals: unit normals times 127, turned upwards, shape (K, 3), int8.
        sigmas: standard deviation along the normal on the scale of `SIGMA_RANGE`, (K,), uint8.
        evidence: log-odds on the scale of `LOG_ODDS_RANGE`, shape (K,), uint8.
        first: index of the voxel of cell (0, 0, 0), shape (3,).
        size: edge of a drawn voxel [m].
        merged: how many voxels of the map along each edge of a drawn one.
    """

    cells: NDArray[np.uint16]
    normals: NDArray[np.int8]
    sigmas: NDArray[np.uint8]
    evidence: NDArray[np.uint8]
    first: NDArray[np.int64]
    size: float
    merged: int

    @property
    def min_evidence(self) -> int:
        """Code of the evidence below which a voxel is likely a stray one."""
        return int(LEAST_EVIDENCE * np.median(self.evidence)) if len(self.evidence) else 0

    @property
    def centers(self) -> FloatArray:
        """Centers of the drawn voxels, shape (K, 3) [m, map]."""
        return np.asarray((self.cells + self.first + 0.5) * self.size)


def drawn_surface(voxel_map: VoxelMap, most: int = LARGEST_SURFACE) -> DrawnSurface:
    """The surface voxels of a map, merged to larger ones where there are more than `most`."""
    indices, _, covariances = voxel_map.gaussians()
    size = voxel_map.config.voxel_size
    evidence = voxel_map.log_odds((indices + 0.5) * size)
    variances, axes = smallest_axes(covariances)
    normals = axes * np.where(axes[:, 2:] < 0.0, -1.0, 1.0)
    values = np.column_stack([normals, np.sqrt(np.maximum(variances, 1e-12)), evidence])
    cells, merged = indices.astype(np.int64), 1
    while len(cells) > most:
        cells, values = _merge(cells >> 1, values)
        merged *= 2
    first = cells.min(axis=0) if len(cells) else np.zeros(3, np.int64)
    lengths = np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), 1e-9)
    return DrawnSurface(
        (cells - first).astype(np.uint16),
        np.rint(values[:, :3] / lengths * 127.0).astype(np.int8),
        coded(np.log(values[:, 3]), *np.log(SIGMA_RANGE)),
        coded(values[:, 4], *LOG_ODDS_RANGE),
        first,
        size * merged,
        merged,
    )


def coded(values: FloatArray, low: float, high: float) -> NDArray[np.uint8]:
    """Values as 0 (low) to 255 (high), beyond these clipped."""
    share = (np.asarray(values) - low) / (high - low)
    return np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)


def _merge(cells: NDArray[np.int64], values: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Mean of the values of equal cells."""
    _, first, owners = np.unique(pack_all(cells), return_index=True, return_inverse=True)
    counts = np.bincount(owners)
    means = [np.bincount(owners, column) / counts for column in values.T]
    return cells[first], np.column_stack(means)
