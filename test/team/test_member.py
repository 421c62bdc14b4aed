"""Single stories of a team: late, dead and returning robots, bandwidth, lost messages."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import CellDigest, decode_request
from infomap_ros.team.member import TeamMember
from infomap_ros.team.wire import decode_update

CONFIG = VoxelMapConfig(voxel_size=0.1, max_range=3.0)
TEAM = TeamConfig(message_size=2000, silence=1.0, recovery=2.0)


CENTERS = (np.indices((40, 40, 40)).reshape(3, -1).T - 19.5) * 0.1


def make_map(*seeds: int) -> VoxelMap:
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    for seed in seeds:
        look(own, seed)
    return own


def look(own: VoxelMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), np.full(40, 1.0)])
    pose = np.eye(4)
    pose[:3, 3] = rng.uniform(-1.0, 1.0, 3)
    own.integrate(points, pose)


def member(robot: int, session: int = 1, config: TeamConfig = TEAM) -> TeamMember:
    return TeamMember(robot, session, 100, CONFIG, config)


def talk(
    parts: list[tuple[TeamMember, VoxelMap]], start: float, seconds: float, loss: float = 0.0
) -> float:
    """Everybody tells everybody, every 0.1 s; returns the time."""
    rng, now = np.random.default_rng(5), start
    while now < start + seconds:
        now += 0.1
        for speaker, own in parts:
            for name, messages in (
                ("receive_update", speaker.updates(own, now)),
                ("receive_digest", speaker.digests(now)),
                ("receive_request", speaker.requests(now)),
            ):
                for rows in messages:
                    for hearer, _ in parts:
                        if hearer is not speaker and rng.random() >= loss:
                            getattr(hearer, name)(rows, now)
    return now


def hashes(parts: list[tuple[TeamMember, VoxelMap]]) -> set[int]:
    return {part.replica.hash() for part, _ in parts}


def test_lost_messages_are_mended_soon() -> None:
    parts = [(member(robot), make_map(robot, robot + 10)) for robot in range(2)]
    for part, own in parts:
        part.begin(own)

    talk(parts, 0.0, 4.0, loss=0.2)

    assert len(hashes(parts)) == 1
    assert parts[0][0].replica.robots == (0, 1)


def test_a_late_robot_gets_everything_while_the_others_go_on() -> None:
    parts = [(member(robot), make_map(robot)) for robot in range(2)]
    now = talk(parts, 0.0, 3.0)
    parts.append((member(2), make_map(2)))
    for seed in range(5):
        look(parts[0][1], 100 + seed)
        now = talk(parts, now, 0.5)

    talk(parts, now, 4.0)

    assert len(hashes(parts)) == 1
    assert parts[2][0].replica.robots == (0, 1, 2)


def test_what_a_dead_robot_told_is_passed_on() -> None:
    parts = [(member(robot), make_map(robot)) for robot in range(2)]
    now = talk(parts, 0.0, 3.0)
    survivor = parts[1]
    late = member(2), make_map(2)

    talk([survivor, late], now, 6.0)

    assert late[0].replica.robots == (0, 1, 2)
    assert len(hashes([survivor, late])) == 1
    told = survivor[0].replica.contribution(0)
    assert late[0].replica.contribution(0).hash() == told.hash() != 0


@pytest.mark.parametrize("clock", [100, 50, 2**31 - 7])
def test_a_robot_that_lost_its_map_gets_it_back_and_counts_once(clock: int) -> None:
    first = member(0), make_map(1, 2, 3)
    mate = member(1), make_map(4)
    now = talk([first, mate], 0.0, 4.0)
    told = mate[0].replica.voxel_map.log_odds(CENTERS)
    again = TeamMember(0, 2, clock, CONFIG, TEAM), make_map()

    talk([again, mate], now, 6.0)

    assert again[1].known_voxels == first[1].known_voxels
    assert len(hashes([again, mate])) == 1
    np.testing.assert_array_equal(mate[0].replica.voxel_map.log_odds(CENTERS), told)


def test_a_map_that_is_reset_is_taken_back_everywhere() -> None:
    first, mate = (member(0), make_map(1, 2)), (member(1), make_map(3))
    now = talk([first, mate], 0.0, 4.0)
    empty = make_map()

    first[0].replace(empty)
    talk([(first[0], empty), mate], now, 4.0)

    assert mate[0].replica.voxel_map.known_voxels == mate[1].known_voxels
    assert first[0].replica.hash() == mate[0].replica.hash()


def test_the_bandwidth_is_kept() -> None:
    slow = TeamConfig(bandwidth=0.01, message_size=1000)
    part, own = member(0, config=slow), make_map(*range(8))
    part.begin(own)
    sent, now = 0, 0.0
    while own.known_voxels > part.replica.voxel_map.known_voxels and now < 20.0:
        now += 0.1
        sent += sum(rows.nbytes for rows in part.updates(own, now))

    assert own.known_voxels == part.replica.voxel_map.known_voxels
    assert now > 0.5
    assert sent <= 10_000 * (now + 0.15) + 4000


def test_what_tells_most_goes_first() -> None:
    part, own = member(0, config=TeamConfig(bandwidth=0.02)), make_map(1, 1, 1, 1, 1)
    part.begin(own)
    for tick in range(1, 40):
        part.updates(own, float(tick))
    before = own.voxels()[0]
    look(own, 1)
    look(own, 2)

    news = np.concatenate([decode_update(rows).indices for rows in part.updates(own, 41.0)])

    was_known = (news[:, None] == before[None]).all(axis=2).any(axis=1)
    assert len(news) > 50
    assert was_known.mean() < 0.2


def test_a_listener_asks_but_tells_nothing() -> None:
    listener = TeamMember(0, 0, 1, CONFIG, TEAM, contributes=False)
    robot = member(0), make_map(1)
    empty = make_map()
    robot[0].begin(robot[1])
    lost = robot[0].updates(robot[1], 0.0)

    now = talk([robot, (listener, empty)], 0.0, 4.0)

    assert lost
    assert listener.replica.hash() == robot[0].replica.hash()
    assert listener.digests(now) == []


def test_a_starting_robot_does_not_ask_for_what_others_only_lag_behind_in() -> None:
    robot, mate = (member(0), make_map(1, 2)), (member(1), make_map())
    robot[0].begin(robot[1])
    for rows in robot[0].updates(robot[1], 0.0)[::2]:
        mate[0].receive_update(rows, 0.0)
    wanted = []
    for now in (0.1, 1.2):
        for rows in mate[0].digests(now):
            robot[0].receive_digest(rows, now)
        for rows in robot[0].requests(now):
            mate[0].receive_request(rows, now)
        for rows in mate[0].digests(now + 0.1):
            robot[0].receive_digest(rows, now + 0.1)
        asked = [decode_request(rows) for rows in robot[0].requests(now + 0.1)]
        wanted.append([one.wants for one in asked if one.robot == 0 and one.wants == "states"])
    assert wanted == [[], ["states"]]


def block_digest(corners: list[list[int]], hashes: list[int], sender: int = 1) -> CellDigest:
    """What another robot holds of robot 0."""
    places = np.array(corners, np.int32).reshape(-1, 3)
    return CellDigest(sender, 1, 0, 100, 5, 0, places, np.array(hashes, np.uint32))


@pytest.mark.parametrize("corners", [[[0, 0, 0]] * 2, [[0, 0, 0], [1, 2, 3], [0, 0, 0]]])
def test_a_digest_with_a_repeated_block_is_refused(corners: list[list[int]]) -> None:
    digest = block_digest(corners, list(range(1, 1 + len(corners))))
    robot = member(0)
    with pytest.raises(InvalidInputError, match="repeated"):
        robot.receive_digest(digest.encode(2000)[0], 0.0)
    assert robot.requests(0.1) == []


def test_each_row_of_a_digest_has_its_own_answer() -> None:
    """A block that another robot held like that before is asked for, its neighbors are not."""
    robot = member(0)
    robot.digests(0.0)  # starts
    now = 10.0  # nothing is recovered any more
    for number, (hashes, wanted) in enumerate((([1, 2, 3], []), ([9, 2, 8], [[1, 0, 0]]))):
        digest = block_digest([[0, 0, 0], [1, 0, 0], [2, 0, 0]], hashes)
        robot.receive_digest(digest.encode(2000, number)[0], now)
        asked = [decode_request(rows) for rows in robot.requests(now)]
        found = [one.corners.tolist() for one in asked if one.wants == "states"]
        assert found == ([wanted] if wanted else [])


def test_what_others_say_of_blocks_does_not_grow_without_limit() -> None:
    robot, held = member(0), 0
    for part in range(5):
        corners = np.indices((32, 32, 32)).reshape(3, -1).T + np.array([0, 0, 32 * part])
        digest = block_digest(corners.tolist(), [1] * len(corners), sender=1 + part)
        for rows in digest.encode(1_000_000):
            robot.receive_digest(rows, 10.0)
        held = len(robot._reconciler._held)
    assert held == 1 << 16
