"""The wire format of map updates: packed rows with named fields, for point clouds.

A row holds absolute states of voxels in their robot's contribution, never differences, with the
version at which they were taken (`infomap_ros.team.update`). So a message may be lost, repeated
or come late: whoever keeps the newest version per robot and voxel is right. A robot takes a voxel
back by the log-odds `NOT_OBSERVED`.

Two layouts, distinguished by their fields: `OCCUPANCY_ROW` holds eight neighbors along x, of which
those with the log-odds `NOT_SENT` are left out, and `SURFACE_ROW` one voxel and the code of its
Gaussian (`infomap_ros.team.gaussian_code`). A message spans at most 256 voxels along each axis, so
that an index fits a byte; where it begins, whose it is, its version and the voxel size stand in
the name of one more field (`infomap_ros.team.message_header`). States of several versions, as a
robot passes them on for another, have one more column.

All numbers are little endian.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT
from infomap_ros.team.gaussian_code import CODE, CODE_FIELDS, codes_of_words, words_of_codes
from infomap_ros.team.message_header import (
    dtype_with_header,
    header_of,
    positive_number,
    whole_number,
    without_header,
)
from infomap_ros.team.update import (
    MAX_ORIGIN,
    MAX_ROBOT,
    MAX_SERIAL,
    MAX_SESSION,
    MAX_VERSION,
    MapUpdate,
    message_bytes,
)

TILE_SHIFT, RUN_SHIFT = 8, 3
"""A message spans 2^8 voxels along each axis at the most, a run holds 2^3 neighbors along x."""

ORDER_SHIFT = 3 * TILE_SHIFT
"""Numbers of `order_of_blocks` shifted by this are those of the parts that fit a message."""

NOT_SENT = -127
"""Log-odds of a voxel of which a row says nothing."""

_TILES = 13  # [bits] of the number of tiles along an axis


@kernel
def lowest_corner(indices: Any, rows: Any, corner: Any) -> None:
    """Smallest coordinates, shape (3,), of the voxels that `rows` chooses of `indices`."""
    for axis in range(3):
        corner[axis] = indices[rows[0], axis]
    for row in rows:
        for axis in range(3):
            corner[axis] = min(corner[axis], np.int64(indices[row, axis]))


@kernel
def order_of_blocks(indices: Any, rows: Any, origin: Any, keys: Any) -> None:
    """Numbers that grow along the parts, in them along the blocks, and in these along the runs.

    Args:
        indices: of voxels, shape (K, 3).
        rows: of `indices`, shape (n,).
        origin: shape (3,), no larger than any of these.
        keys: receives the numbers, shape (n,), int64.
    """
    for i in range(len(rows)):
        tile, block, place = np.int64(0), np.int64(0), np.int64(0)
        for axis in (2, 1, 0):
            value = np.int64(indices[rows[i], axis]) - origin[axis]
            tile = (tile << _TILES) | (value >> TILE_SHIFT)
            block = (block << (TILE_SHIFT - RUN_SHIFT)) | ((value >> RUN_SHIFT) & 31)
            place = (place << RUN_SHIFT) | (value & 7)
        keys[i] = (tile << ORDER_SHIFT) | (block << (3 * RUN_SHIFT)) | place


@kernel
def fill_runs(
    indices: Any, versions: Any, log_odds: Any, rows: Any, origin: Any, filled: Any
) -> int:
    """Put the evidence of voxels into runs.

    Args:
        indices: of voxels, shape (K, 3).
        versions: of their states, shape (K,).
        log_odds: likewise.
        rows: of these, shape (n,), so ordered that the voxels of a run follow each other.
        origin: of the message, a multiple of a run's length, shape (3,).
        filled: receive, with room for n runs, the index of the first voxel, uint8, shape (n, 3);
            the log-odds, int8, shape (n, 8); and the row of the first voxel that is sent, int64.

    Returns:
        Number of runs.
    """
    index, odds, first = filled
    used, last = 0, np.int64(-1)
    for row in rows:
        x = np.int64(indices[row, 0]) - origin[0]
        y = np.int64(indices[row, 1]) - origin[1]
        z = np.int64(indices[row, 2]) - origin[2]
        start = (((z << TILE_SHIFT) | y) << TILE_SHIFT) | (x & ~np.int64(7))
        if start != last or versions[row] != versions[first[used - 1]]:
            index[used, 0], index[used, 1], index[used, 2] = x & ~np.int64(7), y, z
            for i in range(8):
                odds[used, i] = NOT_SENT
            first[used] = row
            used, last = used + 1, start
        odds[used - 1, x & 7] = log_odds[row]
    return used


MAX_MESSAGE_BYTES = 1_000_000
OCCUPANCY_ROW = np.dtype([("index", "u1", (3,)), ("log_odds", "i1", (8,))])
SURFACE_ROW = np.dtype([("index", "u1", (3,)), ("log_odds", "i1"), *CODE_FIELDS])
_VERSIONED = tuple(
    np.dtype([*row.descr, ("version", "<u4")]) for row in (OCCUPANCY_ROW, SURFACE_ROW)
)
_LATER_FACTS = 100  # serial number, code and a longer name of the frame, at the most [bytes]
_TILE, _RUN = 1 << TILE_SHIFT, 1 << RUN_SHIFT  # [voxels]
_WHAT = "map update"


def encode_update(update: MapUpdate, max_bytes: int = MAX_MESSAGE_BYTES) -> list[NDArray[np.void]]:
    """Turn an update into the rows of as many messages as it takes.

    Args:
        update: what to send.
        max_bytes: upper limit of one message, with its fields.

    Returns:
        Row arrays, one a message, whose dtype is `OCCUPANCY_ROW` or `SURFACE_ROW` with the header.

    Raises:
        InvalidInputError: the states cannot be encoded.
    """
    update.check_states()
    messages = []
    for surface in (False, True):
        chosen = np.flatnonzero(update.has_gaussian == surface)
        for origin, rows in _tiles(update.indices, chosen):
            encode = _surface_rows if surface else _occupancy_rows
            messages += _split(encode(update, rows, origin), max_bytes)
    return messages


def _tiles(
    indices: NDArray[np.int32], rows: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Rows whose voxels fit a message's indices, in the order of blocks, with their corner.

    Corners are multiples of a run's length, so that a run never leaves its part.
    """
    if not len(rows):
        return
    origin, keys = np.zeros(3, np.int64), np.zeros(len(rows), np.int64)
    lowest_corner(indices, rows, origin)
    origin = origin // _RUN * _RUN
    order_of_blocks(indices, rows, origin, keys)
    order = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[order] >> ORDER_SHIFT)) + 1
    for part in np.split(rows[order], cuts):
        yield origin + (indices[part[0]] - origin) // _TILE * _TILE, part


