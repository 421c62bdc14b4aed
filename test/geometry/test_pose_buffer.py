"""Poses between poses, and data that wait for them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, FrameError, PoseUnavailableError
from infomap_ros.geometry import (
    PoseBuffer,
    PoseBufferConfig,
    PoseRecord,
    WaitingQueue,
    WaitingQueueConfig,
    make_transform,
)

SECOND = 1_000_000_000


def pose(seconds: float, x: float = 0.0, angle: float = 0.0, covariance=None, frame="map"):
    rotation = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    transform = make_transform(rotation, [x, 0, 0])
    return PoseRecord(round(seconds * SECOND), frame, transform, covariance, "camera")


def buffer(*poses: PoseRecord, **config) -> PoseBuffer:
    result = PoseBuffer(PoseBufferConfig(**config))
    for record in poses:
        result.add(record)
    return result


def test_pose_between_two_is_on_the_way():
    found = buffer(pose(1.0, 0.0, 0.0), pose(1.4, 4.0, 0.8)).at(round(1.1 * SECOND))
    np.testing.assert_allclose(found.transform, pose(1.1, 1.0, 0.2).transform, atol=1e-12)
    assert (found.frame_id, found.child_frame_id, found.stamp) == ("map", "camera", 1_100_000_000)


def test_pose_at_its_own_stamp_needs_no_neighbor():
    only = pose(1.0, 3.0)
    assert buffer(only).at(only.stamp) is only


@pytest.mark.parametrize(
    ("seconds", "reason", "may_arrive"),
    [
        (0.9, "before the first pose", False),
        (5.1, "after the last pose", True),
        (3.0, "gap between poses", False),
    ],
)
def test_no_pose_says_why(seconds, reason, may_arrive):
    poses = buffer(pose(1.0), pose(1.2), pose(5.0), max_gap=0.5)
    with pytest.raises(PoseUnavailableError) as caught:
        poses.at(round(seconds * SECOND))
    assert (caught.value.reason, caught.value.may_arrive) == (reason, may_arrive)


def test_empty_buffer_waits_for_the_first_pose():
    with pytest.raises(PoseUnavailableError) as caught:
        PoseBuffer().at(5)
    assert caught.value.may_arrive


def test_gap_of_exactly_the_limit_is_bridged():
    assert buffer(pose(1.0), pose(1.5), max_gap=0.5).at(round(1.2 * SECOND))


def test_unknown_covariance_stays_unknown():
    poses = buffer(pose(1.0, covariance=np.eye(6)), pose(1.1))
    assert poses.at(round(1.05 * SECOND)).covariance is None


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), fraction=st.floats(0.01, 0.99), correlation=st.floats(-1, 1))
def test_interpolated_covariance_is_never_too_small(seed, fraction, correlation):
    """Against the true covariance of the weighted mean of two errors of any correlation."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    poses = buffer(pose(1.0, covariance=first @ first.T), pose(1.4, covariance=second @ second.T))
    found = poses.at(SECOND + round(0.4 * fraction * SECOND)).covariance
    # errors e1 = first @ n and e2 = second @ (c n + s m) with independent n, m
    other = np.sqrt(1 - correlation**2) * fraction * second
    mixed = (1 - fraction) * first + fraction * correlation * second
    true = mixed @ mixed.T + other @ other.T
    scale = np.abs(found).max()
    assert np.linalg.eigvalsh(found - true)[0] > -1e-6 * scale


def test_late_pose_is_put_in_its_place():
    poses = buffer(pose(1.0, 0.0), pose(1.4, 4.0), max_gap=0.5)
    assert poses.add(pose(1.2, 9.0)) is False
    assert poses.at(round(1.2 * SECOND)).transform[0, 3] == 9.0
    assert poses.newest_stamp == round(1.4 * SECOND)


def test_time_going_backwards_forgets_everything():
    poses = buffer(pose(100.0), pose(100.1))
    assert poses.add(pose(1.0)) is True
    assert len(poses) == 1
    with pytest.raises(PoseUnavailableError, match="after the last"):
        poses.at(100 * SECOND)


def test_same_stamp_replaces():
    poses = buffer(pose(1.0, 1.0), pose(1.0, 2.0))
    assert len(poses) == 1
    assert poses.at(SECOND).transform[0, 3] == 2.0


def test_oldest_pose_goes_when_full():
    poses = buffer(*(pose(1.0 + 0.1 * i) for i in range(5)), capacity=3)
    assert len(poses) == 3
    with pytest.raises(PoseUnavailableError, match="before the first"):
        poses.at(SECOND)


def test_other_frame_is_refused_and_changes_nothing():
    poses = buffer(pose(1.0))
    with pytest.raises(FrameError, match="odom"):
        poses.add(pose(1.1, frame="odom"))
    assert len(poses) == 1


def test_impossible_configuration_is_refused():
    with pytest.raises(ConfigError, match="max_gap"):
        PoseBufferConfig(max_gap=-1.0)
    with pytest.raises(ConfigError, match="capacity"):
        WaitingQueueConfig(capacity=0)


def queue(poses: PoseBuffer, **config) -> WaitingQueue[str]:
    return WaitingQueue(poses.at, WaitingQueueConfig(**config))


def test_item_waits_until_its_pose_arrives():
    poses = buffer(pose(1.0))
    waiting = queue(poses)
    waiting.push(round(1.1 * SECOND), "image")
    assert waiting.take() == []
    poses.add(pose(1.2, 2.0))
    ((item, found),) = waiting.take()
    assert item == "image"
    assert found.transform[0, 3] == pytest.approx(1.0)
    assert len(waiting) == 0


def test_items_come_out_in_order_of_time():
    poses = buffer(pose(1.0), pose(1.4))
    waiting = queue(poses)
    for seconds, name in [(1.3, "c"), (1.1, "a"), (1.2, "b")]:
        waiting.push(round(seconds * SECOND), name)
    assert [item for item, _ in waiting.take()] == ["a", "b", "c"]


def test_item_that_never_gets_a_pose_does_not_block_the_next():
    waiting = queue(buffer(pose(1.0), pose(1.2)))
    waiting.push(round(0.9 * SECOND), "lost")
    waiting.push(round(1.1 * SECOND), "good")
    assert [item for item, _ in waiting.take()] == ["good"]
    assert waiting.dropped == {"before the first pose": 1}


def test_item_that_waited_too_long_is_dropped_with_the_reason():
    waiting = queue(buffer(pose(1.0)), max_wait=0.5)
    waiting.push(round(1.1 * SECOND), "old")
    assert waiting.take(now=round(1.5 * SECOND)) == []
    assert len(waiting) == 1
    waiting.take(now=round(1.7 * SECOND))
    assert waiting.dropped == {"after the last pose": 1}
    assert len(waiting) == 0


def test_full_queue_drops_the_oldest_and_tells():
    told = []
    waiting = WaitingQueue(
        buffer(pose(1.0)).at, WaitingQueueConfig(capacity=2), lambda item, *_: told.append(item)
    )
    for index, name in enumerate("abc"):
        waiting.push(round((1.1 + 0.1 * index) * SECOND), name)
    assert told == ["a"]
    assert waiting.dropped == {"queue full": 1}


def test_clock_set_back_drops_those_that_wait():
    waiting = queue(buffer(pose(100.0)))
    waiting.push(round(100.1 * SECOND), "before")
    waiting.push(round(1.0 * SECOND), "after")
    assert waiting.dropped == {"time went backwards": 1}
    assert len(waiting) == 1
