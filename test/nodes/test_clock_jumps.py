"""Data on their way when a clock jumps back are neither lost nor mixed with those after it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import ImageRecord, PoseRecord
from infomap_ros.geometry.pose_buffer import PoseBuffer
from infomap_ros.pipeline.clock_jumps import JumpingBuffer, JumpingPairs

JUMP = 100
PIXELS = np.zeros((1, 1), np.uint8)


def pose(stamp: int, x: float) -> PoseRecord:
    transform = np.eye(4)
    transform[0, 3] = x
    return PoseRecord(stamp, "map", transform)


def buffer_of(*poses: PoseRecord) -> JumpingBuffer:
    buffer: JumpingBuffer = JumpingBuffer(PoseBuffer, JUMP)
    for each in poses:
        buffer.add(each)
    return buffer


def test_data_from_before_a_jump_are_found_until_the_others_jump() -> None:
    buffer = buffer_of(pose(1000, 1.0), pose(10, 2.0))

    assert buffer.at(1000).transform[0, 3] == 1.0
    assert buffer.at(10).transform[0, 3] == 2.0
    buffer.others_have_jumped(10)
    with pytest.raises(PoseUnavailableError):
        buffer.at(1000)
    assert buffer.at(10).transform[0, 3] == 2.0


def test_who_is_far_ahead_after_a_jump_keeps_what_came_since() -> None:
    buffer = buffer_of(pose(1000, 1.0), pose(10, 2.0), pose(10 + 3 * JUMP, 3.0))

    buffer.others_have_jumped(10)

    assert buffer.at(10).transform[0, 3] == 2.0
    assert buffer.at(10 + 3 * JUMP).transform[0, 3] == 3.0


def test_who_jumps_first_gets_nothing_from_before() -> None:
    buffer = buffer_of(pose(10, 1.0), pose(1000, 1.0))

    buffer.others_have_jumped(10)

    with pytest.raises(PoseUnavailableError) as caught:
        buffer.at(10)
    assert caught.value.may_arrive


@given(order=st.randoms(use_true_random=False), count=st.integers(1, 8), rounds=st.integers(1, 3))
def test_every_pair_of_a_looping_bag_is_found(order, count: int, rounds: int) -> None:
    """Whatever the interleaving, as long as no stream is a whole round ahead."""
    stamps = [1000 * (index + 1) for index in range(count)] * rounds
    dropped: list[str] = []
    pairs = JumpingPairs(0, JUMP, dropped.append)
    found = []
    next_of = [0, 0]
    while min(next_of) < len(stamps):
        side = order.randrange(2)
        ahead = next_of[side] - next_of[1 - side] >= min(count, 8)
        if next_of[side] == len(stamps) or ahead:
            side = 1 - side
        pair = pairs.add(side, ImageRecord(stamps[next_of[side]], "camera", PIXELS, "mono8"))
        next_of[side] += 1
        if pair is not None:
            found.append((pair[0].stamp, pair[1].stamp))

    assert found == [(stamp, stamp) for stamp in stamps]
    assert dropped == []
