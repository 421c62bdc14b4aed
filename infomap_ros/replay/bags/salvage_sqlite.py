"""Reads what SQLite still finds in a damaged ``.db3`` file, message by message."""

from __future__ import annotations

import sqlite3
import struct
from functools import partial
from pathlib import Path
from typing import Any

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.blocks import RawMessage, Salvage
from infomap_ros.replay.bags.source import Channel, absolute, is_latched_by_custom

_BLOCK = 64
_MANY_LOST = 10_000


def stated_size(path: Path) -> int:
    """Size that a SQLite file says it has [byte]; 0 where it says nothing."""
    with path.open("rb") as file:
        header = file.read(100)
    if len(header) < 100 or not header.startswith(b"SQLite format 3\0"):
        return 0
    page_size, pages = (
        struct.unpack_from(">H", header, 16)[0],
        struct.unpack_from(">I", header, 28)[0],
    )
    return int(pages) * (65536 if page_size == 1 else int(page_size))


def salvage_sqlite(path: Path) -> Salvage:
    """Find everything that can be read in a rosbag2 SQLite file.

    Raises:
        BagError: it is no SQLite file, or its list of topics is lost.
    """
    salvage = Salvage()
    database = _connect(path)
    try:
        salvage.channels = _channels(database)
        lost = _note_messages(path, database, salvage)
    except (sqlite3.Error, ValueError, TypeError, AttributeError) as error:
        raise BagError(f"{path.name} is not a readable rosbag2 SQLite file: {error}") from error
    finally:
        database.close()
    if lost:
        salvage.problems.append(
            f"{path.name} is damaged: messages cannot be read (at least {lost})"
        )
    return salvage


def _connect(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)


def _channels(database: sqlite3.Connection) -> dict[int, Channel]:
    columns = [row[1] for row in database.execute("PRAGMA table_info(topics)")]
    if not columns:
        raise sqlite3.DatabaseError("it has no table of topics")
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    definitions = {}
    if database.execute("PRAGMA table_info(message_definitions)").fetchall():
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {name: (text, kind) for name, kind, text in database.execute(query)}
    return {
        number: Channel(
            topic=absolute(topic),
            type_name=type_name,
            count=0,
            latched="durability: 1" in profiles
            or "transient_local" in profiles
            or is_latched_by_custom(topic),
            definition=definitions.get(type_name, ("", ""))[0],
            is_idl=definitions.get(type_name, ("", ""))[1] == "ros2idl",
        )
        for number, topic, type_name, profiles in database.execute(
            f"SELECT id, name, type, {qos} FROM topics"
        )
    }


def _note_messages(path: Path, database: sqlite3.Connection, salvage: Salvage) -> int:
    """Note the messages in blocks; how many of those that should be there cannot be read."""
    last = _last_message(database)
    lost, number = 0, 1
    while last is None or number <= last:
        block, missing = _read_block(database, number, number + _BLOCK)
        salvage.add_block(block, partial(_load_block, path, number))
        lost += missing
        if last is None and missing:
            break
        number += _BLOCK
        if lost > _MANY_LOST and not block:
            break
    return lost


def _last_message(database: sqlite3.Connection) -> int | None:
    try:
        return int(database.execute("SELECT MAX(id) FROM messages").fetchone()[0] or 0)
    except sqlite3.DatabaseError:
        return None


def _read_block(
    database: sqlite3.Connection, first: int, stop: int
) -> tuple[list[RawMessage], int]:
    """Messages with first <= id < stop, and how many of them are lost."""
    query = "SELECT timestamp, topic_id, data FROM messages WHERE id = ?"
    found, lost = [], 0
    for number in range(first, stop):
        try:
            row: Any = database.execute(query, (number,)).fetchone()
        except sqlite3.DatabaseError:
            lost += 1
            continue
        if row is not None:
            found.append((int(row[0]), int(row[1]), bytes(row[2])))
    return sorted(found, key=lambda message: message[0]), lost


def _load_block(path: Path, first: int) -> list[RawMessage]:
    database = _connect(path)
    try:
        return _read_block(database, first, first + _BLOCK)[0]
    finally:
        database.close()
