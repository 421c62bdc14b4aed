"""Fiducials survive the way into a message; what cannot be fiducials is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import MalformedMessageError
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.messages import POINT_CLOUD, RosbagsMessageTypes
from infomap_ros.messages.fiducials import (
    FIDUCIAL_ROW,
    decode_fiducials,
    encode_fiducials,
    fiducial_rows,
)
from infomap_ros.messages.rows import encode_rows

TYPES = RosbagsMessageTypes()


def some(count: int = 5) -> Fiducials:
    rng = np.random.default_rng(4)
    factors = rng.normal(0.0, 0.02, (count, 3, 3))
    covariances = factors @ factors.transpose(0, 2, 1)
    return Fiducials(3 + np.arange(count), rng.uniform(-5.0, 5.0, (count, 3)), covariances)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_fiducials_come_back(count: int) -> None:
    told, store = some(count), TYPES._store
    data = store.serialize_cdr(encode_fiducials(TYPES, 2_000_000_003, "map", told), POINT_CLOUD)

    stamp, frame, received = decode_fiducials(store.deserialize_cdr(data, POINT_CLOUD))

    assert (stamp, frame) == (2_000_000_003, "map")
    np.testing.assert_array_equal(received.ids, told.ids)
    np.testing.assert_allclose(received.positions, told.positions, rtol=1e-6)
    np.testing.assert_allclose(received.covariances, told.covariances, rtol=1e-6, atol=1e-12)


def test_a_fiducial_known_in_one_direction_only_is_one() -> None:
    ray = np.array([0.3, 0.7, 0.2])
    flat = Fiducials(np.zeros(1, int), np.ones((1, 3)), np.outer(ray, ray)[None])
    assert len(decode_fiducials(encode_fiducials(TYPES, 0, "map", flat))[2]) == 1


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("x", np.nan, "NaN"),
        ("cov_xy", np.inf, "NaN"),
        ("cov_xx", -1e-3, "not positive"),
        ("cov_xy", 1.0, "not positive"),
        ("id", 4, "twice"),
    ],
)
def test_impossible_fiducials_are_refused(field: str, value: float, problem: str) -> None:
    rows = fiducial_rows(some())
    rows[field][0] = value
    with pytest.raises(MalformedMessageError, match=problem):
        decode_fiducials(encode_rows(TYPES, 0, "map", rows))


def test_other_rows_are_refused() -> None:
    rows = np.zeros(2, FIDUCIAL_ROW.descr[:3])
    with pytest.raises(MalformedMessageError, match="fiducials"):
        decode_fiducials(encode_rows(TYPES, 0, "map", rows))


@settings(deadline=None)
@given(content=st.binary(min_size=88, max_size=88))
def test_any_bytes_are_fiducials_or_refused(content: bytes) -> None:
    message: Any = encode_rows(TYPES, 0, "map", np.frombuffer(content, FIDUCIAL_ROW))
    try:
        received = decode_fiducials(message)[2]
    except MalformedMessageError:
        return
    assert np.isfinite(received.positions).all()
    variances = np.linalg.eigvalsh(received.covariances)
    assert (variances[:, 0] >= -1e-5 * variances[:, 2]).all()  # as float32 rounds
