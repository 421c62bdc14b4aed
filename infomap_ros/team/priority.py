"""How informative the states of voxels are, in bits: what carries most goes first."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel, kernel
from infomap_ros.geometry.pose_uncertainty import point_covariances
from infomap_ros.mapping import LOG_ODDS_QUANTUM, NOT_OBSERVED, SHARED_LOG_ODDS_LIMIT, VoxelMap
from infomap_ros.mapping.voxels.block_kernels import clipped, find_block, quanta_at
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface_kernels import (
    ROW_SIZE,
    added,
    inverse_symmetric,
    read_information,
)
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.contribution_kernels import unpack_keys
from infomap_ros.team.gaussian_code import code_tables, find_row

_LIMIT = SHARED_LOG_ODDS_LIMIT
_MOST_BITS = 40.0  # of one surface point
RUN_BYTES, SURFACE_BYTES = 1.6, 18.0
"""About what a voxel takes in a message [bytes]."""

_ROW_BYTES = 11.0  # of eight neighbors along x without surface, however many of them are sent
_LEAST_SHIFT = 0.02  # of a probability; what changed less can wait
_LEAST_BITS = 1.0  # of a surface point, likewise: its sigmas fell by a fifth


class ChangePriority(NamedTuple):
    """How informative the changes of blocks are, those that matter apart from the others.

    What matters: a voxel that is new or not known any more, a probability that changed by 0.02, a
    surface point that is new or of which 1 bit more is known. Voxels without a surface ride with
    those that matter where that takes no bytes.

    Attributes:
        bits: of what matters and of what can wait, shape (n, 2).
        sizes: about the bytes that telling them takes, shape (n, 2).
        matters: voxels of the blocks that matter, or ride along, shape (n, 8), uint64; a bit for
            each in the order of `BlockArrays.dirty`.
    """

    bits: NDArray[np.float64]
    sizes: NDArray[np.float64]
    matters: NDArray[np.uint64]


class _Comparison(NamedTuple):
    """A map and what was sent of it, as the kernels take them.

    Attributes:
        blocks: of the map.
        surface: its Gaussians.
        planes: evidence that was sent.
        codes: surface points that were sent.
        size: edge of a voxel [m].
        divergences: bits by evidence now and before.
        probabilities: by evidence.
        sigmas: by their codes, in voxels.
        scratch: memory for two records, shape (2, 13), float32.
        shared: what the error of the map as a whole adds to the covariances of a block, as (xx, xy,
            xz, yy, yz, zz) [m^2] at the center of each block, shape (n, 6).
    """

    blocks: Any
    surface: Any
    planes: Any
    codes: Any
    size: float
    divergences: NDArray[np.float64]
    probabilities: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    scratch: NDArray[np.float32]
    shared: NDArray[np.float64]


_ODDS = np.arange(-_LIMIT, _LIMIT + 1) * LOG_ODDS_QUANTUM
_PROBABILITIES = 1.0 / (1.0 + np.exp(-_ODDS))


def _divergences() -> NDArray[np.float64]:
    """Kullback-Leibler divergence [bits] of the states that are sent from those before."""
    p, q = _PROBABILITIES[:, None], _PROBABILITIES[None, :]
    return np.asarray(p * np.log2(p / q) + (1.0 - p) * np.log2((1.0 - p) / (1.0 - q)))


_DIVERGENCES = _divergences()


def priority_of_changes(
    voxel_map: VoxelMap, sent: Contribution, slots: NDArray[np.int64]
) -> ChangePriority:
    """Information of the changes of a map's blocks to who knows what was sent before.

    The evidence counts by its Kullback-Leibler divergence from what was sent (from p = 0.5 where
    nothing was, and 1 bit more), a surface point by half the change of log2 of the determinant of
    its information.

    Args:
        voxel_map: tracks its changes.
        sent: what others know.
        slots: of the map's blocks, shape (n,).
    """
    count = len(slots)
    priority = ChangePriority(
        np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 8), np.uint64)
    )
    storage, size = voxel_map._storage, voxel_map.config.voxel_size
    tables = _DIVERGENCES, _PROBABILITIES, code_tables()[0]
    scratch = np.empty((2, ROW_SIZE), np.float32)
    blocks, planes, codes = sent.arrays
    shared = np.zeros((len(slots), 6))
    if storage.offset.any():
        corners = np.zeros((len(slots), 3), np.int32)
        unpack_keys(storage.blocks.keys[slots], corners)
        centers = np.asarray((corners + 0.5) * (BLOCK_SIDE * size), np.float64)
        shared = point_covariances(storage.offset, centers)[:, *np.triu_indices(3)]
    arrays = storage.blocks, storage.gaussians, planes, codes
    compared = _Comparison(*arrays, size, *tables, scratch, shared)
    _weigh_changes(compared, blocks, slots, priority)
    return priority


def priority_of_states(
    sent: Contribution, slots: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bits and bytes as in `priority_of_changes`, of all of blocks to who knows nothing of it."""
    _, planes, codes = sent.arrays
    count = int(codes.counts[0])
    surfaces = np.bincount(
        codes.owner[:count] // BLOCK_VOXELS,
        weights=(codes.codes[:count, 1] != 0).astype(float),
        minlength=sent.blocks,
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
def _sent_log_determinant(other: Any, size: float, sigmas: Any) -> float:
    """As `_log_determinant`, of a code's second word; of a point anywhere in the voxel for 0."""
    if other == np.uint64(0):
        return 3.0 * math.log2(12.0 / (size * size))
    total = 0.0
    for shift in (24, 32, 40):
        byte = (other >> np.uint64(shift)) & np.uint64(0xFF)
        total -= 2.0 * math.log2(sigmas[np.int64(byte)] * size)
    return total


@kernel
def _with_shared(information: Any, shared: Any) -> Any:
    """The covariance (xx, xy, xz, yy, yz, zz) of an information with what the map shares."""
    i, s = information, shared
    own = inverse_symmetric((i[0], i[1], i[2], i[3], i[4], i[5]))
    return added(own, (s[0], s[1], s[2], s[3], s[4], s[5]))


@kernel
def _surface_change(
    compared: Any, information: Any, shared: Any, other: int, local: int
) -> tuple[float, bool]:
    """Bits by which a surface point is other than sent, and whether it is new.

    `shared` is a row of `_Comparison.shared`, `other` the block's slot in what was sent, or -1.
    """
    code, word = np.int64(-1), np.uint64(0)
    codes = compared.codes
    if other >= 0:
        code = find_row(codes.table, codes.owner, other * BLOCK_VOXELS + local)
    if code >= 0:
        word = codes.codes[code, 1]
    change = _log_determinant(information)
    if shared[0] + shared[3] + shared[5] > 0.0:
        change = -_log_determinant(_with_shared(information, shared))
    change -= _sent_log_determinant(word, compared.size, compared.sigmas)
    return min(0.5 * abs(change), _MOST_BITS), word == np.uint64(0)


@inlined_kernel
def _voxel_worth(
    compared: Any, n: int, slot: int, other: int, local: int
) -> tuple[float, bool, bool]:
    """Bits of a voxel, whether it is sent with a surface, and whether it matters.

    `n` is the block's place among those that are weighed, `slot` its number in the map, `other` in
    what was sent, or -1.
    """
    known, quanta = quanta_at(compared.blocks, slot, local)
    was = np.int64(NOT_OBSERVED)
    if other >= 0:
        was = np.int64(compared.planes.log_odds[other, local])
    is_new = was == NOT_OBSERVED
    if not known:
        return (0.0, False, False) if is_new else (1.0, False, True)
    now, before = clipped(quanta) + _LIMIT, (0 if is_new else was) + _LIMIT
    probabilities = compared.probabilities
    bits = compared.divergences[now, before]
    matters = is_new or abs(probabilities[now] - probabilities[before]) >= _LEAST_SHIFT
    if is_new:
        bits += 1.0
    if now <= _LIMIT:
        return bits, False, matters
    information, spare = compared.scratch[0], compared.scratch[1]
    half = 0.5 * compared.size
    if not read_information(compared.surface, slot, local, half, information, spare):
        return bits, False, matters
    more, is_first = _surface_change(compared, information, compared.shared[n], other, local)
    return bits + more, True, matters or is_first or more >= _LEAST_BITS


@inlined_kernel
def _weigh_row(
    compared: Any,
    n: int,
    slot: int,
    other: int,
    first: int,
    bits: Any,
    sizes: Any,
    matters: Any,
) -> None:
    """Add the changes of eight voxels along x, from `first` on, to what their block informs."""
    word, free, empty = first >> 6, 0.0, np.uint64(0)
    some_matter = False
    for local in range(first, first + 8):
        bit = np.uint64(1) << np.uint64(local & 63)
        if not compared.blocks.dirty[slot, word] & bit:
            continue
        gained, is_surface, does_matter = _voxel_worth(compared, n, slot, other, local)
        if does_matter:
            matters[word] |= bit
        if is_surface:
            bits[0 if does_matter else 1] += gained
            sizes[0 if does_matter else 1] += SURFACE_BYTES
        else:
            free, empty, some_matter = free + gained, empty | bit, some_matter or does_matter
    if empty != np.uint64(0):
        bits[0 if some_matter else 1] += free
        sizes[0 if some_matter else 1] += _ROW_BYTES
    if some_matter:
        matters[word] |= empty


@kernel
def _weigh_changes(compared: Any, sent_blocks: Any, slots: Any, priority: Any) -> None:
    """Sum up over the changed voxels of blocks into a `ChangePriority`."""
    blocks = compared.blocks
    for n in range(len(slots)):
        slot = slots[n]
        other = np.int64(find_block(sent_blocks, blocks.keys[slot]))
        bits, sizes, matters = priority.bits[n], priority.sizes[n], priority.matters[n]
        for first in range(0, BLOCK_VOXELS, 8):
            marked = blocks.dirty[slot, first >> 6] >> np.uint64(first & 63)
            if marked & np.uint64(0xFF) != np.uint64(0):
                _weigh_row(compared, n, slot, other, first, bits, sizes, matters)
