"""Mutated messages of a team: none may end the process, none that is refused may change the map.

    python benchmarks/fuzz_team.py --count 1000000

Every message is a whole one of a real map with one to four changes: bytes of the rows, names,
types, offsets and counts of fields, sizes, facts, rows that are repeated. Half of them go to a
robot without, half to one with a team key, which has to refuse them all.
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from collections import Counter
from typing import Any

import numpy as np

from infomap_ros.errors import InfomapError, UpdateRefusedError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.messages import RosbagsMessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import CellDigest, Freshness, Request
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import TeamKey

TYPES = RosbagsMessageTypes()
CONFIG = VoxelMapConfig(voxel_size=0.1)
KEY = TeamKey(b"a key for the fuzzing of teams")
VICTIM = 3


def make_messages(key: TeamKey | None) -> list[Any]:
    """What a robot tells of a small map: updates, digests and a summary."""
    rng = np.random.default_rng(1)
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (60, 2)), np.full(60, 0.8)])
    own.integrate(points, np.eye(4))
    member = TeamMember(7, 1, 1000, CONFIG, TeamConfig(message_size=1400))
    member.begin(own)
    rows = member.updates(own, 0.0) + member.digests(0.0)
    signed = [key.sign(part) if key else part for part in rows]
    return [encode_rows(TYPES, 0, "map", part) for part in signed]


def ask_for_blocks(key: TeamKey | None) -> list[Any]:
    """What a robot that holds half of that tells and asks of it: the victim's own blocks, too."""
    corners = np.array([[x, y, 0] for x in range(-4, 4) for y in range(-4, 4)], np.int32)
    hashes = np.arange(1, 1 + len(corners), dtype=np.uint32)
    rows = [
        part
        for robot in (VICTIM, 7)
        for level in (0, 3)
        for part in (
            *CellDigest(7, 1, robot, 1000, 5, level, corners, hashes).encode(1400),
            *Request(7, 1, VICTIM, 2, robot, "cells", level, 0, corners).encode(1400),
            *Request(7, 1, VICTIM, 2, robot, "states", 0, level, corners).encode(1400),
        )
    ]
    signed = [key.sign(part) if key else part for part in rows]
    return [encode_rows(TYPES, 0, "map", part) for part in signed]


def mutated(message: Any, rng: np.random.Generator) -> Any:
    """The message with one to four changes."""
    other = copy.copy(message)
    other.fields = [copy.copy(field) for field in message.fields]
    for _ in range(rng.integers(1, 5)):
        field = other.fields[rng.integers(len(other.fields))]
        what = rng.integers(11)
        if what == 10 and len(other.data) >= 2 * other.point_step > 0:
            data = np.array(other.data, np.uint8)  # a row a second time, in place of another
            rows = data[: len(data) // other.point_step * other.point_step]
            rows = rows.reshape(-1, other.point_step)
            rows[rng.integers(len(rows))] = rows[rng.integers(len(rows))]
            other.data = data
        elif what < 4 and len(other.data):
            data = np.array(other.data, np.uint8)
            data[rng.integers(len(data))] ^= rng.integers(1, 256)
            other.data = data
        elif what < 7:
            text = list(field.name)
            text[rng.integers(len(text))] = chr(rng.integers(32, 127))
            field.name = "".join(text)
        elif what == 7:
            name = ("offset", "datatype", "count")[rng.integers(3)]
            setattr(field, name, int(rng.integers(0, 20)))
        elif what == 8:
            name = ("width", "height", "point_step", "row_step")[rng.integers(4)]
            setattr(other, name, int(rng.integers(0, 2000)))
        else:
            other.data = np.array(other.data, np.uint8)[: rng.integers(len(other.data) + 1)]
    return other


def receive(member: TeamMember, key: TeamKey | None, message: Any) -> None:
    """As a node does; what kind of message it is its facts say. That it is repeated is forgiven."""
    member._freshness = Freshness()
    rows = decode_rows(message)[2]
    if key is not None:
        rows = key.verify(rows)
    if any("digest=" in name for name in rows.dtype.names or ()):
        member.receive_digest(rows, 1.0)
    elif any("request=" in name for name in rows.dtype.names or ()):
        member.receive_request(rows, 1.0)
    else:
        member.receive_update(rows, 1.0)


def identity(message: Any) -> tuple[bytes, str]:
    """What a message says; some changes, as of a count of 1 to 0, change nothing of that."""
    rows = decode_rows(message)[2]
    return rows.tobytes(), repr(rows.dtype)


def fuzz(count: int, seed: int, key: TeamKey | None) -> Counter[str]:
    """Send mutated messages; returns what became of them."""
    rng = np.random.default_rng(seed)
    messages, results = make_messages(key) + ask_for_blocks(key), Counter[str]()
    originals = {identity(message) for message in messages}
    member = TeamMember(VICTIM, 2, 1000, CONFIG)
    for message in messages[: len(messages) // 2]:
        receive(member, key, message)
    before = member.replica.hash()
    for _ in range(count):
        message = mutated(messages[rng.integers(len(messages))], rng)
        try:
            receive(member, key, message)
            if identity(message) in originals:
                results["as it was"] += 1
            else:
                results["taken for genuine"] += 1
            before = member.replica.hash()
        except InfomapError as error:
            reason = error.reason if isinstance(error, UpdateRefusedError) else type(error).__name__
            results[f"refused: {reason}"] += 1
            if member.replica.hash() != before:
                results["REFUSED AND CHANGED THE MAP"] += 1
    return results


def main() -> int:
    """Run; exits with 1 when the map changed where it must not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    start, half = time.monotonic(), arguments.count // 2
    plain = fuzz(arguments.count - half, arguments.seed, None)
    signed = fuzz(half, arguments.seed + 1, KEY)
    print(json.dumps({"without key": plain, "with key": signed}, indent=1))
    print(f"{arguments.count} messages in {time.monotonic() - start:.0f} s")
    wrong = plain["REFUSED AND CHANGED THE MAP"] + signed["REFUSED AND CHANGED THE MAP"]
    return int(wrong + signed["taken for genuine"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
