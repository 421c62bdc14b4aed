"""Compiled questions to the map; the public form is `VoxelMap`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.config import NOT_OBSERVED
from infomap_ros.mapping.voxels.block_kernels import clipped, find_block, quanta_at
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_COUNT,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    COORDINATE_LIMIT,
    NARROW,
    NARROW_UNKNOWN,
    UNIFORM,
    WIDE,
    WIDE_UNKNOWN,
    local_index,
    pack,
    unpack,
)
from infomap_ros.mapping.voxels.surface_kernels import (
    ROW_SIZE,
    lies_in_voxel,
    read_block,
    read_information,
)

_ONE = np.uint64(1)


@njit(cache=True, nogil=True)
def quanta_at_points(blocks: Any, points: Any, inverse_size: float, known: Any, out: Any) -> None:
    """Evidence at points, shape (n, 3) [m]; unknown also outside the coordinate limits."""
    bound = COORDINATE_LIMIT - 1.0
    for i in range(len(points)):
        known[i], out[i] = False, 0
        x, y, z = points[i] * inverse_size
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):
            continue
        a, b, c = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        slot = find_block(blocks, pack(a >> BLOCK_BITS, b >> BLOCK_BITS, c >> BLOCK_BITS))
        if slot >= 0:
            known[i], out[i] = quanta_at(blocks, slot, local_index(a, b, c))


@njit(cache=True, nogil=True)
def count_known(blocks: Any) -> int:
    """Number of known voxels."""
    total = 0
    for slot in range(blocks.counts[BLOCK_COUNT]):
        kind = blocks.kind[slot]
        if kind == UNIFORM:
            total += BLOCK_VOXELS
        elif kind == NARROW:
            plane = blocks.narrow[blocks.plane[slot]]
            for i in range(BLOCK_VOXELS):
                total += plane[i] != NARROW_UNKNOWN
        elif kind == WIDE:
            wide = blocks.wide[blocks.plane[slot]]
            for i in range(BLOCK_VOXELS):
                total += wide[i] != WIDE_UNKNOWN
    return total


@njit(cache=True, nogil=True)
def voxel_of(blocks: Any, owner: int) -> tuple[int, int, int]:
    """Voxel coordinates from block slot * 512 + local index."""
    x, y, z = unpack(blocks.keys[owner >> 9])
    local = owner & 511
    return (
        x * BLOCK_SIDE + (local & 7),
        y * BLOCK_SIDE + ((local >> 3) & 7),
        z * BLOCK_SIDE + (local >> 6),
    )


@njit(cache=True, nogil=True)
def list_known(blocks: Any, indices: Any, quanta: Any) -> None:
    """Voxel coordinates (n, 3) and evidence (n,) of all known voxels."""
    found = 0
    for slot in range(blocks.counts[BLOCK_COUNT]):
        for local in range(BLOCK_VOXELS):
            known, value = quanta_at(blocks, slot, local)
            if known:
                x, y, z = voxel_of(blocks, slot * BLOCK_VOXELS + local)
                indices[found, 0], indices[found, 1], indices[found, 2] = x, y, z
                quanta[found] = value
                found += 1


@njit(cache=True, nogil=True)
def is_surface(
    blocks: Any, voxel: int, information: Any, half: float, work: Any, mean: Any
) -> bool:
    """Whether a Gaussian describes a surface in its own voxel.

    It does when the voxel is more likely occupied than not and the mean lies in the voxel, with a
    tolerance of a tenth of its size.

    Args:
        blocks: a `BlockArrays`.
        voxel: block slot * 512 + local index.
        information: of its Gaussian, shape (9,) or more.
        half: half a voxel [m].
        work: receives the covariance, shape (6,).
        mean: receives the mean relative to the voxel's center, shape (3,).
    """
    if quanta_at(blocks, voxel >> 9, voxel & 511)[1] <= 0:
        return False
    return lies_in_voxel(information, half, work, mean)


@njit(cache=True, nogil=True)
def list_surface(
    blocks: Any, gaussians: Any, size: float, indices: Any, means: Any, covariances: Any
) -> int:
    """Surface voxels: coordinates, means [m] and covariances [m^2]; stores what fits.

    Returns:
        Number of surface voxels.
    """
    locals_, other = np.empty(BLOCK_VOXELS, np.int64), np.empty(ROW_SIZE, np.float32)
    information = np.empty((BLOCK_VOXELS, ROW_SIZE), np.float32)
    work, mean, half = np.empty(6), np.empty(3), 0.5 * size
    found = 0
    for slot in range(blocks.counts[BLOCK_COUNT]):
        for row in range(read_block(gaussians, slot, half, locals_, information, other)):
            voxel = slot * BLOCK_VOXELS + locals_[row]
            if not is_surface(blocks, voxel, information[row], half, work, mean):
                continue
            if found < len(indices):
                x, y, z = voxel_of(blocks, voxel)
                indices[found, 0], indices[found, 1], indices[found, 2] = x, y, z
                for i in range(3):
                    means[found, i] = (indices[found, i] + 0.5) * size + mean[i]
                store_covariance(work, covariances[found])
            found += 1
    return found


@kernel
def store_covariance(upper: Any, out: Any) -> None:
    """Write (xx, xy, xz, yy, yz, zz) as a symmetric 3x3 matrix."""
    out[0, 0], out[0, 1], out[0, 2] = upper[0], upper[1], upper[2]
    out[1, 0], out[1, 1], out[1, 2] = upper[1], upper[3], upper[4]
    out[2, 0], out[2, 1], out[2, 2] = upper[2], upper[4], upper[5]


@njit(cache=True, nogil=True)
def entropy(quanta: int, quantum: float) -> float:
    """Entropy of a voxel with this evidence [bits]."""
    x = abs(quanta * quantum)
    if x > 700.0:
        return 0.0
    p = 1.0 / (1.0 + math.exp(x))
    return -(p * math.log2(p) + (1.0 - p) * math.log1p(-p) / math.log(2.0))


@njit(cache=True, nogil=True)
def total_entropy(blocks: Any, quantum: float, low: Any, high: Any) -> tuple[float, int]:
    """Entropy of the known voxels with index in [low, high) [bits], and their number."""
    total, known_voxels = 0.0, 0
    for slot in range(blocks.counts[BLOCK_COUNT]):
        for local in range(BLOCK_VOXELS):
            known, value = quanta_at(blocks, slot, local)
            if not known:
                continue
            x, y, z = voxel_of(blocks, slot * BLOCK_VOXELS + local)
            if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
                total += entropy(value, quantum)
                known_voxels += 1
    return total, known_voxels


@njit(cache=True, nogil=True)
def list_dirty(
    blocks: Any, gone: Any, slots: Any, limit: int, indices: Any, quanta: Any, owners: Any
) -> int:
    """List up to `limit` voxels that changed and are or were known, and forget that they changed.

    Args:
        blocks: a `BlockArrays` that tracks changes.
        gone: voxels that were known once, see `MapStorage`.
        slots: numbers of the blocks, in the order in which they are listed.
        limit: room in the arrays below.
        indices: receives voxel coordinates, shape (limit, 3).
        quanta: receives the clipped evidence or NOT_OBSERVED, shape (limit,).
        owners: receives block slot * 512 + local index, shape (limit,).

    Returns:
        Number of voxels listed.
    """
    dirty, kinds, bases, planes = blocks.dirty, blocks.kind, blocks.base, blocks.plane
    narrow, wide, keys = blocks.narrow, blocks.wide, blocks.keys
    found = 0
    for slot in slots:
        kind, base, row = kinds[slot], np.int64(bases[slot]), planes[slot]
        x, y, z = unpack(keys[slot])
        for word in range(8):
            bits = dirty[slot, word]
            bit = 0
            while bits != 0 and found < limit:
                if bits & _ONE:
                    local = word * 64 + bit
                    known, evidence = kind == UNIFORM, base
                    if kind == NARROW:
                        known = narrow[row, local] != NARROW_UNKNOWN
                        evidence = base + narrow[row, local]
                    elif kind == WIDE:
                        known = wide[row, local] != WIDE_UNKNOWN
                        evidence = base + wide[row, local]
                    was_known = slot < len(gone) and (gone[slot, word] >> np.uint64(bit)) & _ONE
                    if known or was_known:  # else so far one that a nearby surface may lie in
                        indices[found, 0] = x * BLOCK_SIDE + (local & 7)
                        indices[found, 1] = y * BLOCK_SIDE + ((local >> 3) & 7)
                        indices[found, 2] = z * BLOCK_SIDE + (local >> 6)
                        quanta[found] = clipped(evidence) if known else NOT_OBSERVED
                        owners[found] = slot * BLOCK_VOXELS + local
                        found += 1
                bits >>= _ONE
                bit += 1
            dirty[slot, word] = (bits << np.uint64(bit)) if bits != 0 else np.uint64(0)
    return found


@njit(cache=True, nogil=True)
def describe_surface(
    gaussians: Any,
    size: float,
    indices: Any,
    quanta: Any,
    owners: Any,
    has_gaussian: Any,
    means: Any,
    covariances: Any,
) -> None:
    """Tell which of the voxels of `list_dirty` hold a surface, and describe it."""
    voxels, described = (indices, quanta, owners), (has_gaussian, means, covariances)
    both, work = np.empty((2, ROW_SIZE), np.float32), np.empty((2, 6))
    _describe_surface(gaussians, size, voxels, described, both, work)


@kernel
def _describe_surface(
    gaussians: Any, size: float, voxels: Any, described: Any, both: Any, scratch: Any
) -> None:
    """`describe_surface` with memory to work with, shapes (2, 13) float32 and (2, 6)."""
    indices, quanta, owners = voxels
    has_gaussian, means, covariances = described
    information, other, work, mean = both[0], both[1], scratch[0], scratch[1]
    for voxel in range(len(quanta)):
        has_gaussian[voxel] = False
        if quanta[voxel] <= 0:
            continue
        slot, local = owners[voxel] >> 9, owners[voxel] & 511
        found = read_information(gaussians, slot, local, 0.5 * size, information, other)
        if found and lies_in_voxel(information, 0.5 * size, work, mean):
            has_gaussian[voxel] = True
            for i in range(3):
                means[voxel, i] = (indices[voxel, i] + 0.5) * size + mean[i]
            store_covariance(work, covariances[voxel])
