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


def test_a_joint_that_comes_once_or_seldom_blocks_nothing() -> None:
    """A ghost in one message, one of 2033, a gripper told of once a second; the arm goes on."""
    tenth = SECOND // 10
    buffer = JointBuffer(JointBufferConfig(max_gap=0.5))
    buffer.add(state(0, arm=0.0, ghost=1.0))
    buffer.add(state(10**18, future=1.0))
    for step in range(1, 60):
        buffer.add(state(step * tenth, arm=0.1 * step))
        if step % 10 == 0:
            buffer.add(state(step * tenth, gripper=0.02))
        if step > 20:
            at = buffer.at((step - 6) * tenth - tenth // 2)  # as others are waited for so long
            assert at["arm"] == pytest.approx(0.1 * step - 0.65)
            assert "future" not in at
    assert buffer.at(45 * tenth)["gripper"] == 0.02


def test_a_needed_joint_is_not_held() -> None:
    buffer = buffer_of(
        state(0, arm=0.0, hand=0.0), *(state(n * SECOND // 4, hand=0.0) for n in range(9))
    )
    assert buffer.at(2 * SECOND) == {"arm": 0.0, "hand": 0.0}
    with pytest.raises(PoseUnavailableError, match="'arm'"):
        buffer.at(2 * SECOND, needed=["arm"])


def test_a_joint_that_moved_in_a_gap_is_left_out() -> None:
    hands = [state(n * SECOND // 4, hand=0.0) for n in range(5)]
    assert buffer_of(state(0, arm=0.0), state(SECOND, arm=1.0), *hands).at(SECOND // 2) == {
        "hand": 0.0
    }
    assert (
        buffer_of(state(0, arm=1.0), state(SECOND, arm=1.0), *hands).at(SECOND // 2)["arm"] == 1.0
    )


def test_so_many_names_that_no_robot_has_them_are_forgotten() -> None:
    buffer = buffer_of(state(0, **{f"j{n}": 0.0 for n in range(5000)}))
    buffer.add(state(SECOND, arm=1.0))
    assert len(buffer) == 1000
    assert buffer.at(SECOND)["arm"] == 1.0
