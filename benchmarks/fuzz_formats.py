"""Files and messages of a valid structure and odd content: none may end the process or swell it.

    python benchmarks/fuzz_formats.py --seconds 3600

Every kind of file and message that is read is made up by hypothesis, well formed where that lets
it get further in: checksums are right, compressed parts unpack, texts parse. A case fails where
anything but an error of infomap_ros comes out of it, or where it takes more time or memory than
`SECONDS` and `BYTES` allow for its size. hypothesis reduces a case that fails to a small one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import struct
import tempfile
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from backports import zstd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from infomap_ros.errors import InfomapError
from infomap_ros.exploration.mission import Mission
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.map_file import MAP_FILE_VERSION
from infomap_ros.mapping.files.octomap_file import read_octree
from infomap_ros.messages import (
    POINT_CLOUD,
    RosbagsMessageTypes,
    decode_point_cloud,
    decode_pose_with_covariance,
)
from infomap_ros.messages.clouds import POINT_FIELD
from infomap_ros.messages.fiducials import decode_fiducials
from infomap_ros.messages.fields import make_header
from infomap_ros.messages.motions import KEYFRAME_ROW, decode_keyframe_covariances
from infomap_ros.messages.pose_uncertainty import POSE_UNCERTAINTY_ROW, decode_pose_uncertainty
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.simulation.body.saved_robot import SavedRobot

SECONDS = 5.0, 20e-6
"""Processor time of a case while memory is traced, and for each byte of it [s]: the grammar of a
bag's message definitions takes 1.4 s where two tests run at once."""

BYTES = 30_000_000, 500
"""Memory that a case may take at its peak, and for each byte of it. A map file may hold 230; a
chunk of a bag may state up to 256 MB, which is not tried."""

TYPES = RosbagsMessageTypes()
INTEGERS = st.one_of(
    st.integers(-3, 70),
    st.sampled_from([2**k + d for k in (15, 16, 20, 31, 32, 53, 62, 63, 64) for d in (-1, 0, 1)]),
    st.sampled_from([-1, -(2**31), -(2**63), 10**400]),
)
NUMBERS = st.one_of(st.floats(), st.sampled_from([0.0, 1.0, 1e-300, 1e300]), INTEGERS)
TEXTS = st.one_of(st.text(max_size=8), st.sampled_from(["", "map", "a\0b", "../x", "é" * 300]))
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS),
    lambda inner: st.one_of(st.lists(inner, max_size=8), st.dictionaries(TEXTS, inner, max_size=4)),
    max_leaves=12,
)
DEEP = st.builds(
    lambda n, pair: pair[0] * n + pair[1] * n,
    st.sampled_from([100, 100_000]),
    st.sampled_from(["[]", ('{"a":', "}")]),
)

Case = tuple[str, bytes]
Reader = Callable[[Path], object]


def some_of(valid: dict[str, Any]) -> st.SearchStrategy[bytes]:
    """A JSON object as it should be, with other values in some of its places."""
    odd = st.dictionaries(st.sampled_from(sorted(valid)), JSON, max_size=3)
    changed = st.builds(lambda other: json.dumps({**valid, **other}).encode(), odd)
    return st.one_of(changed, DEEP.map(str.encode), JSON.map(lambda j: json.dumps(j).encode()))


