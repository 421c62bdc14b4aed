"""Joint positions at a stamp: interpolated, never extrapolated."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import JointStateRecord
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig

SECOND = 1_000_000_000


def state(stamp: int, **positions: float) -> JointStateRecord:
    return JointStateRecord(stamp, "", tuple(positions), np.array(list(positions.values())))


def buffer_of(*states: JointStateRecord, max_gap: float = 0.5) -> JointBuffer:
    buffer = JointBuffer(JointBufferConfig(max_gap=max_gap, capacity=5))
    for each in states:
        buffer.add(each)
    return buffer


def test_positions_of_several_publishers_are_interpolated() -> None:
    buffer = buffer_of(
        state(0, arm=0.0), state(5, wheel=7.0), state(10, arm=1.0), state(25, wheel=9.0)
    )

    assert buffer.at(5) == {"arm": 0.5, "wheel": 7.0}
    assert buffer.at(10) == {"arm": 1.0, "wheel": 7.5}


def test_a_late_state_is_put_in_its_place() -> None:
    buffer = buffer_of(state(0, arm=0.0), state(20, arm=0.0), state(10, arm=5.0))

    assert buffer.at(10) == {"arm": 5.0}


@pytest.mark.parametrize(("stamp", "may_arrive"), [(-1, False), (21, True)])
def test_nothing_is_extrapolated(stamp: int, may_arrive: bool) -> None:
    with pytest.raises(PoseUnavailableError, match="'arm'") as caught:
        buffer_of(state(0, arm=0.0), state(20, arm=0.0)).at(stamp)

    assert caught.value.may_arrive is may_arrive


def test_nothing_is_interpolated_across_a_gap() -> None:
    with pytest.raises(PoseUnavailableError, match="gap"):
        buffer_of(state(0, arm=0.0), state(SECOND, arm=0.0)).at(SECOND // 2)


def test_without_joint_states_one_may_still_come() -> None:
    with pytest.raises(PoseUnavailableError) as caught:
        JointBuffer().at(0)

    assert caught.value.may_arrive


def test_a_clock_that_jumps_back_starts_anew() -> None:
    buffer = buffer_of(state(10 * SECOND, arm=1.0), state(0, arm=3.0))

    assert buffer.at(0) == {"arm": 3.0}
    with pytest.raises(PoseUnavailableError):
        buffer.at(10 * SECOND)


def test_old_states_are_forgotten() -> None:
    buffer = buffer_of(*(state(stamp, arm=stamp) for stamp in range(6)))

    assert buffer.at(1) == {"arm": 1.0}
    with pytest.raises(PoseUnavailableError):
        buffer.at(0)
