"""OctoMap's files: .ot with log-odds, .bt with free and occupied only.

A. Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees",
Autonomous Robots 34, 2013, https://doi.org/10.1007/s10514-012-9321-0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, MapFileError
from infomap_ros.geometry.atomic_file import replacing
from infomap_ros.mapping.files.octree import DEPTH, KEY_OFFSET, Octree, build_octree
from infomap_ros.mapping.voxel_map import VoxelMap

_FULL = "# Octomap OcTree file"
_BINARY = "# Octomap OcTree binary file"
_LARGEST_VOXEL = 1000.0  # [m]
_MOST_VOXELS = 100_000_000  # that leaves are taken apart to: 1.2 GB of indices
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
    nodes = np.zeros(len(tree.values), dtype=[("value", "<f4"), ("children", "u1")])
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


def read_bt(path: str | Path) -> OctomapLeaves:
    """Read a binary OctoMap tree, for example a recorded building.

    Raises:
        MapFileError: the file is missing, no .bt file, truncated, or contradicts itself.
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
    is_tree = lines[:1] == [_BINARY] and fields.get("id") == "OcTree"
    if not is_tree or size < 0 or not 0.0 < resolution <= _LARGEST_VOXEL:
        raise MapFileError(f"{source} is no binary OctoMap file of an OcTree")
    states = np.frombuffer(data[: len(data) // 2 * 2], dtype="<u2")
    if size > 1 + 8 * len(states):
        text = f"has {len(data)} bytes of data, its header says {size} nodes"
        raise MapFileError(f"OctoMap file {source} {text}")
    corners, edges, occupied, nodes = _leaves_of(states if size else states[:0], source)
    if nodes != size:
        raise MapFileError(f"OctoMap file {source} holds {nodes} nodes, its header says {size}")
    return OctomapLeaves(resolution, corners - np.int32(KEY_OFFSET), edges, occupied)


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