def map_files() -> st.SearchStrategy[bytes]:
    """Map files and states of localization, their checksum right."""
    with tempfile.TemporaryDirectory() as folder:
        whole = VoxelMap()
        whole.integrate(np.random.default_rng(0).normal(2.0, 0.5, (200, 3)), np.eye(4))
        whole.save(Path(folder) / "a")
        data = (Path(folder) / "a").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    header, body = json.loads(data[24 : 24 + length]), data[24 + length : -32]
    start, arrays = 0, []
    for entry in header["arrays"]:
        arrays.append((entry, zlib.decompress(body[start : start + entry["bytes"]])))
        start += entry["bytes"]

    @st.composite
    def one(draw: Any) -> bytes:
        config = {
            **header["config"],
            **draw(st.dictionaries(st.sampled_from(sorted(header["config"])), JSON, max_size=2)),
        }
        if draw(st.booleans()):
            config = draw(st.sampled_from([config, {"kind": "localization"}, JSON]))
            config = draw(config) if isinstance(config, st.SearchStrategy) else config
        entries, payloads = [], []
        for entry, raw in arrays:
            changed = dict(entry)
            if draw(st.integers(0, 5)) == 0:
                value = draw(st.sampled_from(["shape", "dtype", "raw", "name", "level"]))
                if value == "shape":
                    changed["shape"] = draw(st.lists(INTEGERS, max_size=4))
                elif value == "dtype":
                    changed["dtype"] = draw(
                        st.sampled_from(["<f8", "|u1", "<i8", "|O", "<U9", "x"])
                    )
                elif value == "name":
                    changed["name"] = draw(TEXTS)
                elif value == "raw":
                    raw = (
                        draw(st.binary(min_size=len(raw), max_size=len(raw)))
                        if len(raw) < 4096
                        else bytes(len(raw))
                    )
            packed = zlib.compress(raw, draw(st.sampled_from([1, 9])))
            entries.append({**changed, "bytes": len(packed)})
            payloads.append(packed)
        text = json.dumps({"config": config, "arrays": entries}).encode()
        content = text + b"".join(payloads)
        head = b"\x89INFOMAP", MAP_FILE_VERSION, len(text), 24 + len(content) + 32
        content = struct.pack("<8sIIQ", *head) + content
        return content + hashlib.sha256(content).digest()

    return one()


def octrees() -> st.SearchStrategy[bytes]:
    """Binary OctoMap files."""
    states = st.lists(st.integers(0, 2**16 - 1), max_size=300).map(
        lambda s: struct.pack(f"<{len(s)}H", *s)
    )
    return st.builds(
        lambda size, res, data: (
            b"# Octomap OcTree binary file\nid OcTree\nsize %s\nres %s\ndata\n"
            % (str(size).encode(), str(res).encode())
            + data
        ),
        INTEGERS,
        NUMBERS,
        states,
    )


def bags() -> st.SearchStrategy[bytes]:
    """MCAP files without an index: records, chunks and messages with lengths of any size."""
    lengths = st.one_of(st.none(), st.sampled_from([0, 1, 2**31, 2**50, 2**63, 2**64 - 1]))
    text = TEXTS.map(lambda t: struct.pack("<I", len(t.encode())) + t.encode())

    @st.composite
    def record(draw: Any, nested: bool = False) -> bytes:
        kind = draw(st.sampled_from([2, 3, 4, 5] if nested else [1, 2, 3, 4, 5, 6, 6, 8, 15]))
        number = struct.pack("<H", draw(st.integers(0, 3)))
        if kind == 3:
            content = number + draw(text) + draw(text) + draw(text)
        elif kind == 4:
            content = number + number + draw(text) + draw(text) + struct.pack("<I", 0)
        elif kind == 5:
            content = number + struct.pack("<IQQ", 0, draw(st.integers(0, 2**64 - 1)), 1)
            content += draw(st.binary(max_size=60))
        elif kind == 6:
            inner = b"".join(draw(st.lists(record(nested=True), max_size=4)))
            stated = draw(st.sampled_from([None, 0, 1, 1000, 2**40, 2**64 - 1]))
            inner += bytes(draw(st.sampled_from([0, 0, 50_000_000 if stated is not None else 0])))
            stated = len(inner) if stated is None else stated
            packing = draw(st.sampled_from([b"", b"zstd", b"lz4"]))
            packed = zstd.compress(inner, 1) if packing == b"zstd" else inner[:10_000]
            content = struct.pack("<QQQI", 0, 1, stated, 0) + struct.pack("<I", len(packing))
            content += packing + struct.pack("<Q", len(packed)) + packed
        else:
            content = draw(st.binary(max_size=40))
        stated = draw(lengths)
        return struct.pack("<BQ", kind, len(content) if stated is None else stated) + content

    return st.lists(record(), max_size=6).map(lambda r: b"\x89MCAP0\r\n" + b"".join(r))


