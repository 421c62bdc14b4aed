"""What a hostile robot tells costs what it says and no more; the others go on."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import CapacityError, InfomapError, UpdateRefusedError
from infomap_ros.mapping import SHARED_LOG_ODDS_LIMIT, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.changes import changed_blocks
from infomap_ros.team.config import (
    MISSED_FOR,
    MOST_MISSED,
    MOST_ROBOTS,
    MOST_TRIES,
    ROOM_PERIOD,
    TeamConfig,
)
from infomap_ros.team.digest import (
    REPEATED,
    SUMMARY_ROW,
    CellDigest,
    Request,
    Summary,
    decode_request,
)
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import AHEAD, PUBLISHES_ITSELF, TOO_MANY, TeamKey
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate, message_bytes
from infomap_ros.team.wire import decode_update, encode_update

CONFIG = VoxelMapConfig(voxel_size=0.1)
START = 10**9  # version
KEY = TeamKey(b"a secret of sixteen bytes")


def own_map(seed: int = 1, count: int = 2000, config: VoxelMapConfig = CONFIG) -> VoxelMap:
    made = VoxelMap(config)
    made.track_changes(True)
    look(made, seed, count)
    return made


def look(own: VoxelMap, seed: int, count: int = 300) -> None:
    rng = np.random.default_rng(seed)
    depth = 3.0 - 0.05 * (seed % 20)
    points = np.column_stack([rng.uniform(-3, 3, (count, 2)), np.full(count, depth)])
    own.integrate(points, np.eye(4))


def begun(robot: int = 1, seed: int = 1, **given: Any) -> tuple[TeamMember, VoxelMap]:
    """A robot that has told its map."""
    config = given.pop("config", CONFIG)
    member, own = TeamMember(robot, 10 + robot, START, config, **given), own_map(seed, 2000, config)
    member.begin(own)
    return member, own


def states(
    robot: int, indices: np.ndarray, version: int = START, odds: int = -5, **given: Any
) -> list[np.ndarray]:
    """Messages that tell the same evidence of voxels, without surface."""
    count = len(indices)
    told = MapUpdate(
        0.1,
        robot,
        np.full(count, version, np.uint32),
        np.asarray(indices, np.int32),
        np.full(count, odds, np.int8),
        np.zeros((count, 2), np.uint64),
        given.pop("session", 90),
        **given,
    )
    return encode_update(told, 60_000)


def lattice(side: int, place: int = 0) -> np.ndarray:
    """One voxel of each of side^3 blocks."""
    corners = np.indices((side, side, side)).reshape(3, -1).T * 8
    return corners + np.array([place * 256, 0, 4096])


def heard(member: TeamMember, messages: list[np.ndarray], now: float) -> Counter[str]:
    """What became of messages."""
    became: Counter[str] = Counter()
    for rows in messages:
        try:
            member.receive_update(rows, now)
            became["heard"] += 1
        except InfomapError as error:
            became[getattr(error, "reason", type(error).__name__)] += 1
    return became


def summary(sender: int, number: int = 0, **newest: int) -> np.ndarray:
    """What a robot says of the newest versions of others, given as r1=..."""
    rows = np.zeros(len(newest), SUMMARY_ROW)
    for row, (robot, version) in enumerate(newest.items()):
        rows[row] = int(robot[1:]), version, 1, (3, 3)
    return Summary(sender, 33, rows).encode(number)


def cells(sender: int, robot: int, count: int, number: int = 0) -> list[np.ndarray]:
    """A digest of blocks that nobody has."""
    corners = np.random.default_rng(0).integers(-1000, 1000, (count, 3)).astype(np.int32)
    corners = np.unique(corners, axis=0)
    hashes = np.full(len(corners), 1, np.uint32)
    return CellDigest(sender, 70, robot, START, 5, 0, corners, hashes).encode(10**6, number)


def test_robots_that_nobody_knows_take_little_and_are_not_more_than_a_team() -> None:
    member, own = begun()
    member.updates(own, 0.0)
    before, became = member.replica.memory_bytes(), Counter[str]()
    for robot in range(100, 1100):
        became += heard(member, states(robot, np.array([[0, 0, 30]])), 0.0)

    assert became == {"heard": MOST_ROBOTS - 1, TOO_MANY: 1000 - MOST_ROBOTS + 1}
    assert member.replica.memory_bytes() - before < 64 * 40_000
    assert len(member.replica.robots) == MOST_ROBOTS


def test_the_memory_of_a_contribution_is_that_of_its_arrays() -> None:
    member, _ = begun()
    heard(member, states(9, lattice(8)), 0.0)
    part = member.replica.contribution(9)
    allocated = sum(array.nbytes for group in part.arrays for array in group)
    assert part.memory_bytes() == allocated > 8**3 * 2500


def test_a_summary_does_not_send_a_robot_where_nobody_hears_it() -> None:
    member, own = begun()
    mate, now = TeamMember(2, 22, START, CONFIG), 0.0
    became = heard(mate, member.updates(own, now), now)
    member.receive_digest(summary(3, r1=(START + 2**31 - 2)), now)
    for seed in range(20):
        now += 0.1
        look(own, seed)
        became += heard(mate, member.updates(own, now), now)

    assert set(became) == {"heard"}
    assert member.version - START < 100
    assert member.barred_by(now) == {3: START + 2**31 - 2}, "and it is said"


def test_a_robot_whose_clock_went_back_follows_one_a_little_and_two_far() -> None:
    for said, version in (([START + 2**28], START + 2**28), ([START + 2**31 - 9], START)):
        member = TeamMember(1, 11, START, CONFIG)
        for sender, newest in enumerate(said):
            member.receive_digest(summary(3 + sender, r1=newest), 0.0)
        assert member.version == version
    member.receive_digest(summary(7, r1=START + 2**31 - 20), 1.0)
    assert member.version == START + 2**31 - 20


def test_who_is_heard_cannot_be_told_of_by_another_what_it_has_not_said() -> None:
    member, own = begun()
    mate, now = TeamMember(2, 22, START, CONFIG), 1.0
    heard(mate, member.updates(own, now), now)
    told = mate.replica.contribution(1).states(1)
    before = mate.replica.hash()

    for ahead, place in (
        (2**31 - 5, 0),
        (100, 0),
        (-5, 4096),
    ):  # newer, or of where it has not been
        told_of = told.indices + place
        forged = states(1, told_of, START + ahead, -SHARED_LOG_ODDS_LIMIT, sender=9)
        assert set(heard(mate, forged, now)) == {PUBLISHES_ITSELF}
    assert mate.replica.hash() == before
    later = states(1, told.indices[:9], START + 2**31 - 5, 5, sender=9)
    assert set(heard(mate, later, now + 60.0)) == {AHEAD}
    mended = states(1, told.indices[:9], START + 50, 5, sender=9)
    assert set(heard(mate, mended, now + 60.0)) == {"heard"}, "who is gone is told of by others"


def test_rows_with_versions_far_ahead_are_refused() -> None:
    (rows,) = states(5, np.array([[0, 0, 0], [8, 0, 0]]), sender=6)
    told = MapUpdate(
        0.1,
        5,
        np.array([START, START + 2**30], np.uint32),
        np.array([[0, 0, 0], [8, 0, 0]], np.int32),
        np.full(2, 5, np.int8),
        np.zeros((2, 2), np.uint64),
        1,
    )
    member, _ = begun()
    assert heard(member, [rows], 0.0) == {"heard": 1}
    assert heard(member, encode_update(told), 0.0) == {AHEAD: 1}


def test_hand_backs_count_only_while_a_robot_recovers() -> None:
    member, own = begun()
    now, box = 0.0, np.indices((16, 16, 16)).reshape(3, -1).T + 100
    for _ in range(300):
        now += 0.1
        member.updates(own, now)
        member.digests(now)
    before = own.known_voxels
    heard(member, states(1, box, START + 5, SHARED_LOG_ODDS_LIMIT, sender=9), now)
    told = member.updates(own, now + 0.1)
    assert own.known_voxels == before
    again = TeamMember(2, 22, START, CONFIG)
    heard(again, told, now)
    assert not again.replica.voxel_map.is_known((box + 0.5) * 0.1).any(), "it is taken back"


SMALL = VoxelMapConfig(voxel_size=0.1, memory_limit=0.03)


def fill(member: TeamMember, robot: int, now: float, places: int = 12) -> Counter[str]:
    became: Counter[str] = Counter()
    for place in range(places):
        became += heard(member, states(robot, lattice(10, place), START + place), now)
    return became


def test_who_fills_the_memory_gives_way_to_the_others() -> None:
    member, own = begun(config=SMALL)
    member.updates(own, 0.0)
    filled = fill(member, 9, 0.0)
    assert filled["CapacityError"] > 0
    assert member.replica.memory_bytes() <= 0.75 * 0.03e9

    mate, theirs = begun(2, 9, config=SMALL)
    now, became = 0.0, Counter[str]()
    for seed in range(10):
        now += 0.5
        look(own, seed)
        assert member.updates(own, now), "it tells its own"
        became += heard(member, mate.updates(theirs, now), now)
    assert set(became) == {"heard"}
    assert member.replica.contribution(2).hash() == mate.replica.contribution(2).hash()

    size = member.replica.contribution(9).blocks
    for _ in range(20):
        now += 5.0
        member.digests(now)
        fill(member, 9, now, 1)
    part = member.replica.contribution(9)
    assert part.is_cut and part.blocks < size
    assert member.replica.contribution(2).hash() == mate.replica.contribution(2).hash()


def test_telling_again_what_is_told_takes_no_memory() -> None:
    """Neither by what is counted before, nor by what is then allocated."""
    replica = MapReplica(VoxelMapConfig(voxel_size=0.1, memory_limit=0.008), own=1)
    (rows,) = states(9, lattice(11))
    replica.apply(decode_update(rows))
    (again,) = states(9, lattice(11), START + 1)
    before = replica.memory_bytes()
    for _ in range(3):
        replica.apply(decode_update(again))
    assert replica.memory_bytes() == before


def test_a_contribution_that_was_cut_is_asked_for_again_when_there_is_room() -> None:
    member, own = begun(config=SMALL)
    member.updates(own, 0.0)
    fill(member, 9, 0.0)
    fill(member, 8, 0.0)
    member.digests(1.0)
    cut = [robot for robot in (8, 9) if member.replica.contribution(robot).is_cut]
    assert cut
    for robot in (8, 9):
        member.replica.forget(robot)
    heard(member, states(cut[0], lattice(3)), 2.0)
    member.replica.contribution(cut[0]).is_cut = True
    member.digests(2.0 + ROOM_PERIOD)
    assert not member.replica.is_cut


def test_what_informs_least_is_dropped() -> None:
    limit = 0.016e9
    replica = MapReplica(VoxelMapConfig(voxel_size=0.1, memory_limit=1e-9 * limit), own=1)
    for place, odds in ((0, 2), (1, SHARED_LOG_ODDS_LIMIT)):
        for rows in states(9, lattice(12, place), odds=odds):
            replica.apply(decode_update(rows))
    before = replica.contribution(9).blocks
    replica.make_room()
    part = replica.contribution(9)
    kept = part.states(9)
    assert before == 2 * 12**3 > part.blocks > 100
    assert np.count_nonzero(kept.log_odds == SHARED_LOG_ODDS_LIMIT) >= min(12**3, part.blocks)
    assert replica.voxel_map.known_voxels == len(kept.versions)
    assert replica.memory_bytes() < 0.75 * limit


def test_what_there_is_no_room_for_is_told_later() -> None:
    own = own_map(config=VoxelMapConfig(voxel_size=0.05))
    small = VoxelMapConfig(voxel_size=0.05, memory_limit=0.001)
    member = TeamMember(1, 11, START, small)
    member.begin(own)
    waiting = changed_blocks(own._storage)[1].sum()
    with pytest.raises(CapacityError):
        member.updates(own, 0.0)
    assert changed_blocks(own._storage)[1].sum() == waiting


def test_rows_in_no_order_take_no_more_memory() -> None:
    rng, indices = np.random.default_rng(1), np.indices((16, 32, 32)).reshape(3, -1).T
    replica = MapReplica(CONFIG)
    replica.apply(decode_update(states(9, indices)[0]).rows(rng.permutation(4000)))
    assert replica.contribution(9).memory_bytes() < 32 * 4000


@pytest.mark.parametrize("robot", [7, 1])
def test_digests_of_blocks_that_do_not_exist_cost_a_few_times_their_bytes(robot: int) -> None:
    member, own = begun(team=(1, 7), config=CONFIG)
    member.updates(own, 0.0)
    size = asked = 0
    for rows in cells(7, robot, 20_000):
        size += message_bytes(rows)
        member.receive_digest(rows, 0.0)
    assert len(member._reconciler._missed) <= MOST_MISSED
    now = 0.0
    while now < MISSED_FOR + 10.0:
        now += 0.1
        asked += sum(map(message_bytes, member.requests(now)))
    assert asked <= MOST_TRIES * size
    assert len(member._reconciler._missed) == 0


def test_who_has_died_is_not_asked_for_ever() -> None:
    member, _ = begun()
    for rows in cells(7, 7, 500):
        member.receive_digest(rows, 0.0)
    asked = [sum(map(message_bytes, member.requests(0.1 * tick))) for tick in range(1, 600)]
    assert sum(asked[:100]) > 500 * 12
    assert sum(asked[400:]) == 0


def test_what_others_ask_and_say_leaves_room_to_tell_the_map() -> None:
    """As much is told of the map under a rain of digests and questions as in quiet, nearly."""
    told = []
    for hostile in (False, True):
        member, own = begun(config=CONFIG)
        member = TeamMember(1, 11, START, CONFIG, TeamConfig(bandwidth=0.1))
        member.begin(own)
        now, number, bytes_told = 0.0, 0, 0
        for seed in range(100):
            now += 0.1
            look(own, seed, 100)
            if hostile:
                for sender in (7, 8, 9):
                    for rows in cells(sender, sender, 500, number):
                        member.receive_digest(rows, now)
                    number += 1
                    for wants in ("cells", "messages"):
                        who = sender, 70, 1, 11, 1
                        none = np.empty((0, 3), np.int32)
                        for rows in Request(*who, wants, 0, 0, none).encode(60_000, number):
                            member.receive_request(rows, now)
                        number += 1
            bytes_told += sum(map(message_bytes, member.updates(own, now)))
            spoken = member.digests(now) + member.requests(now)
            told.append(sum(map(message_bytes, spoken)))
        told[-100:] = [bytes_told, sum(told[-100:])]
    quiet, _, busy, talk = told
    assert busy > 0.5 * quiet
    assert talk < 0.5 * 0.1e6 * 10


def test_one_summary_asks_for_no_more_robots_than_a_team_has() -> None:
    member, _ = begun()
    rows = np.zeros(1000, SUMMARY_ROW)
    rows["robot"], rows["newest"], rows["hash"] = np.arange(1000), START, 3
    member.receive_digest(Summary(7, 70, rows).encode(), 1.0)
    asked = [decode_request(told) for told in member.requests(1.0)]
    assert 0 < len(asked) <= MOST_ROBOTS
    with pytest.raises(InfomapError, match="contributions"):
        member.receive_digest(Summary(7, 70, np.repeat(rows[:2], 2)).encode(1), 1.0)


def test_a_request_that_is_repeated_is_refused() -> None:
    member, own = begun(team=(1, 2), key=KEY)
    for tick in range(20):
        member.updates(own, 0.1 * tick)
        member.digests(0.1 * tick)
    none, now = np.empty((0, 3), np.int32), 10.0
    for wants in ("states", "cells", "messages"):
        number = len(wants)
        (asked,) = Request(2, 5, 1, 11, 1, wants, 0, 0, none).encode(60_000, number)
        member.receive_request(KEY.sign(asked), now)
        for session in (11, 12):
            again = TeamMember(1, session, START, CONFIG, team=(1, 2), key=KEY)
            hearer = member if session == 11 else again
            with pytest.raises(UpdateRefusedError) as refused:
                hearer.receive_request(KEY.sign(asked), now)
            assert refused.value.reason == REPEATED
    answers = sum(map(message_bytes, member.digests(now)))
    for _ in range(100):
        with pytest.raises(UpdateRefusedError):
            member.receive_request(KEY.sign(asked), now)
    assert sum(map(message_bytes, member.digests(now + 0.1))) <= answers


def test_digests_that_are_repeated_are_refused_and_may_overtake_each_other() -> None:
    member, _ = begun(team=(1, 2), key=KEY)
    for number in (5, 9, 7, 300):
        member.receive_digest(KEY.sign(summary(2, number, r2=START)), 0.0)
    for number in (5, 9, 7, 300, 20):
        with pytest.raises(UpdateRefusedError) as refused:
            member.receive_digest(KEY.sign(summary(2, number, r2=START)), 0.0)
        assert refused.value.reason == REPEATED
