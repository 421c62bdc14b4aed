"""The wire format of map updates: packed rows with named fields, for point clouds.

A row holds absolute states of voxels in their robot's contribution, never differences, with the
version at which they were taken (`infomap_ros.team.versions`). So a message may be lost, repeated
or come late: whoever keeps the newest version per robot and voxel is right. A robot takes a voxel
back by the log-odds `NOT_OBSERVED`.

Two layouts, told apart by their fields: `OCCUPANCY_ROW` holds eight neighbours along x, of which
those with the log-odds `NOT_TOLD` are left out, and `SURFACE_ROW` one voxel and the code of its
Gaussian (`infomap_ros.team.gaussian_code`). A message spans at most 256 voxels along each axis, so
that an index fits a byte; where it begins, whose it is, its version and the voxel size stand in
the name of one more field (`infomap_ros.team.facts`). States of several versions, as a robot
passes them on for another, have one more column.

All numbers are little endian.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT
from infomap_ros.team.facts import (
    dtype_with_facts,
    facts_of,
    positive_number,
    whole_number,
    without_facts,
)
from infomap_ros.team.gaussian_code import CODE, CODE_FIELDS, codes_of_words, words_of_codes
from infomap_ros.team.sent import message_bytes
from infomap_ros.team.update import (
    MAX_ROBOT,
    MAX_SERIAL,
    MAX_SESSION,
    MAX_VERSION,
    MapUpdate,
)

MAX_MESSAGE_BYTES = 1_000_000
NOT_TOLD = -127
"""Log-odds of a voxel of which a row says nothing."""

OCCUPANCY_ROW = np.dtype([("index", "u1", (3,)), ("log_odds", "i1", (8,))])
SURFACE_ROW = np.dtype([("index", "u1", (3,)), ("log_odds", "i1"), *CODE_FIELDS])
_VERSIONED = tuple(
    np.dtype([*row.descr, ("version", "<u4")]) for row in (OCCUPANCY_ROW, SURFACE_ROW)
)
_LATER_FACTS = 100  # serial number, code and a longer name of the frame, at the most [bytes]
_TILE, _RUN = 256, 8  # [voxels]
_BLOCKS = _TILE // _RUN
_WHAT = "map update"


def encode_update(update: MapUpdate, max_bytes: int = MAX_MESSAGE_BYTES) -> list[NDArray[np.void]]:
    """Turn an update into the rows of as many messages as it takes.

    Args:
        update: what to send.
        max_bytes: upper limit of one message, with its fields.

    Returns:
        Row arrays, one a message, whose dtype is `OCCUPANCY_ROW` or `SURFACE_ROW` with the facts.

    Raises:
        InvalidInputError: the states cannot be told.
    """
    update.check_states()
    messages = []
    for surface in (False, True):
        part = update.rows(update.has_gaussian == surface)
        for origin, tile in _tiles(part):
            encoded = _surface_rows(tile, origin) if surface else _occupancy_rows(tile, origin)
            messages += _split(encoded, max_bytes)
    return messages


def _tiles(update: MapUpdate) -> Iterator[tuple[NDArray[np.int64], MapUpdate]]:
    """Parts of an update that fit a message's indices, in the order of blocks, with their corner.

    Corners are multiples of a run's length, so that a run never leaves its part.
    """
    if not len(update.indices):
        return
    origin = update.indices.min(axis=0).astype(np.int64) // _RUN * _RUN
    relative = update.indices - origin
    order = np.argsort(_block_order(relative), kind="stable")
    tiles = (relative // _TILE)[order]
    cuts = np.flatnonzero((np.diff(tiles, axis=0) != 0).any(axis=1)) + 1
    for rows in np.split(order, cuts):
        yield origin + relative[rows[0]] // _TILE * _TILE, update.rows(rows)


def _block_order(relative: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers that grow along the parts, in them along the blocks, and in these along the runs."""
    tiles, blocks, places = relative // _TILE, relative // _RUN % _BLOCKS, relative % _RUN
    keys = np.zeros(len(relative), np.int64)
    for values, size in ((tiles, 1 << 13), (blocks, _BLOCKS), (places, _RUN)):
        for axis in (2, 1, 0):
            keys = keys * size + values[:, axis]
    return keys


def _facts(update: MapUpdate, origin: NDArray[np.int64]) -> dict[str, object]:
    facts: dict[str, object] = {
        "robot": update.robot,
        "session": update.session,
        "version": update.version,
        "voxel_size": repr(float(update.voxel_size)),
    }
    for axis, value in zip("xyz", origin.tolist(), strict=True):
        facts[f"origin_{axis}"] = value
    if update.sender is not None:
        facts["sender"] = update.sender
    return facts


