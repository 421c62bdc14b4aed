"""What the states of voxels tell, in bits: what carries most goes first."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping import LOG_ODDS_QUANTUM, NOT_OBSERVED, SHARED_LOG_ODDS_LIMIT, VoxelMap
from infomap_ros.mapping.voxels.block_kernels import clipped, find_block, quanta_at
from infomap_ros.mapping.voxels.gaussians import find_row
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import INFORMATION_SIZE
from infomap_ros.mapping.voxels.surface_reading import read_information
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.gaussian_code import code_tables

_LIMIT = SHARED_LOG_ODDS_LIMIT
_MOST_BITS = 40.0  # of one surface point
RUN_BYTES, SURFACE_BYTES = 1.6, 18.0
"""About what a voxel takes in a message [bytes]."""


def _divergences() -> NDArray[np.float64]:
    """Kullback-Leibler divergence [bits] of the states that are told from those before."""
    odds = np.arange(-_LIMIT, _LIMIT + 1) * LOG_ODDS_QUANTUM
    p = 1.0 / (1.0 + np.exp(-odds))
    p, q = p[:, None], p[None, :]
    return np.asarray(p * np.log2(p / q) + (1.0 - p) * np.log2((1.0 - p) / (1.0 - q)))


_DIVERGENCES = _divergences()


def worth_of_changes(
    voxel_map: VoxelMap, told: Contribution, slots: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the changes of a map's blocks tell to who knows what was told before.

    The evidence counts by its Kullback-Leibler divergence from what was told (from p = 0.5 where
    nothing was, and 1 bit more), a surface point by half the change of log2 of the determinant of
    its information.

    Args:
        voxel_map: tracks its changes.
        told: what was told.
        slots: of the map's blocks, shape (n,).

    Returns:
        Bits, and about the bytes that telling them takes, shape (n,) each.
    """
    bits, sizes = np.zeros(len(slots)), np.zeros(len(slots))
    storage, size = voxel_map._storage, voxel_map.config.voxel_size
    tables = _DIVERGENCES, code_tables()[0]
    both = np.empty((2, INFORMATION_SIZE), np.float32)
    _weigh_changes(
        storage.blocks,
        storage.gaussians,
        *told.arrays,
        slots,
        size,
        *tables,
        both,
        bits,
        sizes,
    )
    return bits, sizes


def worth_of_states(
    told: Contribution, slots: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bits and bytes as in `worth_of_changes`, of all of blocks to who knows nothing of it."""
    _, planes, codes = told.arrays
    count = int(codes.counts[0])
    surfaces = np.bincount(
        codes.owner[:count] // BLOCK_VOXELS,
        weights=(codes.information[:count, 1] != 0).astype(float),
        minlength=told.blocks,
    )[slots]
    odds = planes.log_odds[slots].astype(np.int64)
    known = planes.versions[slots] != 0
    bits = _DIVERGENCES[np.maximum(odds, -_LIMIT) + _LIMIT, _LIMIT]
    return (bits * known).sum(axis=1) + 10.0 * surfaces, (
        RUN_BYTES * known.sum(axis=1) + SURFACE_BYTES * surfaces
    )


@kernel
def _log_determinant(information: Any) -> float:
    """log2 of the determinant of an information matrix (xx, xy, xz, yy, yz, zz)."""
    xx, xy, xz = information[0], information[1], information[2]
    yy, yz, zz = information[3], information[4], information[5]
    determinant = (
        np.float64(xx) * (yy * zz - yz * yz)
        - np.float64(xy) * (xy * zz - yz * xz)
        + np.float64(xz) * (xy * yz - yy * xz)
    )
    return math.log2(determinant) if determinant > 0.0 else 0.0


@kernel
def _told_log_determinant(other: Any, size: float, sigmas: Any) -> float:
    """As `_log_determinant`, of a code's second word; of a point anywhere in the voxel for 0."""
    if other == np.uint64(0):
        return 3.0 * math.log2(12.0 / (size * size))
    total = 0.0
    for shift in (24, 32, 40):
        byte = (other >> np.uint64(shift)) & np.uint64(0xFF)
        total -= 2.0 * math.log2(sigmas[np.int64(byte)] * size)
    return total


@kernel
def _voxel_worth(
    blocks: Any,
    gaussians: Any,
    told_planes: Any,
    told_codes: Any,
    slot: int,
    other: int,
    local: int,
    size: float,
    divergences: Any,
    sigmas: Any,
    both: Any,
) -> tuple[float, float]:
    """Bits and bytes of one voxel; `other` is the block's slot in what was told, or -1."""
    known, quanta = quanta_at(blocks, slot, local)
    was = np.int64(NOT_OBSERVED)
    if other >= 0:
        was = np.int64(told_planes.log_odds[other, local])
    if not known:
        return (1.0, RUN_BYTES) if was != NOT_OBSERVED else (0.0, 0.0)
    now = clipped(quanta)
    bits = divergences[now + _LIMIT, (was if was != NOT_OBSERVED else 0) + _LIMIT]
    if was == NOT_OBSERVED:
        bits += 1.0
    information, spare = both[0], both[1]
    if now <= 0 or not read_information(gaussians, slot, local, 0.5 * size, information, spare):
        return bits, RUN_BYTES
    code, word = np.int64(-1), np.uint64(0)
    if other >= 0:
        code = find_row(told_codes.table, told_codes.owner, other * BLOCK_VOXELS + local)
    if code >= 0:
        word = told_codes.information[code, 1]
    change = _log_determinant(information)
    change -= _told_log_determinant(word, size, sigmas)
    return bits + min(0.5 * abs(change), _MOST_BITS), SURFACE_BYTES


@kernel
def _weigh_changes(
    blocks: Any,
    gaussians: Any,
    told_blocks: Any,
    told_planes: Any,
    told_codes: Any,
    slots: Any,
    size: float,
    divergences: Any,
    sigmas: Any,
    both: Any,
    bits: Any,
    sizes: Any,
) -> None:
    """Sum up over the changed voxels of the blocks; `both` is memory, shape (2, 9), float32."""
    for row in range(len(slots)):
        slot = slots[row]
        other = np.int64(find_block(told_blocks, blocks.keys[slot]))
        for local in range(BLOCK_VOXELS):
            word, bit = local >> 6, np.uint64(local & 63)
            if not (blocks.dirty[slot, word] >> bit) & np.uint64(1):
                continue
            told, length = _voxel_worth(
                blocks,
                gaussians,
                told_planes,
                told_codes,
                slot,
                other,
                local,
                size,
                divergences,
                sigmas,
                both,
            )
            bits[row] += told
            sizes[row] += length
