"""Counters and complaints of a node, on a clock that the test moves."""

from __future__ import annotations

import pytest

from infomap_ros.nodes.common.health import STALE_AFTER, WARNING_PERIOD, Health


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_an_input_that_never_came_is_named_after_five_seconds(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/left/image_raw", required=True)
    clock.now += STALE_AFTER - 0.1
    assert health.complaints() == []

    clock.now += 0.1

    assert health.complaints() == ["no message on /left/image_raw yet (5 s)"]
    assert health.missing() == ["/left/image_raw"]


def test_an_input_that_stops_is_named_and_forgiven_when_it_comes_back(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/odom", required=True)
    health.arrived("/odom")
    clock.now += 7.0
    assert health.complaints() == ["no message on /odom for 7 s"]

    health.arrived("/odom")

    assert health.complaints() == []


def test_a_latched_input_does_not_grow_stale(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/robot_description", required=True, latched=True)
    health.arrived("/robot_description")
    clock.now += 1000.0

    assert health.complaints() == []


def test_an_optional_input_may_be_absent(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/joint_states", required=False)
    clock.now += 1000.0

    assert health.complaints() == []


def test_drops_are_counted_by_reason_and_complained_of_once(clock: Clock) -> None:
    health = Health(clock)
    for _ in range(3):
        health.dropped("calibration", "baseline is zero")

    assert health.drops() == {"calibration": 3}
    assert health.complaints() == ["dropped 3: calibration"]
    assert health.complaints() == []
    assert health.values()["dropped: calibration"] == "3"
    assert health.values()["last drop: calibration"] == "baseline is zero"


def test_each_reason_is_logged_at_once_and_then_throttled(clock: Clock) -> None:
    health = Health(clock)
    assert health.dropped("a")
    assert health.dropped("b")
    assert not health.dropped("a")

    clock.now += WARNING_PERIOD

    assert health.dropped("a")


def test_rate_is_that_of_the_last_arrivals(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/image", required=True)
    for _ in range(101):
        clock.now += 0.1
        health.arrived("/image")

    assert health.values()["/image rate [Hz]"] == "10.00"
    assert health.values()["/image count"] == "101"
    assert health.values()["/image age [s]"] == "0.00"


def test_what_is_missing_is_said_every_five_seconds_and_what_stops_once(clock: Clock) -> None:
    health = Health(clock)
    health.watch("/never", required=True)
    health.watch("/stops", required=True)
    health.watch("/optional", required=False)
    health.arrived("/stops")
    clock.now += 4.0
    assert health.newly_missing() == ([], [])
    clock.now += 1.5
    assert health.newly_missing() == (["/never"], ["/stops"])
    clock.now += 1.0
    assert health.newly_missing() == ([], [])
    clock.now += 5.0
    assert health.newly_missing() == (["/never"], [])
    health.arrived("/never")
    clock.now += 5.5
    assert health.newly_missing() == ([], ["/never"])
