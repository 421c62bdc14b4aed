"""Who must not write does not: strangers, second robots of a name, impossible versions, no key."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError, UpdateRefusedError
from infomap_ros.team.membership import (
    AHEAD,
    BACKWARDS,
    NOT_AUTHENTIC,
    NOT_LISTED,
    TWO_OF_A_NAME,
    Membership,
    TeamKey,
)
from infomap_ros.team.message_header import dtype_with_header
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import OCCUPANCY_ROW, encode_update


def update(robot: int, version: int, session: int = 1, sender: int | None = None) -> MapUpdate:
    return MapUpdate(
        0.05,
        robot,
        np.array([version], np.uint32),
        np.zeros((1, 3), np.int32),
        np.ones(1, np.int8),
        np.zeros((1, 2), np.uint64),
        session,
        sender,
    )


def refusal(membership: Membership, heard: MapUpdate, now: float = 0.0) -> str:
    with pytest.raises(UpdateRefusedError) as error:
        membership.check_update(heard, now, 1)
    return error.value.reason


@pytest.mark.parametrize("heard", [update(9, 5), update(3, 5, sender=9), update(9, 5, sender=3)])
def test_robots_that_are_not_on_the_list_are_refused(heard: MapUpdate) -> None:
    membership = Membership(0, 1, team=(3, 4))

    membership.check_update(update(3, 5), 0.0, 1)

    assert refusal(membership, heard) == NOT_LISTED


@pytest.mark.parametrize(
    ("first", "second", "reason"),
    [
        (10**6, 10**6 - 20_000, BACKWARDS),
        (10**6, 10**6 + 2**25, AHEAD),
        (100, 2**32 - 20_000, BACKWARDS),
    ],
)
def test_versions_that_cannot_follow_are_refused(first: int, second: int, reason: str) -> None:
    membership = Membership(0, 1)
    membership.check_update(update(3, first), 0.0, 1)

    assert refusal(membership, update(3, second)) == reason


def test_versions_may_be_late_and_begin_again() -> None:
    membership = Membership(0, 1)
    for version in (2**32 - 2, 2**32 - 1, 1, 2**32 - 5, 2):
        membership.check_update(update(3, version), 0.0, 1)

    assert refusal(membership, update(3, 2**31)) in (BACKWARDS, AHEAD)


def test_a_robot_may_start_again_with_any_clock_and_speak_late() -> None:
    membership = Membership(0, 1)
    membership.check_update(update(3, 1000, session=1), 0.0, 1)
    membership.check_update(update(3, 500, session=2), 1.0, 1)
    membership.check_update(update(3, 1001, session=2), 2.0, 1)

    membership.check_update(update(3, 999, session=1), 60.0, 1)
    membership.check_update(update(3, 2**31, session=3), 61.0, 1)


def test_what_was_recorded_long_ago_is_not_believed_over_a_robot_that_is_alive() -> None:
    """Without a key, of sessions that were never heard; once the robot is silent, it may be it."""
    hour, alive = 3_600_000, 10**9  # versions are milliseconds
    membership = Membership(0, 1, grace=5.0)
    membership.check_update(update(3, alive, session=2), 0.0, 1)
    membership.check_update(update(3, alive + 6000, session=2), 6.0, 1)
    assert refusal(membership, update(3, alive - hour, session=1), now=6.5) == BACKWARDS
    assert refusal(membership, update(3, alive - 200 * hour, session=7), now=1.0) == BACKWARDS
    membership.check_update(update(3, alive - hour, session=1), 60.0, 1)


def test_two_robots_with_one_id_are_noticed() -> None:
    membership = Membership(0, 1, grace=5.0)
    membership.check_update(update(3, 1000, session=1), 0.0, 1)
    membership.check_update(update(3, 1001, session=2), 1.0, 1)
    membership.check_update(update(3, 1002, session=1), 2.0, 1)

    assert refusal(membership, update(3, 1003, session=1), now=7.0) == TWO_OF_A_NAME


def test_another_robot_with_the_own_id_is_noticed() -> None:
    membership = Membership(0, 1, grace=5.0)
    membership.check_update(update(0, 50, session=2), 0.0, 100)
    membership.check_update(update(0, 150, session=2), 1.0, 100)

    assert refusal(membership, update(0, 151, session=2), now=7.0) == TWO_OF_A_NAME


def test_what_is_signed_with_the_key_is_taken_as_it_was() -> None:
    key = TeamKey(b"sixteen bytes or more")
    (rows,) = encode_update(update(3, 7))

    back = key.verify(key.sign(rows))

    assert back.dtype == rows.dtype
    assert back.tobytes() == rows.tobytes()


@pytest.mark.parametrize("change", ["row", "facts", "key", "none"])
def test_what_is_not_signed_like_that_is_refused(change: str) -> None:
    key = TeamKey(b"sixteen bytes or more")
    (rows,) = encode_update(update(3, 7))
    signed = key.sign(rows)
    if change == "row":
        signed = signed.copy()
        signed["log_odds"][0, 0] += 1
    elif change == "facts":
        names = [name.replace("robot=3", "robot=4") for name in signed.dtype.names]
        signed = signed.copy()
        signed.dtype.names = tuple(names)
    elif change == "key":
        signed = TeamKey(b"another one, as long").sign(rows)
    else:
        signed = rows

    with pytest.raises(UpdateRefusedError) as error:
        key.verify(signed)
    assert error.value.reason == NOT_AUTHENTIC


def test_rows_without_facts_are_refused() -> None:
    with pytest.raises(UpdateRefusedError):
        TeamKey(b"sixteen bytes or more").verify(np.zeros(1, OCCUPANCY_ROW))


def test_short_keys_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="15 bytes"):
        TeamKey(b"123456789012345")


def test_the_code_is_the_hmac_of_what_its_description_says() -> None:
    """Made again from the specification in `authentication`, with RFC 2104 written out."""
    secret = b"sixteen bytes or more"
    dtype = dtype_with_header(np.dtype([("index", "u1", (3,)), ("value", "<f4")]), {"robot": 3})
    rows = np.zeros(2, dtype)
    rows["index"], rows["value"] = [[1, 2, 3], [4, 5, 6]], [0.5, -1.0]
    text = (
        b'[[["index","|u1",[3],0],["value","<f4",[],3],["infomap robot=3","|u1",[],0]],7]'
        + bytes([1, 2, 3]) + struct.pack("<f", 0.5) + bytes([4, 5, 6]) + struct.pack("<f", -1.0)
    )  # fmt: skip

    padded = secret.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(b ^ 0x36 for b in padded) + text).digest()
    code = hashlib.sha256(bytes(b ^ 0x5C for b in padded) + inner).digest()[:16].hex()

    (name,) = [name for name in TeamKey(secret).sign(rows).dtype.names if "code=" in name]
    assert name == f"infomap robot=3 code={code}"


def test_states_that_are_passed_on_leave_the_update_as_it_was() -> None:
    told = update(3, 7)
    later = told.as_sent_by(1, None, 9)
    assert (later.versions == 9).all()
    assert (told.versions == 7).all()