def _facts(update: MapUpdate, version: int, origin: NDArray[np.int64]) -> dict[str, object]:
    header: dict[str, object] = {
        "robot": update.robot,
        "session": update.session,
        "version": version,
        "voxel_size": repr(float(update.voxel_size)),
    }
    for axis, value in zip("xyz", origin.tolist(), strict=True):
        header[f"origin_{axis}"] = value
    if update.sender is not None:
        header["sender"] = update.sender
    if update.origin:
        header["origin"] = update.origin
    return header


def _empty_rows(
    update: MapUpdate, rows: NDArray[np.int64], origin: NDArray[np.int64], kind: int, count: int
) -> NDArray[np.void]:
    versions = update.versions[rows]
    several = bool((versions != versions[0]).any())
    dtype = _VERSIONED[kind] if several else (OCCUPANCY_ROW, SURFACE_ROW)[kind]
    return np.zeros(count, dtype_with_header(dtype, _facts(update, int(versions[0]), origin)))


def _occupancy_rows(
    update: MapUpdate, rows: NDArray[np.int64], origin: NDArray[np.int64]
) -> NDArray[np.void]:
    room = len(rows)
    index, odds = np.empty((room, 3), np.uint8), np.empty((room, _RUN), np.int8)
    first = np.empty(room, np.int64)
    states = update.indices, update.versions, update.log_odds
    count = int(fill_runs(*states, rows, origin, (index, odds, first)))
    encoded = _empty_rows(update, rows, origin, 0, count)
    encoded["index"], encoded["log_odds"] = index[:count], odds[:count]
    if "version" in (encoded.dtype.names or ()):
        encoded["version"] = update.versions[first[:count]]
    return encoded


