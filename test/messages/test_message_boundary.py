"""Whatever arrives at the decoders, only `MalformedMessageError` comes out."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from infomap_ros import messages as ms
from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PointCloudRecord,
    PoseRecord,
    Record,
    TextRecord,
    TransformRecord,
)

TYPES = ms.RosbagsMessageTypes()
ENCODINGS = ["mono8", "rgb8", "16UC1", "32FC1", "bayer_rggb8", "bayer_grbg16", "yuv422", "?", ""]


def examples() -> list[tuple[str, Any]]:
    points = np.arange(36, dtype=np.float32).reshape(3, 4, 3)
    matrices = np.broadcast_to(np.eye(3, dtype=np.float32), (3, 4, 3, 3))
    colors = np.zeros((3, 4, 3), np.uint8)
    records: list[Record] = [
        ImageRecord(1, "c", np.zeros((4, 6, 3), np.uint8), "rgb8"),
        CameraInfoRecord(1, "c", CameraCalibration(6, 4, "plumb_bob", np.zeros(5))),
        PointCloudRecord(1, "c", points, matrices, colors),
        PoseRecord(1, "m", np.eye(4), np.eye(6)),
        OdometryRecord(1, "m", np.eye(4), np.eye(6), "b", np.zeros(6), np.eye(6)),
        JointStateRecord(1, "", ("a", "b"), np.zeros(2), np.zeros(2)),
        TransformRecord(1, "a", "b", np.eye(4)),
        TextRecord(1, "", "text"),
    ]
    return [(ms.message_type_of(record), ms.encode(TYPES, record)) for record in records]


EXAMPLES = examples()

WRONG_VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.integers(0, 64),
    st.floats(),
    st.just(10**400),
    st.text(max_size=4),
    st.binary(max_size=64),
    st.sampled_from(ENCODINGS),
    st.lists(st.floats(), max_size=4),
    st.lists(st.text(max_size=2), max_size=3),
    st.builds(lambda n: np.full(n, np.nan), st.integers(0, 40)),
    st.builds(lambda n: np.full(n, 1e308), st.sampled_from([3, 9, 12, 36])),
    st.builds(lambda n: np.full(n, 255, np.uint8), st.integers(0, 600)),
    st.builds(lambda n: np.zeros(n, np.float64), st.integers(0, 40)),
    st.builds(lambda n: [[1.0] * n], st.integers(0, 3)),
    st.just({}),
)


def parts_of(message: Any) -> list[tuple[Any, str]]:
    """Every (object, field) inside a message, depth first."""
    found = []
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        found.append((message, field.name))
        for inner in value if isinstance(value, list) else [value]:
            if dataclasses.is_dataclass(inner):
                found += parts_of(inner)
    return found


def decodes_or_is_refused(type_name: str, message: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # overflow in numbers near the largest
        try:
            records = ms.decode(type_name, message)
        except MalformedMessageError as error:
            assert error.message_type == type_name
            assert error.problem
        else:
            assert all(isinstance(record, Record) for record in records)


@pytest.mark.parametrize("index", range(len(EXAMPLES)), ids=[name for name, _ in EXAMPLES])
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_mutated_messages(index, data):
    type_name, original = EXAMPLES[index]
    message = copy.deepcopy(original)
    for _ in range(data.draw(st.integers(1, 3))):
        parts = parts_of(message)
        owner, field = parts[data.draw(st.integers(0, len(parts) - 1))]
        setattr(owner, field, data.draw(WRONG_VALUES))
    decodes_or_is_refused(type_name, message)


@pytest.mark.parametrize("type_name", sorted(ms.DECODABLE_TYPES))
@pytest.mark.parametrize("message", [None, 3, "text", object(), [], {}])
def test_what_is_no_message_at_all(type_name, message):
    with pytest.raises(MalformedMessageError):
        ms.decode(type_name, message)


@settings(max_examples=200, deadline=None)
@given(
    encoding=st.sampled_from(ENCODINGS),
    size=st.tuples(st.integers(0, 9), st.integers(0, 9)),
    step=st.integers(0, 80),
    big=st.integers(0, 255),
    length=st.one_of(st.none(), st.integers(0, 800)),
)
def test_images_of_any_size_and_step(encoding, size, step, big, length):
    data = np.zeros(step * size[0] if length is None else length, np.uint8)
    message = copy.deepcopy(EXAMPLES[0][1])
    message.height, message.width = size
    message.encoding, message.step, message.is_bigendian, message.data = encoding, step, big, data
    decodes_or_is_refused(ms.IMAGE, message)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_clouds_of_any_layout(data):
    message = copy.deepcopy(EXAMPLES[2][1])
    message.point_step = data.draw(st.integers(0, 48))
    message.width, message.height = data.draw(st.tuples(st.integers(0, 5), st.integers(0, 5)))
    slack = data.draw(st.integers(-1, 9))
    message.row_step = max(0, message.width * message.point_step + slack)
    message.is_bigendian = data.draw(st.booleans())
    for field in message.fields:
        field.offset = data.draw(st.one_of(st.just(field.offset), st.integers(0, 50)))
        field.datatype = data.draw(st.one_of(st.just(7), st.integers(0, 9)))
    size = message.row_step * message.height
    message.data = np.frombuffer(data.draw(st.binary(min_size=size, max_size=size)), np.uint8)
    decodes_or_is_refused(ms.POINT_CLOUD, message)


@settings(max_examples=100, deadline=None)
@given(form=st.sampled_from(["png", "jpeg", "16UC1; compressedDepth png", ""]), tail=st.binary())
def test_compressed_images_of_any_bytes(form, tail):
    message = copy.deepcopy(EXAMPLES[0][1])
    message.format = form
    message.data = b"\x89PNG\r\n\x1a\n" + tail
    decodes_or_is_refused(ms.COMPRESSED_IMAGE, message)
