"""Voxels as an OctoMap octree: 16 levels, eight equal leaves pruned to one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError

DEPTH = 16
"""Levels of an OctoMap tree."""

KEY_OFFSET = 1 << (DEPTH - 1)
"""OctoMap's key of voxel index 0."""


@dataclass(frozen=True, eq=False)
class Octree:
    """Nodes of an octree, parents before children, siblings in order (pre-order).

    Attributes:
        values: log-odds, of an inner node the largest of its children's, shape (n,), float32.
        children: bit i is set where child i exists, 0 for a leaf, shape (n,), uint8.
        inner_children: bit i is set where child i has children, shape (n,), uint8.
        occupied_children: bit i is set where child i has log-odds above 0, shape (n,), uint8.
    """

    values: NDArray[np.float32]
    children: NDArray[np.uint8]
    inner_children: NDArray[np.uint8]
    occupied_children: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Level:
    """Nodes of one depth, sorted by their Morton code."""

    codes: NDArray[np.int64]
    values: NDArray[np.float32]
    children: NDArray[np.uint8]
    inner_children: NDArray[np.uint8]
    occupied_children: NDArray[np.uint8]


def build_octree(indices: NDArray[np.int32], log_odds: NDArray[np.float32]) -> Octree:
    """Build the pruned octree of voxels.

    Args:
        indices: voxel indices, shape (K, 3), each once.
        log_odds: shape (K,) [nats].

    Raises:
        InvalidInputError: a voxel lies beyond OctoMap's 2^15 voxels from the origin.
    """
    keys = indices.astype(np.int64) + KEY_OFFSET
    if len(keys) and (keys.min() < 0 or keys.max() >= 2 * KEY_OFFSET):
        raise InvalidInputError(
            "voxels", f"an OctoMap file holds indices from {-KEY_OFFSET} to {KEY_OFFSET - 1} only"
        )
    level = _leaves(_morton(keys), log_odds.astype(np.float32))
    levels: list[_Level] = []
    while len(levels) < DEPTH and len(level.codes):
        level, kept = _parents(level)
        levels.append(kept)
    levels.append(level)
    return _preorder(levels)


def _leaves(codes: NDArray[np.int64], values: NDArray[np.float32]) -> _Level:
    order = np.argsort(codes)
    none = np.zeros(len(codes), dtype=np.uint8)
    return _Level(codes[order], values[order], none, none, none)


def _parents(level: _Level) -> tuple[_Level, _Level]:
    """The level above, and those nodes of this level that are not pruned."""
    codes, first = np.unique(level.codes >> 3, return_index=True)
    counts = np.diff(np.append(first, len(level.codes)))
    bits = np.left_shift(1, level.codes & 7).astype(np.uint8)
    highest = np.maximum.reduceat(level.values, first)
    equal = np.minimum.reduceat(level.values, first) == highest
    leaves = np.maximum.reduceat(level.children, first) == 0
    pruned = (counts == 8) & equal & leaves

    def children_with(property_: NDArray[np.bool_]) -> NDArray[np.uint8]:
        united = np.bitwise_or.reduceat(np.where(property_, bits, 0).astype(np.uint8), first)
        return np.where(pruned, 0, united).astype(np.uint8)

    above = _Level(
        codes,
        highest,
        children_with(np.ones(len(bits), dtype=np.bool_)),
        children_with(level.children > 0),
        children_with(level.values > 0.0),
    )
    keep = ~np.repeat(pruned, counts)
    return above, _Level(
        *(
            getattr(level, name)[keep]
            for name in ("codes", "values", "children", "inner_children", "occupied_children")
        )
    )


def _preorder(levels: list[_Level]) -> Octree:
    """All levels, deepest first, in pre-order: by the first leaf below, then from the root."""
    starts = np.concatenate([level.codes << (3 * i) for i, level in enumerate(levels)])
    heights = np.concatenate([np.full(len(level.codes), -i) for i, level in enumerate(levels)])
    order = np.lexsort((heights, starts))
    return Octree(
        *(
            np.concatenate([getattr(level, name) for level in levels])[order]
            for name in ("values", "children", "inner_children", "occupied_children")
        )
    )


def _morton(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Interleave the bits of keys, shape (K, 3), x lowest."""
    codes = np.zeros(len(keys), dtype=np.int64)
    for axis in range(3):
        spread = keys[:, axis].copy()
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            spread = (spread | (spread << shift)) & mask
        codes |= spread << axis
    return codes
