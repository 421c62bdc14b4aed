"""The player gives each message out once, in order, when its time has come."""

from __future__ import annotations

import struct

import pytest

from infomap_ros.errors import ConfigError, MalformedMessageError
from infomap_ros.messages import header_stamp
from infomap_ros.replay.bags.player import BagPlayer, PlayerConfig
from infomap_ros.replay.bags.reader import BagMessage

START = 1_000_000_000_000
STEP = 100_000_000


def message(index: int, topic: str = "/image") -> BagMessage:
    stamp = START + index * STEP
    data = b"\x00\x01\x00\x00" + struct.pack("<iI", *divmod(stamp, 10**9)) + b"\x00" * 8
    return BagMessage(topic, "sensor_msgs/msg/Image", stamp, data)


def bag(count: int = 10) -> list[BagMessage]:
    return [message(index) for index in range(count)]


def player(messages: list[BagMessage] | None = None, **config) -> BagPlayer:
    content = bag() if messages is None else messages
    return BagPlayer(
        lambda: content, PlayerConfig(**config), paced=["/image"], latched=["/tf_static"]
    )


def drive(play: BagPlayer, until: float, start: float = 50.0) -> list[tuple[float, BagMessage]]:
    """Step whenever the player asks for it; who was published when [s since the start]."""
    now, out = start, []
    while now <= start + until + 1e-9:
        step = play.step(now)
        out += [(now - start, m) for m in step.messages]
        if step.finished:
            break
        now += max(step.wait, 1e-6)
    return out


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_come_at_their_recorded_distance(rate):
    out = drive(player(rate=rate), until=10.0)
    assert [m for _, m in out] == bag()
    for index, (time, _) in enumerate(out):
        assert time == pytest.approx(index * 0.1 / rate, abs=1e-4)


def test_clock_runs_with_the_recording():
    play = player(rate=2.0)
    play.step(50.0)
    assert play.step(50.1).clock == START + 2 * STEP
    assert play.step(50.125).clock == START + int(2.5 * STEP)


def test_late_caller_gets_what_it_missed_in_order():
    play = player()
    play.step(50.0)
    assert [m.stamp for m in play.step(50.35).messages] == [START + i * STEP for i in (1, 2, 3)]


def test_end_is_told_once_everything_is_out():
    play = player(bag(2))
    assert not play.step(50.0).finished
    assert play.step(50.1).finished
    assert play.loops == 1


def test_loop_starts_again_and_the_clock_jumps_back():
    play = player(bag(3), loop=True)
    out = drive(play, until=0.5)
    assert [m.stamp for _, m in out][:5] == [
        START,
        START + STEP,
        START + 2 * STEP,
        START,
        START + STEP,
    ]
    assert play.loops >= 1
    assert play.step(51.0).clock is not None


def test_start_offset_leaves_out_all_but_latched():
    static = message(0, "/tf_static")
    out = drive(player([static, *bag()], start_offset=0.55), until=1.0)
    assert out[0][1].topic == "/tf_static"
    assert [m.stamp for _, m in out[1:]] == [START + i * STEP for i in (6, 7, 8, 9)]
    assert out[1][0] == pytest.approx(0.05, abs=1e-4)


def test_pause_holds_the_recording():
    play = player()
    play.step(50.0)
    play.pause(50.05)
    assert play.step(60.0).messages == ()
    play.resume(60.05)
    assert play.step(60.06).messages == ()
    assert [m.stamp for m in play.step(60.11).messages] == [START + STEP]


def test_acknowledged_play_keeps_the_window_and_needs_no_time():
    play = player(acknowledged=True, window=2)
    first = play.step(50.0)
    assert [m.stamp for m in first.messages] == [START, START + STEP]
    assert play.step(50.001).messages == ()
    play.acknowledge("/image", START)
    assert [m.stamp for m in play.step(50.002).messages] == [START + 2 * STEP]
    assert play.step(50.002).clock == START + 2 * STEP


def test_acknowledged_play_ends_when_the_last_result_is_back():
    play = player(bag(1), acknowledged=True)
    assert not play.step(50.0).finished
    play.acknowledge("/image", START)
    assert play.step(50.1).finished


def test_result_that_never_comes_counts_as_lost_and_play_goes_on():
    play = player(acknowledged=True, window=1)
    play.step(50.0)
    assert play.step(54.9).messages == ()
    assert [m.stamp for m in play.step(55.0).messages] == [START + STEP]
    assert play.unacknowledged == 1


def test_topics_that_are_not_paced_flow_with_the_paced_ones():
    mixed = [message(0), message(0, "/odom"), message(1), message(1, "/odom"), message(2)]
    play = player(mixed, acknowledged=True, window=1)
    assert [m.topic for m in play.step(50.0).messages] == ["/image", "/odom"]


def test_empty_bag_ends_even_when_looped():
    assert player([], loop=True).step(50.0).finished


def test_impossible_rate_is_refused():
    with pytest.raises(ConfigError, match="rate"):
        PlayerConfig(rate=0.0)


def test_header_stamp_of_both_byte_orders():
    little = b"\x00\x01\x00\x00" + struct.pack("<iI", 7, 9)
    big = b"\x00\x00\x00\x00" + struct.pack(">iI", 7, 9)
    assert header_stamp(little) == header_stamp(big) == 7_000_000_009
    with pytest.raises(MalformedMessageError):
        header_stamp(b"short")