def _empty_rows(
    update: MapUpdate, origin: NDArray[np.int64], kind: int, count: int
) -> NDArray[np.void]:
    several = bool((update.versions != update.versions[0]).any())
    dtype = _VERSIONED[kind] if several else (OCCUPANCY_ROW, SURFACE_ROW)[kind]
    return np.zeros(count, dtype_with_facts(dtype, _facts(update, origin)))


def _occupancy_rows(update: MapUpdate, origin: NDArray[np.int64]) -> NDArray[np.void]:
    relative = update.indices - origin
    starts = relative // (_RUN, 1, 1) * (_RUN, 1, 1)
    other = (np.diff(starts, axis=0) != 0).any(axis=1) | (np.diff(update.versions) != 0)
    run = np.concatenate([[0], np.cumsum(other)])
    first = np.concatenate([[0], np.flatnonzero(other) + 1])
    rows = _empty_rows(update, origin, 0, len(first))
    rows["index"] = starts[first]
    odds = np.full((len(first), _RUN), NOT_TOLD, np.int8)
    odds[run, relative[:, 0] % _RUN] = update.log_odds
    rows["log_odds"] = odds
    if "version" in (rows.dtype.names or ()):
        rows["version"] = update.versions[first]
    return rows


def _surface_rows(update: MapUpdate, origin: NDArray[np.int64]) -> NDArray[np.void]:
    rows = _empty_rows(update, origin, 1, len(update.indices))
    rows["index"] = update.indices - origin
    rows["log_odds"] = update.log_odds
    codes = codes_of_words(update.codes)
    for name in CODE.names or ():
        rows[name] = codes[name]
    if "version" in (rows.dtype.names or ()):
        rows["version"] = update.versions
    return rows


def _split(rows: NDArray[np.void], max_bytes: int) -> list[NDArray[np.void]]:
    length = max(1, (max_bytes - message_bytes(rows[:0]) - _LATER_FACTS) // rows.dtype.itemsize)
    return [rows[start : start + length] for start in range(0, len(rows), length)]


def decode_update(rows: NDArray[np.void]) -> MapUpdate:
    """Read the rows of one message.

    Args:
        rows: shape (K,), with the fields of `OCCUPANCY_ROW` or `SURFACE_ROW` and the facts.

    Raises:
        InvalidInputError: no rows, other fields, facts that are missing or impossible, log-odds
            or voxels beyond their limits, or a Gaussian without spread.
    """
    if not len(rows):
        raise InvalidInputError(_WHAT, "holds no voxels")
    facts = facts_of(rows, _WHAT)
    table = without_facts(rows, (OCCUPANCY_ROW, SURFACE_ROW, *_VERSIONED))
    version = whole_number(facts, "version", 1, MAX_VERSION, _WHAT)
    is_surface = "mean" in (table.dtype.names or ())
    indices, log_odds, kept = _voxels_of(table, facts, is_surface)
    versions = np.full(len(kept), version, np.uint32)
    if "version" in (table.dtype.names or ()):
        versions = table["version"][kept]
    sender = whole_number(facts, "sender", 0, MAX_ROBOT, _WHAT) if "sender" in facts else None
    update = MapUpdate(
        positive_number(facts, "voxel_size", _WHAT),
        whole_number(facts, "robot", 0, MAX_ROBOT, _WHAT),
        versions,
        indices,
        log_odds,
        _codes_of(table) if is_surface else np.zeros((len(kept), 2), np.uint64),
        whole_number(facts, "session", 0, MAX_SESSION, _WHAT),
        sender,
        whole_number(facts, "serial", 0, MAX_SERIAL, _WHAT) if "serial" in facts else None,
    )
    update.check_states()
    return update


def _voxels_of(
    table: NDArray[np.void], facts: dict[str, str], is_surface: bool
) -> tuple[NDArray[np.int32], NDArray[np.int8], NDArray[np.int64]]:
    """Indices and log-odds of the voxels, and the row of each."""
    limit = COORDINATE_LIMIT
    names = ("origin_x", "origin_y", "origin_z")
    origin = [whole_number(facts, name, -limit, limit - 1, _WHAT) for name in names]
    corners = table["index"].astype(np.int32) + np.array(origin, np.int32)
    if is_surface:
        return corners, table["log_odds"].copy(), np.arange(len(table))
    row, place = np.nonzero(table["log_odds"] != NOT_TOLD)
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