def read_bag(path: Path) -> None:
    """Read all of a bag."""
    with BagReader(path) as bag:
        list(bag.records())


def descriptions() -> st.SearchStrategy[bytes]:
    """Robot descriptions."""
    number = st.one_of(NUMBERS.map(str), st.sampled_from(["", "x", "1 2 3", "0x1p3"]))
    three = st.one_of(st.just("0 0 0"), st.lists(number, max_size=4).map(" ".join))

    @st.composite
    def one(draw: Any) -> bytes:
        count = draw(st.sampled_from([1, 2, 3, 5, 300, 3000]))
        kinds = st.sampled_from(["fixed", "continuous", "revolute", "prismatic", "planar"])
        inside = "".join(
            f"<collision>{origin}<geometry>{shape}</geometry></collision>"
            for origin, shape in draw(
                st.lists(
                    st.tuples(
                        three.map(lambda t: f'<origin xyz="{t}"/>'),
                        st.one_of(
                            number.map(lambda n: f'<sphere radius="{n}"/>'),
                            three.map(lambda t: f'<box size="{t}"/>'),
                            number.map(lambda n: f'<cylinder radius="{n}" length="1"/>'),
                            st.just('<mesh filename="package://none/a.stl"/>'),
                            st.just('<mesh filename="/dev/zero"/>'),
                        ),
                    ),
                    max_size=2,
                )
            )
        )
        kind, origin, chained = draw(kinds), draw(three), draw(st.booleans())
        limit = f'<limit lower="{draw(number)}" upper="{draw(number)}" effort="1" velocity="1"/>'
        links = "".join(
            f'<link name="l{k}">{inside if k == 0 else ""}</link>' for k in range(count)
        )
        joints = "".join(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1 if chained else 0}"/>'
            f'<child link="l{k}"/><origin xyz="{origin}"/>{limit}</joint>'
            for k in range(1, count)
        )
        text = f'<robot name="r">{links}{joints}</robot>'
        return draw(st.sampled_from([text, text[:-9], "<a>" * 5000 + text])).encode(
            "utf-8", "replace"
        )

    return one()


MISSION = {
    "views": 1,
    "distance": 1.0,
    "seconds": 1.0,
    "home_base": [0, 0, 0],
    "home_joints": {"a": 0.0},
    "look_base": [],
    "look_joints": {},
    "home_pose": [],
    "looks": [[0.0, 0, 0, 0, 0, 0, 1]],
}
ROBOT = {
    "seconds": 1.0,
    "contacts": 0,
    "body": {"q": [0.0]},
    "odometry": {"x": [0.0]},
    "world": "mars",
}

FILES: dict[str, tuple[str, Callable[[], st.SearchStrategy[bytes]], Reader]] = {
    "map": ("a.infomap", map_files, VoxelMap.load),
    "localization": ("a.state", map_files, SavedLocalization.load),
    "octree": ("a.bt", octrees, lambda path: read_octree(path).edges),
    "bag": ("a.mcap", bags, read_bag),
    "description": ("a.urdf", descriptions, RobotModel.from_urdf),
    "mission": ("mission.json", lambda: some_of(MISSION), Mission.load),
    "robot": ("robot.json", lambda: some_of(ROBOT), SavedRobot.load),
}


