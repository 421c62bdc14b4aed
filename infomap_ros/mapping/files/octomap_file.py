"""OctoMap's files: .ot with log-odds, .bt with free and occupied only.

A. Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees",
Autonomous Robots 34, 2013, https://doi.org/10.1007/s10514-012-9321-0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, InvalidInputError, MapFileError
from infomap_ros.geometry.atomic_file import replacing
from infomap_ros.mapping.voxel_map import VoxelMap

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


@dataclass(frozen=True, eq=False)
class OctomapLeaves:
    """Leaves of an OctoMap tree: cubes of voxels with one state.

    Attributes:
        resolution: edge of a voxel [m].
        corners: smallest voxel index of each leaf, shape (n, 3), int32.
        edges: edge of each leaf [voxels], shape (n,), int32.
        occupied: whether it is occupied, else free, shape (n,), bool.
    """

    resolution: float
    corners: NDArray[np.int32]
    edges: NDArray[np.int32]
    occupied: NDArray[np.bool_]

    def occupied_voxels(self) -> NDArray[np.int32]:
        """Indices of all occupied voxels, shape (k, 3); large leaves are taken apart.

        Raises:
            CapacityError: they are more than 100 million.
        """
        number = int((self.edges[self.occupied].astype(np.float64) ** 3).sum())
        if number > _MOST_VOXELS:
            raise CapacityError(
                f"OctoMap leaves hold {number} occupied voxels, too many for a list"
            )
        parts = [np.zeros((0, 3), dtype=np.int32)]
        for edge in np.unique(self.edges[self.occupied]):
            cube = np.indices((edge, edge, edge), dtype=np.int32).reshape(3, -1).T
            corners = self.corners[self.occupied & (self.edges == edge)]
            parts.append((corners[:, None] + cube).reshape(-1, 3))
        return np.concatenate(parts)


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
    if lines[0] == _FULL:
        if len(data) < size * _NODE.itemsize:
            text = f"has {len(data)} bytes of data, its header says {size} nodes"
            raise MapFileError(f"OctoMap file {source} {text}")
        table = _leaves_of_full(np.frombuffer(data, _NODE, size), source)
        return OctomapLeaves(resolution, table[:, :3] - KEY_OFFSET, table[:, 3], table[:, 4] > 0)
    states = np.frombuffer(data[: len(data) // 2 * 2], dtype="<u2")
    if size > 1 + 8 * len(states):
        text = f"has {len(data)} bytes of data, its header says {size} nodes"
        raise MapFileError(f"OctoMap file {source} {text}")
    corners, edges, occupied, nodes = _leaves_of(states if size else states[:0], source)
    if nodes != size:
        raise MapFileError(f"OctoMap file {source} holds {nodes} nodes, its header says {size}")
    return OctomapLeaves(resolution, corners - np.int32(KEY_OFFSET), edges, occupied)


def _leaves_of_full(nodes: NDArray[np.void], source: Path) -> NDArray[np.int32]:
    """Corner (3), edge and whether it is occupied of each leaf of a .ot file, shape (n, 5)."""
    leaves: list[tuple[int, int, int, int, bool]] = []
    pending = [(0, 0, 0, 1 << DEPTH)]
    for value, children in nodes.tolist():
        x, y, z, edge = pending.pop() if pending else (0, 0, 0, 0)
        half = edge // 2
        if edge == 0 or (children and not half):
            raise MapFileError(f"OctoMap file {source} holds nodes beside its tree")
        if not children:
            leaves.append((x, y, z, edge, value >= 0.0))
        for i in range(7, -1, -1):
            if children >> i & 1:
                child = x + half * (i & 1), y + half * (i >> 1 & 1), z + half * (i >> 2), half
                pending.append(child)
    if pending and len(nodes):
        raise MapFileError(f"OctoMap file {source} is truncated")
    return np.array(leaves, dtype=np.int32).reshape(-1, 5)


def _leaves_of(
    states: NDArray[np.uint16], source: Path
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_], int]:
    """Walk through the inner nodes of a .bt file in the order in which they are stored."""
    leaves: list[tuple[int, int, int, int, bool]] = []
    pending = [(0, 0, 0, 1 << DEPTH)] if len(states) else []
    nodes = len(pending)
    following = iter(states.tolist())
    while pending:
        x, y, z, edge = pending.pop()
        state = next(following, None)
        if state is None or edge == 1:
            problem = "is truncated" if state is None else f"has more than {DEPTH} levels"
            raise MapFileError(f"OctoMap file {source} {problem}")
        half, inner = edge // 2, []
        for i in range(8):
            kind = state >> (2 * i) & 3
            child = (x + half * (i & 1), y + half * (i >> 1 & 1), z + half * (i >> 2), half)
            nodes += kind != 0
            if kind == _INNER:
                inner.append(child)
            elif kind:
                leaves.append((*child, kind == _OCCUPIED))
        pending.extend(reversed(inner))
    table = np.array(leaves, dtype=np.int32).reshape(-1, 5)
    return table[:, :3], table[:, 3], table[:, 4] > 0, nodes
