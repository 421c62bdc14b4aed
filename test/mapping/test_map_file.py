"""The map file keeps what it is given, refuses what is damaged, and survives a killed process."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.errors import MapFileError
from infomap_ros.mapping.files.map_file import MAP_FILE_VERSION, read_map_file, write_map_file

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIG = {"voxel_size": 0.05, "threads": 2, "exact": True, "name": "café", "box": (1.0, 2.0)}


def example_arrays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {
        "keys": rng.integers(-(2**62), 2**62, size=7),
        "narrow": rng.integers(-128, 128, size=(3, 8), dtype=np.int8),
        "owner": np.array([2**32 - 1], dtype=np.uint32),
        "information": rng.normal(size=(4, 3)).astype(np.float32),
        "flags": np.array([True, False]),
        "empty": np.zeros((0, 9)),
        "scalar": np.array(3.5),
    }


@pytest.fixture
def saved(tmp_path, rng) -> Path:
    path = tmp_path / "room.map"
    write_map_file(path, CONFIG, example_arrays(rng))
    return path


def assert_same(arrays: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert list(arrays) == list(expected)
    for name, array in expected.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array, strict=True)


def test_what_is_read_is_what_was_written(saved):
    config, arrays = read_map_file(saved)
    assert config == CONFIG
    assert_same(arrays, example_arrays(np.random.default_rng(20050401)))
    assert all(array.flags.writeable for array in arrays.values())


def test_arrays_in_any_memory_order_and_byte_order(tmp_path, rng):
    values = rng.normal(size=(6, 5))
    arrays = {"transposed": values.T, "strided": values[::2, ::-1], "big": values.astype(">f8")}
    write_map_file(tmp_path / "a.map", {}, arrays)
    for name, array in read_map_file(tmp_path / "a.map")[1].items():
        np.testing.assert_array_equal(array, arrays[name])
        assert array.dtype == np.float64


@pytest.mark.parametrize(
    ("config", "arrays"),
    [
        ({"size": np.nan}, {}),
        ({"size": np.float32(1.0)}, {}),
        ({}, {"object": np.array([{}])}),
        ({}, {"text": np.array(["a"])}),
    ],
)
def test_what_cannot_be_stored_is_refused_and_the_old_file_kept(saved, config, arrays):
    before = saved.read_bytes()
    with pytest.raises(MapFileError, match=r"room\.map"):
        write_map_file(saved, config, arrays)
    assert saved.read_bytes() == before


def test_every_flipped_byte_is_refused(saved, rng):
    content = saved.read_bytes()
    for position, flip in enumerate(rng.integers(1, 256, size=len(content))):
        damaged = bytearray(content)
        damaged[position] ^= int(flip)
        saved.write_bytes(damaged)
        with pytest.raises(MapFileError, match=r"room\.map (is|has)"):
            read_map_file(saved)


def test_every_truncation_is_refused(saved):
    content = saved.read_bytes()
    for length in range(1, len(content)):
        saved.write_bytes(content[:length])
        with pytest.raises(MapFileError, match=r"room\.map is truncated"):
            read_map_file(saved)


def test_appended_bytes_are_refused(saved):
    saved.write_bytes(saved.read_bytes() + b"\0")
    with pytest.raises(MapFileError, match="corrupt"):
        read_map_file(saved)


@given(content=st.binary(max_size=400), start=st.sampled_from([b"", b"\x89INFOMAP"]))
def test_foreign_bytes_are_refused(tmp_path_factory, content, start):
    path = tmp_path_factory.getbasetemp() / "foreign.map"
    path.write_bytes(start + content)
    with pytest.raises(MapFileError, match=r"foreign\.map"):
        read_map_file(path)


def seal(header: object, payload: bytes = b"", version: int = MAP_FILE_VERSION) -> bytes:
    """A file with a right checksum, by the layout that the module documents."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    length = 24 + len(text) + len(payload) + 32
    body = b"\x89INFOMAP" + struct.pack("<IIQ", version, len(text), length) + text + payload
    return body + hashlib.sha256(body).digest()


def one_array(payload: bytes, **change: object) -> dict[str, object]:
    entry = {"name": "a", "dtype": "<f4", "shape": [2], "bytes": len(payload)} | change
    return {"config": {}, "arrays": [entry]}


def test_a_file_made_by_hand_is_read(tmp_path):
    payload = zlib.compress(struct.pack("<2f", 1.5, -2.0))
    (tmp_path / "hand.map").write_bytes(seal(one_array(payload), payload))
    _, arrays = read_map_file(tmp_path / "hand.map")
    np.testing.assert_array_equal(arrays["a"], np.float32([1.5, -2.0]))