def clouds() -> st.SearchStrategy[Any]:
    """Point clouds: rows that are right in form, and clouds whose parts contradict each other."""
    dtypes = st.sampled_from([POSE_UNCERTAINTY_ROW, KEYFRAME_ROW, np.dtype([("x", "<f4")])])
    filling = st.sampled_from([0, 1, 0x7F, 0xFF])
    whole = st.builds(
        lambda dtype, n, byte: encode_rows(
            TYPES, 1, "map", np.frombuffer(bytes([byte]) * (n * dtype.itemsize), dtype)
        ),
        dtypes,
        st.integers(0, 40),
        filling,
    )
    sizes = st.sampled_from([0, 1, 4, 12, 16, 1000, 2**16, 2**31, 2**32 - 1])
    names = st.sampled_from(["x", "y", "z", "rgb", "cov_xx", "cov_xy", "", "x"])
    field = st.builds(
        lambda name, offset, kind, count: TYPES.make(
            POINT_FIELD, name=name, offset=offset, datatype=kind, count=count
        ),
        names,
        sizes,
        st.integers(0, 12),
        sizes,
    )
    odd = st.builds(
        lambda height, width, fields, step, row, data, big: TYPES.make(
            POINT_CLOUD,
            header=make_header(TYPES, 1, "map"),
            height=height,
            width=width,
            fields=fields,
            is_bigendian=big,
            point_step=step,
            row_step=row,
            data=np.frombuffer(data, np.uint8),
            is_dense=True,
        ),
        sizes,
        sizes,
        st.lists(field, max_size=6),
        sizes,
        sizes,
        st.binary(max_size=200),
        st.booleans(),
    )
    return st.one_of(whole, odd)


DECODERS = (
    decode_rows,
    decode_pose_uncertainty,
    decode_keyframe_covariances,
    decode_fiducials,
    decode_point_cloud,
    decode_pose_with_covariance,
)


def judge(size: int, read: Callable[[], object]) -> None:
    """Read a case.

    Args:
        size: of the case [byte].
        read: does it.

    Raises:
        AssertionError: it took too long or too much memory.
        Exception: anything but an error of infomap_ros that came out of it.
    """
    seconds, peak = _cost_of(read)
    if not _is_cheap(size, seconds, peak):  # what is loaded at the first use counts once
        seconds, peak = _cost_of(read)
    assert _is_cheap(size, seconds, peak), f"{seconds:.2f} s and {peak} bytes for {size} bytes"


def _is_cheap(size: int, seconds: float, peak: int) -> bool:
    return seconds < SECONDS[0] + SECONDS[1] * size and peak < BYTES[0] + BYTES[1] * size


def _cost_of(read: Callable[[], object]) -> tuple[float, int]:
    """Processor time [s] of the reading thread and largest memory [byte] of a case."""
    tracemalloc.start()
    begin = time.thread_time()
    try:
        read()
    except InfomapError:
        pass
    finally:
        seconds, peak = time.thread_time() - begin, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return seconds, peak


def check_file(kind: str, count: int) -> None:
    """Try so many files of a kind; raises what `judge` raises of the smallest that fails."""
    name, cases, reader = FILES[kind]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name

        @settings(
            max_examples=count,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(cases())
        def try_one(content: bytes) -> None:
            path.write_bytes(content)
            judge(len(content), lambda: reader(path))

        try_one()


def check_messages(count: int) -> None:
    """Try so many clouds on each decoder; raises as `check_file`."""

    @settings(
        max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(clouds())
    def try_one(message: Any) -> None:
        for decoder in DECODERS:
            judge(len(message.data), lambda decoder=decoder: decoder(message))

    try_one()


def main() -> None:
    """Try all kinds in turn until the time is up."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--round", type=int, default=500, help="cases of a kind in one round")
    arguments = parser.parse_args()
    end, rounds = time.monotonic() + arguments.seconds, 0
    while time.monotonic() < end:
        for kind in FILES:
            check_file(kind, arguments.round)
        check_messages(arguments.round)
        rounds += 1
        tried = rounds * arguments.round
        print(f"{tried} files of each of {len(FILES)} kinds, {tried} messages: sound", flush=True)


if __name__ == "__main__":
    main()
