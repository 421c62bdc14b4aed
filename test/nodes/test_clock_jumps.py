"""Data on their way when a clock jumps are neither lost nor mixed with those after it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord, PoseRecord
from infomap_ros.geometry.pose_buffer import PoseBuffer
from infomap_ros.pipeline.clock_jumps import LONE_STAMP, ClockGate, JumpingBuffer
from infomap_ros.pipeline.image_synchronizer import ImageSynchronizer, StampPairing

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


@settings(deadline=None)
@given(order=st.randoms(use_true_random=False), count=st.integers(1, 8), rounds=st.integers(1, 3))
def test_every_pair_of_a_looping_bag_is_found(order, count: int, rounds: int) -> None:
    """Whatever the interleaving, as long as no stream is a whole round ahead."""
    stamps = [1000 * (index + 1) for index in range(count)] * rounds
    pairs: StampPairing[ImageRecord, ImageRecord] = StampPairing()
    found = []
    next_of = [0, 0]
    while min(next_of) < len(stamps):
        side = order.randrange(2)
        ahead = next_of[side] - next_of[1 - side] >= min(count, 8)
        if next_of[side] == len(stamps) or ahead:
            side = 1 - side
        add = pairs.add_second if side else pairs.add_first
        pair = add(image(stamps[next_of[side]]))
        next_of[side] += 1
        if pair is not None:
            found.append((pair[0].stamp, pair[1].stamp))

    assert found == [(stamp, stamp) for stamp in stamps]
    assert pairs.unpaired == 0


SECOND = 1_000_000_000
RATE = SECOND // 10


def image(stamp: int) -> ImageRecord:
    return ImageRecord(stamp, "camera", PIXELS, "mono8")


def gate_of(drops: list[str]) -> ClockGate[int]:
    return ClockGate(lambda reason, _: drops.append(reason))


def passed(gate: ClockGate[int], *stamps: int) -> list[tuple[int, bool]]:
    return [each for stamp in stamps for each in gate.add(stamp, stamp)]


@pytest.mark.parametrize("wrong", [1, 2_000_000_000 * SECOND, 90 * SECOND, 110 * SECOND])
def test_a_lone_stamp_is_dropped_and_nothing_jumps(wrong: int) -> None:
    drops: list[str] = []
    gate = gate_of(drops)
    good = [100 * SECOND + k * RATE for k in range(6)]

    assert passed(gate, *good[:3], wrong, *good[3:]) == [(stamp, False) for stamp in good]
    assert drops == [LONE_STAMP]


@pytest.mark.parametrize("step", [-50, 50])
def test_a_jump_is_believed_with_its_second_message_and_nothing_is_lost(step: int) -> None:
    drops: list[str] = []
    gate = gate_of(drops)
    before = [100 * SECOND + k * RATE for k in range(3)]
    after = [(100 + step) * SECOND + k * RATE for k in range(3)]

    through = passed(gate, *before, *after)

    assert [stamp for stamp, _ in through] == before + after
    assert [stamp for stamp, jumped in through if jumped] == ([after[0]] if step < 0 else [])
    assert drops == []


def test_a_wrong_stamp_before_a_jump_is_no_part_of_it() -> None:
    drops: list[str] = []
    gate = gate_of(drops)
    passed(gate, 100 * SECOND, 100 * SECOND + RATE)
    after = [50 * SECOND + k * RATE for k in range(3)]
    assert [each for each, _ in passed(gate, 1, *after)] == after
    assert drops == [LONE_STAMP]


def test_another_stream_tells_that_a_clock_has_jumped() -> None:
    gate = gate_of([])
    assert passed(gate, 100 * SECOND, 10 * SECOND) == [(100 * SECOND, False)]
    assert gate.agree(100 * SECOND) == []
    assert gate.agree(10 * SECOND + RATE) == [(10 * SECOND, True)]


def test_a_slow_stream_is_not_held_up() -> None:
    gate = gate_of([])
    slow = [(100 + 20 * k) * SECOND for k in range(6)]
    assert [stamp for stamp, _ in passed(gate, *slow[:3])] == slow[:3]  # the second with the third
    for stamp in slow[3:]:
        assert gate.add(stamp, stamp) == [(stamp, False)]


def test_a_camera_that_paused_goes_on_at_once() -> None:
    now = 5.0
    gate: ClockGate[int] = ClockGate(clock=lambda: now)
    gate.add(100 * SECOND, 0)
    now = 25.0
    assert gate.add(121 * SECOND, 1) == [(1, False)]
    assert gate.add(141 * SECOND, 2) == []


moments = st.lists(
    st.one_of(
        st.just(("good", 0)),
        st.tuples(st.sampled_from(["left", "right", "both"]), st.integers(-(10**6), 10**9)),
        st.tuples(st.just("jump"), st.integers(-(10**6), 10**6)),
    ),
    max_size=30,
)


@settings(deadline=None)
@given(events=moments, period=st.sampled_from([RATE, SECOND // 30, 2 * SECOND]))
def test_pairs_come_back_whatever_stamps_say(events: list[tuple[str, int]], period: int) -> None:
    """Wrong stamps on one camera or both, and real jumps, in any order [ms off]."""
    drops: list[str] = []
    pairs = ImageSynchronizer(2, 1, on_drop=drops.append)
    calibration = CameraInfoRecord(0, "camera", CameraCalibration(1, 1))
    pairs.add_info(0, calibration)
    now, waiting = 10**7 * SECOND, 0
    for kind, off in [*events, *[("good", 0)] * 5]:
        now += period + (off * 1_000_000 if kind == "jump" else 0)
        wrong = now + off * 1_000_000
        found = pairs.add_image(0, image(wrong if kind in ("left", "both") else now))
        found += pairs.add_image(1, image(wrong if kind in ("right", "both") else now))
        assert all(each.images[0].stamp == each.images[1].stamp for each in found)
        waiting = 0 if any(each.stamp == now for each in found) else waiting + (kind == "good")
        assert waiting < 5
    assert waiting == 0