PAYLOAD = zlib.compress(bytes(8))
IMPOSSIBLE = {
    "no json": (b"{", b""),
    "no text": (b"\xff\xfe", b""),
    "no object": ([], b""),
    "no config": ({"arrays": []}, b""),
    "no arrays": ({"config": {}}, b""),
    "deep": (b"[" * 100000, b""),
    "config is a list": ({"config": [1], "arrays": []}, b""),
    "no such type": (one_array(PAYLOAD, dtype="<x9"), PAYLOAD),
    "objects": (one_array(PAYLOAD, dtype="|O"), PAYLOAD),
    "too short": (one_array(PAYLOAD, shape=[3]), PAYLOAD),
    "too long": (one_array(PAYLOAD, shape=[1]), PAYLOAD),
    "huge": (one_array(PAYLOAD, shape=[2**62, 2**62]), PAYLOAD),
    "negative": (one_array(PAYLOAD, shape=[-1, -2]), PAYLOAD),
    "shape of floats": (one_array(PAYLOAD, shape=[2.0]), PAYLOAD),
    "negative length": (one_array(PAYLOAD, bytes=-5), PAYLOAD),
    "beyond the end": (one_array(PAYLOAD, bytes=10**6), PAYLOAD[:-1]),
    "not compressed": (one_array(PAYLOAD, bytes=8), bytes(8)),
    "left over": (one_array(PAYLOAD), PAYLOAD + b"x"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_impossible_content_under_a_right_checksum_is_refused(tmp_path, case):
    path = tmp_path / "crafted.map"
    path.write_bytes(seal(*IMPOSSIBLE[case]))
    with pytest.raises(MapFileError, match=r"crafted\.map"):
        read_map_file(path)


@pytest.mark.parametrize("version", [MAP_FILE_VERSION - 1, MAP_FILE_VERSION + 1])
def test_another_version_is_named(tmp_path, version):
    (tmp_path / "new.map").write_bytes(seal({"config": {}, "arrays": []}, version=version))
    with pytest.raises(
        MapFileError, match=rf"new\.map has version {version} .* reads {MAP_FILE_VERSION}"
    ):
        read_map_file(tmp_path / "new.map")


def test_missing_file_and_folder_are_named(tmp_path):
    with pytest.raises(MapFileError, match=r"none\.map: No such file"):
        read_map_file(tmp_path / "none.map")
    with pytest.raises(MapFileError, match="directory"):
        read_map_file(tmp_path)
    with pytest.raises(MapFileError, match=r"a\.map: No such file"):
        write_map_file(tmp_path / "none" / "a.map", {}, {})


def test_a_link_is_replaced_and_the_map_that_it_names_stays(saved, tmp_path):
    link, before = tmp_path / "latest.map", saved.read_bytes()
    link.symlink_to(saved)
    write_map_file(link, {"threads": 5}, {})
    assert not link.is_symlink()
    assert read_map_file(link)[0] == {"threads": 5}
    assert saved.read_bytes() == before


KILLED = """
import os, signal, sys
import numpy as np
from infomap_ros.mapping.files import map_file

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[2] == "compressing":
    map_file.zlib.compress = die
elif sys.argv[2] == "writing":
    map_file.hashlib.sha256 = lambda: type("Digest", (), {"update": lambda self, chunk: die()})()
elif sys.argv[2] == "on the way to the disk":
    os.fsync = die
else:
    map_file.Path.replace = die
map_file.write_map_file(sys.argv[1], {"threads": 9}, {"a": np.arange(100000)})
"""


@pytest.mark.parametrize("moment", ["compressing", "writing", "on the way to the disk", "renaming"])
def test_killed_process_leaves_the_old_file_whole(saved, moment):
    before = saved.read_bytes()
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(saved), moment], env=environment, check=False
    )
    assert killed.returncode == -signal.SIGKILL
    assert saved.read_bytes() == before
    write_map_file(saved, {"threads": 3}, {})
    assert read_map_file(saved)[0] == {"threads": 3}
    assert [path.name for path in saved.parent.iterdir()] == ["room.map"]


def test_failing_write_leaves_no_remains(saved, monkeypatch):
    before = saved.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MapFileError, match=r"room\.map: No space left"):
        write_map_file(saved, {}, {"a": np.zeros(100)})
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == ["room.map"]


def lying(path: Path, shape: list[int], payload: bytes) -> Path:
    """A whole file, its checksum right, that says of its one array what it likes."""
    entry = {"name": "a", "dtype": "|u1", "shape": shape, "bytes": len(payload)}
    header = json.dumps({"config": {}, "arrays": [entry]}).encode()
    length = 24 + len(header) + len(payload) + 32
    body = struct.pack("<8sIIQ", b"\x89INFOMAP", MAP_FILE_VERSION, len(header), length)
    body += header + payload
    path.write_bytes(body + hashlib.sha256(body).digest())
    return path


def test_an_array_that_its_bytes_cannot_hold_is_refused_before_it_is_unpacked(tmp_path) -> None:
    packed = zlib.compress(bytes(100_000_000), 9)
    with pytest.raises(MapFileError, match="are to hold arrays of 100000000 bytes"):
        read_map_file(lying(tmp_path / "a", [100_000_000], packed))
    with pytest.raises(MapFileError, match="are to hold"):
        read_map_file(lying(tmp_path / "a", [2**62, 2**62], zlib.compress(b"")))


def test_zeros_are_read_again(tmp_path) -> None:
    write_map_file(tmp_path / "a", {}, {"a": np.zeros(30_000_000, np.uint8)})
    assert len(read_map_file(tmp_path / "a")[1]["a"]) == 30_000_000
