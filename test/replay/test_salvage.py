"""Damaged bags say what is wrong and still give what is whole."""

from __future__ import annotations

import sqlite3
import struct
import tracemalloc
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.reader import BagReader, BagRecord
from infomap_ros.replay.bags.source import unpacked_chunk
from infomap_ros.replay.bags.writer import BagWriter

from .bags import FRAMES, sample_records, write_rosbag1, write_rosbag2

RECORDS = sample_records()
SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}


def written(tmp_path: Path, form: str) -> Path:
    """Path of the one file that holds the messages."""
    if form.startswith("rosbag1"):
        compression = {"rosbag1": None, "rosbag1-lz4": "LZ4"}[form]
        return write_rosbag1(tmp_path / "bag.bag", RECORDS, compression)
    with BagWriter(tmp_path / "bag", storage=form) as writer:
        for topic, record in RECORDS:
            writer.write(topic, record)
    return tmp_path / "bag" / f"bag{SUFFIXES[form]}"


def cut(path: Path, share: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


def read(path: Path) -> tuple[list[BagRecord], list[str]]:
    with BagReader(path) as bag:
        return list(bag.records()), bag.problems


def check_part(found: list[BagRecord], low: int, high: int) -> None:
    """Some of the sample, nothing twice, nothing altered, in order of time."""
    truth = {(topic, record.stamp): record for topic, record in RECORDS}
    keys = [(f.topic, f.record.stamp) for f in found]
    assert len(keys) == len(set(keys))
    assert [f.received for f in found] == sorted(f.received for f in found)
    assert low <= len(found) <= high
    for entry in found:
        original = truth[entry.topic, entry.record.stamp]
        if entry.topic == "/left/image_raw":
            np.testing.assert_array_equal(entry.record.pixels, original.pixels)


@pytest.mark.parametrize("form", ["mcap", "sqlite3", "rosbag1", "rosbag1-lz4"])
@pytest.mark.parametrize("share", [0.35, 0.8])
def test_truncated_file(tmp_path, form, share):
    path = written(tmp_path, form)
    cut(path, share)
    found, problems = read(path)
    assert any("truncated" in p or "damaged" in p for p in problems), problems
    total = 1 + 3 * FRAMES
    check_part(found, int(total * (share - 0.3)), int(total * (share + 0.1)))


@pytest.mark.parametrize("form", ["mcap", "sqlite3"])
def test_truncated_file_in_its_folder(tmp_path, form):
    path = written(tmp_path, form)
    cut(path, 0.8)
    found, problems = read(path.parent)
    assert problems
    check_part(found, FRAMES, 3 * FRAMES)


def test_recording_that_was_killed_before_metadata(tmp_path):
    path = written(tmp_path, "mcap")
    (path.parent / "metadata.yaml").unlink()
    found, problems = read(path.parent)
    assert any("metadata.yaml" in p for p in problems)
    check_part(found, 1 + 3 * FRAMES, 1 + 3 * FRAMES)


def test_foreign_metadata_does_not_lose_the_messages(tmp_path):
    path = written(tmp_path, "mcap")
    (path.parent / "metadata.yaml").write_text("name: my favorite robot\n")
    found, problems = read(path.parent)
    assert problems
    check_part(found, 1 + 3 * FRAMES, 1 + 3 * FRAMES)


def test_compressed_file_that_was_cut(tmp_path):
    folder = write_rosbag2(tmp_path / "b", StoragePlugin.MCAP, CompressionMode.FILE, RECORDS)
    cut(folder / "b.mcap.zstd", 0.7)
    found, problems = read(folder)
    assert problems
    check_part(found, FRAMES // 2, 3 * FRAMES)


@pytest.mark.parametrize("form", ["mcap", "rosbag1-lz4"])
def test_damage_in_the_middle_costs_one_block(tmp_path, form):
    path = written(tmp_path, form)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = bytes(2000)
    path.write_bytes(data)
    found, problems = read(path)
    assert any("damaged" in p for p in problems), problems
    check_part(found, FRAMES, 3 * FRAMES)
    assert found[-1].received == max(r.stamp for _, r in RECORDS)


def test_nothing_whole_is_an_error(tmp_path):
    path = written(tmp_path, "mcap")
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(BagError, match="truncated"):
        BagReader(path)


def test_truncated_real_bag(real_data, tmp_path):
    data = (real_data / "bags" / "nav2_turtlebot.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(0.6 * len(data))])
    found, problems = read(path)
    assert problems
    assert len(found) > 3000


@pytest.mark.parametrize("form", ["mcap", "sqlite3", "rosbag1"])
def test_random_damage_never_raises_anything_else(tmp_path, form):
    path = written(tmp_path, form)
    original = path.read_bytes()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        data = bytearray(original)
        for place in rng.integers(0, len(data), rng.integers(1, 200)):
            data[place] = rng.integers(0, 256)
        if seed % 3 == 0:
            head = rng.integers(0, 400, 3)
            data[head[0]] ^= 0xFF
        path.write_bytes(data)
        try:
            found, _ = read(path)
        except BagError:
            continue
        assert len(found) <= 1 + 3 * FRAMES + 5


def mcap_of(path: Path, *records: tuple[int, int, bytes]) -> Path:
    """An MCAP file of records: opcode, stated length, content."""
    body = b"".join(struct.pack("<BQ", op, length) + content for op, length, content in records)
    path.write_bytes(b"\x89MCAP0\r\n" + body)
    return path


def chunk(stated: int, packed: bytes) -> tuple[int, int, bytes]:
    content = struct.pack("<QQQI", 0, 1, stated, 0) + struct.pack("<I", 4) + b"zstd"
    content += struct.pack("<Q", len(packed)) + packed
    return 6, len(content), content


BOMB = zstd.compress(bytes(1_000_000_000), 3)  # 30 kB


@pytest.mark.parametrize(
    "records",
    [
        [(6, 2**50, b"")],
        [(1, 2**31, b"")],
        [(6, 2**63, b"x")],
        [(4, 2**64 - 1, b"x")],
        [chunk(1_000_000_000, BOMB)],
        [chunk(1000, BOMB)],
        [chunk(0, BOMB)] * 20,
        [chunk(2**63, b"")],
    ],
)
def test_a_bag_that_lies_about_sizes_costs_no_more_than_it_has(tmp_path, records):
    path = mcap_of(tmp_path / "a.mcap", *records)
    tracemalloc.start()
    try:
        with pytest.raises(BagError, match=r"a\.mcap"):
            BagReader(path)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunks_are_unpacked_to_what_they_state(compression):
    content = np.random.default_rng(0).bytes(100_000) + bytes(1_000_000)
    packed = {"zstd": zstd.compress, "lz4": lz4.frame.compress}[compression](content)
    assert unpacked_chunk(compression, packed, len(content)) == content
    for less in (0, 10, len(content) - 1):
        with pytest.raises(ValueError, match="more than"):
            unpacked_chunk(compression, packed, less)
    assert content.startswith(unpacked_chunk(compression, packed[:-50], len(content)))


def test_a_database_that_never_ends_is_refused(tmp_path):
    path = written(tmp_path, "sqlite3")
    database = sqlite3.connect(path)
    database.executescript(
        "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS "
        "(SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n;"
    )
    database.close()
    for each in (path, path.parent):
        with pytest.raises(BagError, match=r"bag\.db3.*'messages' is computed"):
            BagReader(each)


def test_a_topic_that_is_no_text_is_a_bag_error(tmp_path):
    path = written(tmp_path, "sqlite3")
    database = sqlite3.connect(path)
    database.execute("UPDATE topics SET name = CAST(x'ff00ff' AS TEXT)")
    database.commit()
    database.close()
    with pytest.raises(BagError):
        BagReader(path)
