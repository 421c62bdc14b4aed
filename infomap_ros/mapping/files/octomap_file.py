"""OctoMap's trees: of .ot files with log-odds, of .bt files with free and occupied only.

A. Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees",
Autonomous Robots 34, 2013, https://doi.org/10.1007/s10514-012-9321-0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, ConfigError, InvalidInputError, MapFileError
from infomap_ros.geometry.atomic_file import replacing
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM, VoxelMapConfig
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    NARROW,
    NARROW_UNKNOWN,
    pack_all,
)
from infomap_ros.mapping.voxels.storage import Growth, MapStorage
from infomap_ros.mapping.voxels.surface_kernels import INFORMATION_SIZE
from infomap_ros.mapping.voxels.window import OccupancyThresholds

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


_FULL = "# Octomap OcTree file"
_BINARY = "# Octomap OcTree binary file"
_LARGEST_VOXEL = 1000.0  # [m]
_MOST_VOXELS = 100_000_000  # that leaves are taken apart to: 1.2 GB of indices
_NODE = np.dtype([("value", "<f4"), ("children", "u1")])
_FREE, _OCCUPIED, _INNER = 1, 2, 3  # two bits of a child in a .bt file; 0: unknown
_READ_FREE, _READ_OCCUPIED = -2.0, 3.5  # [nats] that OctoMap takes such leaves for


@dataclass(frozen=True, eq=False)
class OctomapLeaves:
    """Leaves of an OctoMap tree: cubes of voxels with one state, in the order of the tree.

    Attributes:
        resolution: edge of a voxel [m].
        corners: smallest voxel index of each leaf, shape (n, 3), int32.
        edges: edge of each leaf [voxels], shape (n,), int32.
        log_odds: shape (n,), float32 [nats]; of a binary tree those that OctoMap reads in it.
    """

    resolution: float
    corners: NDArray[np.int32]
    edges: NDArray[np.int32]
    log_odds: NDArray[np.float32]

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Whether each is occupied, as OctoMap has it, else free, shape (n,)."""
        return self.log_odds >= 0.0

    def occupied_voxels(self) -> NDArray[np.int32]:
        """Indices of all occupied voxels, shape (k, 3); large leaves are taken apart.

        Raises:
            CapacityError: they are more than 100 million.
        """
        chosen = self.occupied
        _check_number(self.edges[chosen], "occupied ")
        return _cubes(self.corners[chosen], self.edges[chosen], 1)[0]

    def voxel_map(self, free_probability: float, memory_limit: float) -> VoxelMap:
        """The map of these voxels, their log-odds rounded to quanta.

        A tree does not say where in its voxel a surface lies: each occupied one has a Gaussian
        at its center with the variance of a uniform distribution, s^2 / 12 along each axis.

        Args:
            free_probability: leaves up to this occupancy are free, which in a map is less than
                0.05: OctoMap clamps at 0.12, and that means this or less.
            memory_limit: of the map [GB].

        Raises:
            ConfigError: a map has no voxels so large or small.
            CapacityError: they are more than 100 million, or above the limit.
        """
        config = VoxelMapConfig(voxel_size=self.resolution, memory_limit=memory_limit)
        _check_number(self.edges, "")
        quanta = np.clip(np.rint(self.log_odds / LOG_ODDS_QUANTUM), -127, 127).astype(np.int8)
        is_free = quanta <= round(_quanta(free_probability))
        least = math.floor(_quanta(OccupancyThresholds().free_probability))
        quanta[is_free] = np.minimum(quanta[is_free], least)
        keys, evidence = _blocks(self.corners, self.edges, quanta, memory_limit)
        return VoxelMap.from_state(config, _state(keys, evidence, self.resolution))


def _quanta(probability: float) -> float:
    return math.log(probability / (1.0 - probability)) / LOG_ODDS_QUANTUM


def _check_number(edges: NDArray[np.int32], kind: str) -> None:
    """Refuse what fits nowhere.

    Raises:
        CapacityError: leaves hold more than 100 million voxels.
    """
    number = int((edges.astype(np.float64) ** 3).sum())
    if number > _MOST_VOXELS:
        raise CapacityError(f"OctoMap leaves hold {number} {kind}voxels, too many for a list")


