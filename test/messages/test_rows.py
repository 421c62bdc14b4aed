"""Rows of named fields travel as point clouds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.messages import RosbagsMessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.team.wire import OCCUPANCY_ROW, SURFACE_ROW

TYPES = RosbagsMessageTypes()


@pytest.mark.parametrize("dtype", [OCCUPANCY_ROW, SURFACE_ROW])
def test_rows_come_back_bit_for_bit(rng: np.random.Generator, dtype: np.dtype) -> None:
    rows = np.frombuffer(rng.bytes(17 * dtype.itemsize), dtype)

    stamp, frame, received = decode_rows(encode_rows(TYPES, 1_500_000_007, "map", rows))

    assert (stamp, frame, received.dtype) == (1_500_000_007, "map", dtype)
    assert received.tobytes() == rows.tobytes()


def test_no_rows_are_a_message_too() -> None:
    message = encode_rows(TYPES, 0, "map", np.zeros(0, OCCUPANCY_ROW))

    assert message.width == 0
    assert len(decode_rows(message)[2]) == 0


def test_a_type_without_a_code_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="'z'"):
        encode_rows(TYPES, 0, "map", np.zeros(1, [("z", "<c8")]))


@settings(deadline=None)
@given(data=st.data())
def test_contradicting_messages_are_refused_and_nothing_else_happens(data: st.DataObject) -> None:
    message = encode_rows(TYPES, 0, "map", np.zeros(3, OCCUPANCY_ROW))
    numbers = st.integers(0, 100)
    for name in data.draw(st.lists(st.sampled_from(["width", "height", "point_step", "row_step"]))):
        setattr(message, name, data.draw(numbers))
    for field in message.fields:
        if data.draw(st.booleans()):
            field.offset, field.datatype = data.draw(numbers), data.draw(st.integers(0, 20))

    try:
        rows = decode_rows(message)[2]
    except MalformedMessageError:
        return

    assert rows.nbytes == len(message.data)
