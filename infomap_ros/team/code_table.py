"""A hash table of the codes of surface points, by voxel.

Codes are found through an open-addressing table whose size need not be a power of two; it stays
between 57 and 85 % full.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.blocks import grown
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, table_slot

CODE_WORDS = 2
_MAX_LOAD = 0.85
_MAX_BLOCKS = 2**32 // BLOCK_VOXELS


class CodeTable(NamedTuple):
    """The arrays of the table, as the kernels take them.

    Attributes:
        table: hash table, row or -1, int32.
        owner: block slot * 512 + local voxel index of each row, uint32.
        codes: shape (n, 2), uint64.
        counts: used rows, int64, shape (1,).
    """

    table: NDArray[np.int32]
    owner: NDArray[np.uint32]
    codes: NDArray[np.uint64]
    counts: NDArray[np.int64]


def empty_codes() -> CodeTable:
    """A table without codes."""
    return CodeTable(
        np.full(512, -1, np.int32),
        np.empty(256, np.uint32),
        np.zeros((256, CODE_WORDS), np.uint64),
        np.zeros(1, np.int64),
    )


def with_code_room(arrays: CodeTable, more: int, blocks: int) -> CodeTable:
    """Arrays with room for `more` voxels, for a map of so many blocks.

    Raises:
        CapacityError: the map has more blocks than an owner can number.
    """
    if blocks > _MAX_BLOCKS:
        raise CapacityError(f"the map would need {blocks} blocks, the limit is {_MAX_BLOCKS}")
    count = int(arrays.counts[0])
    return arrays._replace(
        owner=grown(arrays.owner, count + more, used=count),
        codes=grown(arrays.codes, count + more, used=count),
    )


def with_table_room(arrays: CodeTable) -> CodeTable:
    """Arrays whose table is at most 85 % full, and not much emptier than that."""
    count = int(arrays.counts[0])
    if count + 1 <= _MAX_LOAD * len(arrays.table):
        return arrays
    size = max(512, int(1.5 * count / _MAX_LOAD))
    table = np.full(size, -1, np.int32)
    _rehash(table, arrays.owner, count)
    return arrays._replace(table=table)


@kernel
def _rehash(table: Any, owner: Any, count: int) -> None:
    for row in range(count):
        place = table_slot(np.int64(owner[row]), len(table))
        while table[place] >= 0:
            place += 1
            if place == len(table):
                place = 0
        table[place] = row


@kernel
def find_row(table: Any, owner: Any, key: int) -> Any:
    """Row of a voxel's code, or -1; from the arrays of a `CodeTable`."""
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0 or owner[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0


@kernel
def code_row(table: Any, owner: Any, counts: Any, key: int, codes: Any) -> Any:
    """Row of a voxel's code, made with zeros if need be.

    Args:
        table: of the `CodeTable`, likewise owner, counts and codes.
        owner: see table.
        counts: see table.
        key: the voxel, block slot * 512 + local index.
        codes: see table.

    Returns:
        The row, or -1 with nothing changed when the voxel is new and the table is full.
    """
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0:
            break
        if owner[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0
    row = counts[0]
    if row + 1 > _MAX_LOAD * len(table):
        return np.int64(-1)
    counts[0] = row + 1
    table[place] = row
    owner[row] = key
    for i in range(CODE_WORDS):
        codes[row, i] = 0
    return row
