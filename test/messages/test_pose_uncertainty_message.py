"""The parts of a pose's covariance cross a message; what is malformed is refused."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import PoseUncertainty
from infomap_ros.messages import RosbagsMessageTypes
from infomap_ros.messages.pose_uncertainty import (
    POSE_UNCERTAINTY_ROW,
    decode_pose_uncertainty,
    encode_pose_uncertainty,
)
from infomap_ros.messages.rows import encode_rows

TYPES = RosbagsMessageTypes()


def example(seed: int = 3) -> PoseUncertainty:
    parts = [1e-3 * a @ a.T for a in np.random.default_rng(seed).normal(size=(3, 6, 6))]
    return PoseUncertainty(*parts, clock=12345.678901234567)


def row_with(**values: object) -> np.ndarray:
    rows = np.zeros(1, POSE_UNCERTAINTY_ROW)
    for name, value in values.items():
        rows[name] = value
    return rows


def test_what_is_sent_comes_back_bit_for_bit():
    told = example()

    message = encode_pose_uncertainty(TYPES, 7_000_000_011, "map", told)
    stamp, frame, received = decode_pose_uncertainty(message)

    assert (stamp, frame, received.clock) == (7_000_000_011, "map", told.clock)
    for part in ("drift", "white", "offset"):
        np.testing.assert_array_equal(getattr(received, part), getattr(told, part))


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (np.zeros(0, POSE_UNCERTAINTY_ROW), "one pose"),
        (np.zeros(2, POSE_UNCERTAINTY_ROW), "one pose"),
        (np.zeros(1, [("x", "<f4")]), "one pose"),
        (np.zeros(1, [("clock", "<f8"), ("drift", "<f8", (36,))]), "one pose"),
        (row_with(clock=np.nan), "clock"),
        (row_with(clock=np.inf), "clock"),
        (row_with(drift=np.nan), "drift"),
        (row_with(white=-np.eye(6)[np.triu_indices(6)]), "white"),
        (row_with(offset=np.arange(21)), "offset"),
    ],
)
def test_what_is_not_the_uncertainty_of_one_pose_is_refused(rows, problem):
    with pytest.raises(MalformedMessageError, match=problem):
        decode_pose_uncertainty(encode_rows(TYPES, 1, "map", rows))


@pytest.mark.parametrize("message", [None, 3, "text", object(), [], {}])
def test_what_is_no_message_at_all_is_refused(message):
    with pytest.raises(MalformedMessageError):
        decode_pose_uncertainty(message)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_of_any_bytes_a_message_is_read_or_refused(data):
    message = encode_pose_uncertainty(TYPES, 1, "map", example())
    size = POSE_UNCERTAINTY_ROW.itemsize
    length = data.draw(st.sampled_from([0, 1, size - 1, size, 2 * size]))
    message.data = np.frombuffer(data.draw(st.binary(min_size=length, max_size=length)), np.uint8)
    message.width = data.draw(st.integers(0, 2))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # overflow in numbers near the largest
        try:
            received = decode_pose_uncertainty(message)[2]
        except MalformedMessageError:
            return

    assert np.isfinite(received.clock)
    assert np.isfinite(received.drift).all()