def _surface_rows(
    update: MapUpdate, rows: NDArray[np.int64], origin: NDArray[np.int64]
) -> NDArray[np.void]:
    encoded = _empty_rows(update, rows, origin, 1, len(rows))
    encoded["index"] = update.indices[rows] - origin
    encoded["log_odds"] = update.log_odds[rows]
    codes = codes_of_words(update.codes[rows])
    for name in CODE.names or ():
        encoded[name] = codes[name]
    if "version" in (encoded.dtype.names or ()):
        encoded["version"] = update.versions[rows]
    return encoded


def _split(rows: NDArray[np.void], max_bytes: int) -> list[NDArray[np.void]]:
    length = max(1, (max_bytes - message_bytes(rows[:0]) - _LATER_FACTS) // rows.dtype.itemsize)
    return [rows[start : start + length] for start in range(0, len(rows), length)]


def decode_update(rows: NDArray[np.void]) -> MapUpdate:
    """Read the rows of one message.

    Args:
        rows: shape (K,), with the fields of `OCCUPANCY_ROW` or `SURFACE_ROW` and the header.

    Raises:
        InvalidInputError: no rows, other fields, header that are missing or impossible, log-odds
            or voxels beyond their limits, or a Gaussian without spread.
    """
    if not len(rows):
        raise InvalidInputError(_WHAT, "holds no voxels")
    header = header_of(rows, _WHAT)
    table = without_header(rows, (OCCUPANCY_ROW, SURFACE_ROW, *_VERSIONED))
    version = whole_number(header, "version", 1, MAX_VERSION, _WHAT)
    is_surface = "mean" in (table.dtype.names or ())
    indices, log_odds, kept = _voxels_of(table, header, is_surface)
    versions = np.full(len(kept), version, np.uint32)
    if "version" in (table.dtype.names or ()):
        versions = table["version"][kept]
    sender = whole_number(header, "sender", 0, MAX_ROBOT, _WHAT) if "sender" in header else None
    update = MapUpdate(
        positive_number(header, "voxel_size", _WHAT),
        whole_number(header, "robot", 0, MAX_ROBOT, _WHAT),
        versions,
        indices,
        log_odds,
        _codes_of(table) if is_surface else np.zeros((len(kept), 2), np.uint64),
        whole_number(header, "session", 0, MAX_SESSION, _WHAT),
        sender,
        whole_number(header, "serial", 0, MAX_SERIAL, _WHAT) if "serial" in header else None,
        whole_number(header, "origin", 0, MAX_ORIGIN, _WHAT) if "origin" in header else 0,
    )
    update.check_states()
    return update


def _voxels_of(
    table: NDArray[np.void], header: dict[str, str], is_surface: bool
) -> tuple[NDArray[np.int32], NDArray[np.int8], NDArray[np.int64]]:
    """Indices and log-odds of the voxels, and the row of each."""
    limit = COORDINATE_LIMIT
    names = ("origin_x", "origin_y", "origin_z")
    origin = [whole_number(header, name, -limit, limit - 1, _WHAT) for name in names]
    corners = table["index"].astype(np.int32) + np.array(origin, np.int32)
    if is_surface:
        return corners, table["log_odds"].copy(), np.arange(len(table))
    row, place = np.nonzero(table["log_odds"] != NOT_SENT)
    indices = corners[row]
    indices[:, 0] += place.astype(np.int32)
    return indices, table["log_odds"][row, place], row


def _codes_of(table: NDArray[np.void]) -> NDArray[np.uint64]:
    if (table["log_sigma"] == 0).any():
        raise InvalidInputError(_WHAT, "a Gaussian has no spread")
    codes = np.zeros(len(table), CODE)
    for name in CODE.names or ():
        codes[name] = table[name]
    return words_of_codes(codes)
