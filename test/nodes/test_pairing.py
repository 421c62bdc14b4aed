"""Pairing by stamp, against a naive search over the whole history."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.geometry import Record
from infomap_ros.pipeline.image_synchronizer import StampPairing


def feed(pairing: StampPairing, events: list[tuple[str, int]]) -> list[tuple[int, int]]:
    pairs = []
    for side, stamp in events:
        add = pairing.add_first if side == "left" else pairing.add_second
        pair = add(Record(stamp, ""))
        if pair is not None:
            pairs.append((pair[0].stamp, pair[1].stamp))
    return pairs


@given(left=st.sets(st.integers(0, 30)), right=st.sets(st.integers(0, 30)), order=st.randoms())
def test_equal_stamps_are_paired_whatever_the_interleaving(left, right, order) -> None:
    queues = [[("left", s) for s in sorted(left)], [("right", s) for s in sorted(right)]]
    events = []
    while any(queues):
        events.append(order.choice([q for q in queues if q]).pop(0))
    pairing: StampPairing = StampPairing(capacity=100)

    pairs = feed(pairing, events)

    assert pairs == [(s, s) for s in sorted(left & right)]


def test_nearest_within_the_tolerance_is_taken() -> None:
    pairing: StampPairing = StampPairing(tolerance=5)

    assert feed(pairing, [("left", 94), ("left", 98), ("right", 100)]) == [(98, 100)]
    assert pairing.unpaired == 1


def test_beyond_the_tolerance_nothing_is_paired() -> None:
    pairing: StampPairing = StampPairing(tolerance=5)

    assert feed(pairing, [("left", 94), ("right", 100)]) == []


def test_a_stream_without_partner_stays_bounded() -> None:
    pairing: StampPairing = StampPairing(capacity=3)

    feed(pairing, [("left", stamp) for stamp in range(10)])

    assert pairing.unpaired == 7
    assert pairing.clear() == 3
    assert pairing.unpaired == 10


@pytest.mark.parametrize("first", ["left", "right"])
def test_records_older_than_a_pair_are_dropped(first: str) -> None:
    second = "right" if first == "left" else "left"
    pairing: StampPairing = StampPairing()

    assert feed(pairing, [(first, 1), (first, 2), (second, 2), (second, 1)]) == [(2, 2)]
    assert pairing.unpaired == 1