def _cubes(
    corners: NDArray[np.int32], edges: NDArray[np.int32], side: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Take leaves apart into cubes of `side` voxels: corners (k, 3), and the leaf of each (k,)."""
    parts, owners = [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int64)]
    for edge in np.unique(edges):
        cube = side * np.indices((edge // side,) * 3, dtype=np.int32).reshape(3, -1).T
        chosen = np.flatnonzero(edges == edge)
        parts.append((corners[chosen, None] + cube).reshape(-1, 3))
        owners.append(np.repeat(chosen, len(cube)))
    return np.concatenate(parts), np.concatenate(owners)


def _blocks(
    corners: NDArray[np.int32],
    edges: NDArray[np.int32],
    quanta: NDArray[np.int8],
    memory_limit: float,
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Blocks of a map: keys (n,) and the evidence of their voxels (n, 512).

    The tree has the leaves of a block one after the other.
    """
    small = edges < BLOCK_SIDE
    large, owners = _cubes(corners[~small], edges[~small], BLOCK_SIDE)
    keys = pack_all(corners[small].astype(np.int64) >> BLOCK_BITS)
    begins = np.diff(keys, prepend=-1) != 0
    slots, count = np.cumsum(begins) - 1, int(begins.sum())
    keys = np.concatenate([keys[begins], pack_all(large.astype(np.int64) >> BLOCK_BITS)])
    occupied = edges[quanta > 0].astype(np.int64) ** 3
    growth = Growth(len(keys), len(keys), len(keys), int(occupied.sum()))
    MapStorage().check_growth(growth, 1e9 * memory_limit)
    evidence = np.full((len(keys), BLOCK_VOXELS), NARROW_UNKNOWN, np.int8)
    evidence[count:] = quanta[~small][owners, None]
    voxels, owners = _cubes(corners[small], edges[small], 1)
    x, y, z = (voxels & (BLOCK_SIDE - 1)).T
    evidence[slots[owners], x | y << BLOCK_BITS | z << 2 * BLOCK_BITS] = quanta[small][owners]
    return keys, evidence


def _state(
    keys: NDArray[np.int64], evidence: NDArray[np.int8], size: float
) -> dict[str, NDArray[Any]]:
    """A map's state (`voxels.state`) of blocks whose occupied voxels hold a surface somewhere."""
    count, owners = len(keys), np.flatnonzero(evidence.reshape(-1) > 0)
    information = np.zeros((len(owners), INFORMATION_SIZE), np.float32)
    information[:, [0, 3, 5]] = 12.0 / size**2
    return {
        "block_keys": keys,
        "block_base": np.zeros(count, np.int32),
        "block_kind": np.full(count, NARROW, np.uint8),
        "block_plane": np.arange(count, dtype=np.int32),
        "narrow": evidence,
        "wide": np.zeros((0, BLOCK_VOXELS), np.int16),
        "free_rows": np.zeros(0, np.int32),
        "gaussian_owner": owners.astype(np.uint32),
        "gaussian_side": np.zeros(len(owners), np.uint8),
        "gaussian_information": information,
        "gaussian_excess": np.zeros(len(owners), np.float32),
        "gaussian_common": np.zeros(len(owners), np.float32),
        "offset": np.zeros((6, 6)),
    }


@dataclass(frozen=True)
class OctomapData:
    """A tree as OctoMap stores it, without the header of a file.

    Attributes:
        nodes: how many it has.
        data: as OctoMap's ``writeData`` or, with free and occupied only, ``writeBinaryData`` give.
    """

    nodes: int
    data: bytes


def full_tree(voxel_map: VoxelMap) -> OctomapData:
    """All known voxels with their log-odds; OctoMap takes log-odds of exactly 0 for occupied.

    Raises:
        InvalidInputError: a voxel lies beyond OctoMap's 2^15 voxels from the origin.
    """
    tree = build_octree(*voxel_map.voxels())
    nodes = np.zeros(len(tree.values), dtype=_NODE)
    nodes["value"], nodes["children"] = tree.values, tree.children
    return OctomapData(len(nodes), nodes.tobytes())


def binary_tree(voxel_map: VoxelMap) -> OctomapData:
    """All known voxels as free or occupied, which is p > 0.5.

    Raises:
        InvalidInputError: a voxel lies beyond OctoMap's 2^15 voxels from the origin.
    """
    indices, log_odds = voxel_map.voxels()
    tree = build_octree(indices, np.where(log_odds > 0.0, 1.0, -1.0).astype(np.float32))
    return OctomapData(len(tree.values), _child_states(tree).tobytes())


def write_ot(voxel_map: VoxelMap, path: str | Path) -> None:
    """Write a `full_tree`.

    Raises:
        InvalidInputError: as there.
        OSError: the file cannot be written.
    """
    _write(path, _FULL, full_tree(voxel_map), voxel_map.config.voxel_size)


def write_bt(voxel_map: VoxelMap, path: str | Path) -> None:
    """Write a `binary_tree`.

    Raises:
        InvalidInputError: as there.
        OSError: the file cannot be written.
    """
    _write(path, _BINARY, binary_tree(voxel_map), voxel_map.config.voxel_size)


def _child_states(tree: Octree) -> NDArray[np.uint16]:
    """Two bits for each child of each inner node, shape (inner nodes,)."""
    inner = tree.children > 0
    children = tree.children[inner]
    has_children, occupied = tree.inner_children[inner], tree.occupied_children[inner]
    states = np.zeros(len(children), dtype="<u2")
    for i in range(8):
        exists, below, full = (bits >> i & 1 for bits in (children, has_children, occupied))
        state = np.where(below, _INNER, np.where(full, _OCCUPIED, _FREE)) * exists
        states |= state.astype(np.uint16) << (2 * i)
    return states


def _write(path: str | Path, title: str, tree: OctomapData, resolution: float) -> None:
    fields = f"id OcTree\nsize {tree.nodes}\nres {resolution}"
    header = f"{title}\n# written by infomap_ros\n{fields}\ndata\n"
    with replacing(path) as file:
        file.write(header.encode("ascii") + tree.data)


def read_octree(path: str | Path) -> OctomapLeaves:
    """Read an OctoMap tree, for example a recorded building: .bt, or .ot with log-odds.

    Raises:
        MapFileError: the file is missing, neither of both, truncated, or contradicts itself.
    """
    source = Path(path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise MapFileError(f"cannot read OctoMap file {source}: {error.strerror}") from error
    header, _, data = content.partition(b"\ndata\n")
    lines = header.decode("ascii", errors="replace").splitlines()
    fields = dict(line.split(maxsplit=1) for line in lines[1:] if len(line.split()) == 2)
    try:
        size, resolution = int(fields["size"]), float(fields["res"])
    except (KeyError, ValueError):
        size, resolution = -1, 0.0
    is_tree = lines[:1] in ([_BINARY], [_FULL]) and fields.get("id") == "OcTree"
    if not is_tree or size < 0 or not 0.0 < resolution <= _LARGEST_VOXEL:
        raise MapFileError(f"{source} is no OctoMap file of an OcTree")
    binary = lines[0] == _BINARY
    needed = (size + 6) // 8 * 2 if binary else size * _NODE.itemsize
    if len(data) < needed:
        text = f"has {len(data)} bytes of data, its header says {size} nodes"
        raise MapFileError(f"OctoMap file {source} {text}")
    length = len(data) // 2 * 2 if binary else needed
    try:
        nodes, leaves = _read(data[: length * (size > 0)], resolution, binary)
    except InvalidInputError as error:
        raise MapFileError(f"OctoMap file {source} {error.problem}") from error
    if nodes != size:
        raise MapFileError(f"OctoMap file {source} holds {nodes} nodes, its header says {size}")
    return leaves


def leaves_of_tree(data: bytes, resolution: float, *, binary: bool) -> OctomapLeaves:
    """Read a tree as OctoMap stores it, without the header of a file.

    Args:
        data: as of `OctomapData`.
        resolution: edge of a voxel [m].
        binary: whether it is free and occupied only.

    Raises:
        InvalidInputError: it is truncated, contradicts itself, or goes on after its end, or a map
            has no voxels so large or small.
        CapacityError: it holds more than 100 million voxels.
    """
    try:
        VoxelMapConfig(voxel_size=resolution)
    except ConfigError as error:
        raise InvalidInputError("octree", f"has voxels of {resolution:g} m") from error
    _, leaves = _read(data, resolution, binary, is_all=True)
    _check_number(leaves.edges, "")
    return leaves


def _read(
    data: bytes, resolution: float, binary: bool, is_all: bool = False
) -> tuple[int, OctomapLeaves]:
    """Number of nodes, and leaves, of a tree; with `is_all` of all data.

    Raises:
        InvalidInputError: it is no such tree.
    """
    size = 2 if binary else _NODE.itemsize
    if len(data) % size:
        raise InvalidInputError("octree", "is truncated")
    stored = np.frombuffer(data, "<u2" if binary else _NODE)
    inner = _bits_of(stored, _INNER) if binary else np.ascontiguousarray(stored["children"])
    places, pending = np.empty((len(inner), 4), np.int32), np.empty((8 * DEPTH, 4), np.int32)
    found = int(_walk(inner, places, pending)) if len(inner) else 0
    if found > len(inner):
        raise InvalidInputError("octree", "is truncated")
    if found < 0 or (binary and (places[:found, 3] == 1).any()):
        raise InvalidInputError("octree", f"has more than {DEPTH} levels")
    if found < len(inner) and (is_all or not binary):
        raise InvalidInputError("octree", "holds nodes beside its tree")
    places, stored = places[:found], stored[:found]
    if binary:
        corners, edges, log_odds = _children(places, stored)
        nodes = found + len(edges)
    else:
        is_leaf, nodes = stored["children"] == 0, found
        corners, edges = places[is_leaf, :3], places[is_leaf, 3]
        log_odds = stored["value"][is_leaf].astype(np.float32)
        if not np.isfinite(log_odds).all():
            raise InvalidInputError("octree", "holds log-odds that are not finite")
    return nodes, OctomapLeaves(resolution, corners - np.int32(KEY_OFFSET), edges, log_odds)


def _bits_of(states: NDArray[np.uint16], kind: int) -> NDArray[np.uint8]:
    """Bit i of each is set where child i is of a kind, shape (n,)."""
    bits = np.zeros(len(states), np.uint8)
    for i in range(8):
        bits |= ((states >> (2 * i) & 3) == kind).astype(np.uint8) << np.uint8(i)
    return bits


def _children(
    places: NDArray[np.int32], states: NDArray[np.uint16]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Leaves among the children of inner nodes: corners, edges and log-odds."""
    numbers = np.arange(8)
    kinds = states[:, None] >> (2 * numbers).astype(np.uint16) & 3
    half = places[:, 3:] // 2
    offsets = half[:, :, None] * np.stack([numbers & 1, numbers >> 1 & 1, numbers >> 2], axis=-1)
    is_leaf = (kinds == _FREE) | (kinds == _OCCUPIED)
    corners = (places[:, None, :3] + offsets)[is_leaf].astype(np.int32)
    log_odds = np.where(kinds[is_leaf] == _OCCUPIED, _READ_OCCUPIED, _READ_FREE)
    return corners, np.broadcast_to(half, kinds.shape)[is_leaf], log_odds.astype(np.float32)


@kernel
def _walk(inner: Any, places: Any, pending: Any) -> int:
    """Find where the nodes of a tree in pre-order are.

    Args:
        inner: bit i is set where child i of a node is stored too, shape (n,), uint8.
        places: receives corner and edge of each node in OctoMap's keys, shape (n, 4).
        pending: to work with, shape (128, 4).

    Returns:
        How many nodes the tree has; n + 1 if there are more than are stored, -1 if it is too deep.
    """
    pending[0, 0], pending[0, 1], pending[0, 2], pending[0, 3] = 0, 0, 0, 1 << DEPTH
    waiting = 1
    for node in range(len(inner)):
        if waiting == 0:
            return node
        waiting -= 1
        x, y, z = pending[waiting, 0], pending[waiting, 1], pending[waiting, 2]
        edge = pending[waiting, 3]
        if edge == 0:
            return -1
        places[node, 0], places[node, 1], places[node, 2], places[node, 3] = x, y, z, edge
        half = edge // 2
        for i in range(7, -1, -1):
            if inner[node] >> i & 1:
                pending[waiting, 0] = x + half * (i & 1)
                pending[waiting, 1] = y + half * (i >> 1 & 1)
                pending[waiting, 2] = z + half * (i >> 2)
                pending[waiting, 3] = half
                waiting += 1
    return len(inner) if waiting == 0 else len(inner) + 1
