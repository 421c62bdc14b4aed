"""A replica holds the sum of the newest states, whatever happens to the updates on the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.mapping import (
    LOG_ODDS_QUANTUM,
    NOT_OBSERVED,
    VoxelChanges,
    VoxelMap,
    VoxelMapConfig,
)
from infomap_ros.mapping.voxels.queries import voxel_of
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate, next_version
from infomap_ros.team.wire import decode_update, encode_update

SIZE = 0.05
CONFIG = VoxelMapConfig(voxel_size=SIZE)
Voxel = tuple[int, int, int]


def make_update(
    seed: int, robot: int, version: int, indices: np.ndarray | None = None, reach: int = 12
) -> MapUpdate:
    """Random states of random voxels around the origin."""
    rng = np.random.default_rng(seed)
    if indices is None:
        indices = np.unique(rng.integers(-reach, reach, (30, 3)), axis=0)
    indices = indices.astype(np.int32)
    count = len(indices)
    log_odds = rng.choice([*range(-20, 21), NOT_OBSERVED], count).astype(np.int8)
    has_gaussian = (rng.random(count) < 0.5) & (log_odds > 0)
    means = (indices + rng.uniform(0.0, 1.0, (count, 3))) * SIZE
    factors = rng.normal(size=(count, 3, 3)) * 0.02
    covariances = factors @ factors.transpose(0, 2, 1) + 1e-6 * np.eye(3)
    means[~has_gaussian], covariances[~has_gaussian] = np.nan, np.nan
    changes = VoxelChanges(indices, log_odds, has_gaussian, means, covariances)
    return MapUpdate.of_changes(changes, SIZE, robot, version)


def evidence(voxel_map: VoxelMap) -> dict[Voxel, float]:
    """Evidence of every known voxel [quanta]."""
    indices, log_odds = voxel_map.voxels()
    voxels = [tuple(index) for index in indices.tolist()]
    return dict(zip(voxels, (log_odds / LOG_ODDS_QUANTUM).tolist(), strict=True))


def content(voxel_map: VoxelMap) -> dict[Voxel, tuple[float, bytes]]:
    """Evidence [quanta] and the bits of the information of every known voxel."""
    state, blocks = voxel_map.state(), voxel_map._storage.blocks
    owners = [voxel_of(blocks, int(owner)) for owner in state["gaussian_owner"]]
    information = dict(zip(owners, state["gaussian_information"], strict=True))
    nothing = np.zeros(9, np.float32)
    known = evidence(voxel_map)
    assert known.keys() >= {voxel for voxel, row in information.items() if row.any()}
    return {
        voxel: (value, information.get(voxel, nothing).tobytes()) for voxel, value in known.items()
    }


def content_of_robots(replica: MapReplica) -> dict[tuple[int, Voxel], tuple[int, bytes]]:
    """Log-odds and code of every voxel that a robot knows."""
    states = {}
    for robot in replica.robots:
        told = replica.contribution(robot).states(robot)
        for row, index in enumerate(told.indices.tolist()):
            if told.log_odds[row] != NOT_OBSERVED:
                states[robot, tuple(index)] = (int(told.log_odds[row]), told.codes[row].tobytes())
    return states


def naive_content(updates: Sequence[MapUpdate]) -> dict[Voxel, tuple[float, np.ndarray]]:
    """Sum over robots of the state with the largest version; versions do not begin again."""
    newest: dict[tuple[int, Voxel], tuple[int, int, np.ndarray]] = {}
    for update in updates:
        for row, index in enumerate(update.indices.tolist()):
            key = (update.robot, tuple(index))
            if key in newest and newest[key][0] >= update.version:
                continue
            information = np.zeros(9)
            if update.has_gaussian[row]:
                matrix = np.linalg.inv(update.covariances[row])
                center = (np.array(index) + 0.5) * SIZE
                information[:6] = matrix[np.triu_indices(3)]
                information[6:] = matrix @ (update.means[row] - center)
            newest[key] = (update.version, int(update.log_odds[row]), information)
    sums: dict[Voxel, tuple[float, np.ndarray]] = {}
    for (_, voxel), (_, log_odds, information) in newest.items():
        if log_odds != NOT_OBSERVED:
            evidence, total = sums.get(voxel, (0.0, np.zeros(9)))
            sums[voxel] = (evidence + log_odds, total + information)
    return sums


def sorted_surface(voxel_map: VoxelMap) -> list[np.ndarray]:
    """Surface voxels in the order of their indices."""
    surface = voxel_map.gaussians()
    order = np.lexsort(surface[0].T)
    return [values[order] for values in surface]


def replica_of(updates: Sequence[MapUpdate]) -> MapReplica:
    replica = MapReplica(CONFIG)
    for update in updates:
        replica.apply(update)
    return replica


@st.composite
def histories(draw: st.DrawFn) -> list[MapUpdate]:
    """What up to four robots tell, with versions that need not follow each other."""
    updates = []
    for robot in draw(st.lists(st.integers(0, 65535), min_size=1, max_size=4, unique=True)):
        version = draw(st.integers(1, 1000))
        for _ in range(draw(st.integers(1, 5))):
            version += draw(st.integers(1, 1000))
            updates.append(make_update(draw(st.integers(0, 2**31)), robot, version))
    return updates


@settings(deadline=None, max_examples=40)
@given(history=histories(), data=st.data())
def test_the_map_is_the_sum_of_the_newest_states(
    history: list[MapUpdate], data: st.DataObject
) -> None:
    heard = data.draw(st.lists(st.sampled_from(history), max_size=20))

    found = content(replica_of(heard).voxel_map)

    expected = naive_content(heard)
    assert set(found) == set(expected)
    for voxel, (evidence, information) in expected.items():
        assert found[voxel][0] == evidence
        bits = np.frombuffer(found[voxel][1], np.float32)
        np.testing.assert_allclose(bits, information, rtol=1e-4, atol=1e-4 * information[0])


@settings(deadline=None, max_examples=40)
@given(history=histories(), data=st.data())
def test_replicas_that_heard_the_same_are_identical_to_the_bit(
    history: list[MapUpdate], data: st.DataObject
) -> None:
    repeated = history + data.draw(st.lists(st.sampled_from(history), max_size=10))
    shuffled = data.draw(st.permutations(repeated))

    replicas = replica_of(shuffled), replica_of(history)
    assert content(replicas[0].voxel_map) == content(replicas[1].voxel_map)
    assert replicas[0].hash() == replicas[1].hash()


@settings(deadline=None, max_examples=40)
@given(history=histories(), data=st.data())
def test_replicas_that_hold_something_else_have_another_hash(
    history: list[MapUpdate], data: st.DataObject
) -> None:
    update = data.draw(st.sampled_from(history))
    other = make_update(99, update.robot, history[-1].version + 5000, update.indices)
    row = data.draw(st.integers(0, len(update.indices) - 1))
    other = other.rows(np.array([row]))
    replica = replica_of(history)
    before = replica.hash(), content_of_robots(replica)

    replica.apply(other)

    same = content_of_robots(replica) == before[1]
    assert (replica.hash() == before[0]) == same


def test_a_robot_set_aside_is_left_out_of_the_map_and_kept() -> None:
    first, second = make_update(1, 1, 1), make_update(2, 2, 1)
    replica = replica_of([first, second])
    whole = content(replica.voxel_map), replica.hash()

    replica.set_aside(2, True)
    alone = content(replica_of([first]).voxel_map)
    assert content(replica.voxel_map) == alone
    replica.apply(make_update(3, 2, 2, second.indices))
    assert content(replica.voxel_map) == alone
    again = second.versions + np.uint32(2), second.indices, second.log_odds, second.codes
    replica.apply(MapUpdate(SIZE, 2, *again))
    replica.set_aside(2, False)

    assert (content(replica.voxel_map), replica.hash()) == whole


@settings(deadline=None, max_examples=40)
@given(history=histories(), data=st.data())
def test_what_was_lost_is_mended_by_hearing_everything_again(
    history: list[MapUpdate], data: st.DataObject
) -> None:
    replica = replica_of(data.draw(st.lists(st.sampled_from(history), max_size=8)))

    for update in history:
        replica.apply(update)

    assert content(replica.voxel_map) == content(replica_of(history).voxel_map)


@settings(deadline=None, max_examples=30)
@given(start=st.integers(2**32 - 5, 2**32 - 1), order=st.permutations(range(6)))
def test_versions_may_begin_again(start: int, order: list[int]) -> None:
    indices = np.array([[1, 2, 3], [4, 5, 6]])
    version, updates = start, []
    for seed in range(6):
        updates.append(make_update(seed, 3, version, indices))
        version = next_version(version)

    replica = replica_of([updates[i] for i in order])

    assert content(replica.voxel_map) == content(replica_of(updates[-1:]).voxel_map)


def test_an_update_counts_the_voxels_that_it_changes() -> None:
    indices = np.array([[0, 0, 0], [0, 0, 1], [9, 0, 0]])
    replica = MapReplica(CONFIG)
    update = make_update(5, 1, 10, indices)
    update.log_odds[:] = [4, -4, 7]
    same = make_update(5, 1, 11, indices)
    same.log_odds[:] = [4, -4, 8]

    assert [replica.apply(update), replica.apply(update), replica.apply(same)] == [3, 0, 1]


def test_a_voxel_that_is_taken_back_is_unknown_again() -> None:
    indices = np.array([[0, 0, 0], [0, 0, 1]])
    first, other = make_update(1, 1, 1, indices), make_update(2, 2, 1, indices[:1])
    first.log_odds[:], other.log_odds[:] = 5, -3
    taken_back = make_update(3, 1, 2, indices)
    taken_back.log_odds[:] = NOT_OBSERVED
    taken_back.codes[:] = 0

    replica = replica_of([first, other, taken_back])

    assert evidence(replica.voxel_map) == {(0, 0, 0): -3.0}
    replica.apply(first)
    assert evidence(replica.voxel_map) == {(0, 0, 0): -3.0}


def test_evidence_of_many_robots_adds_up_beyond_a_byte() -> None:
    indices = np.array([[0, 0, 0], [7, 7, 7]])
    replica = MapReplica(CONFIG)
    for robot in range(40):
        update = make_update(robot, robot, 1, indices)
        update.codes[:] = 0
        update.log_odds[:] = [20, -1]
        replica.apply(update)

    assert evidence(replica.voxel_map) == {(0, 0, 0): 800.0, (7, 7, 7): -40.0}


def test_a_replica_of_a_map_shows_the_map() -> None:
    source = VoxelMap(CONFIG)
    source.track_changes(True)
    rng = np.random.default_rng(4)
    replica = MapReplica(CONFIG)
    for version in range(1, 4):
        points = np.column_stack([rng.uniform(-1.0, 1.0, (500, 2)), np.full(500, 1.5)])
        source.integrate(points, np.eye(4))
        update = MapUpdate.of_changes(source.take_changes(), SIZE, 1, version)
        for rows in encode_update(update, 5000):
            replica.apply(decode_update(rows))

    assert evidence(replica.voxel_map) == {
        voxel: min(max(value, -20.0), 20.0) for voxel, value in evidence(source).items()
    }
    sides = sorted_surface(source), sorted_surface(replica.voxel_map)
    for expected, found in zip(*sides, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0.01, atol=SIZE / 1000)


def test_voxels_of_another_size_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"0\.05 m, the map has 0\.1 m"):
        MapReplica(VoxelMapConfig(voxel_size=0.1)).apply(make_update(0, 1, 1))


def test_voxels_outside_the_coordinate_limits_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="limits"):
        MapReplica(CONFIG).apply(make_update(0, 1, 1, np.array([[0, 2**20, 0]])))


def test_impossible_states_leave_the_replica_as_it_was() -> None:
    replica = replica_of([make_update(0, 1, 1)])
    before = content(replica.voxel_map), replica.hash()
    update = make_update(1, 1, 2)
    update.log_odds[np.flatnonzero(update.has_gaussian)[-1]] = NOT_OBSERVED

    with pytest.raises(InvalidInputError, match="not observed has a surface"):
        replica.apply(update)
    assert (content(replica.voxel_map), replica.hash()) == before


def test_an_update_that_would_exceed_the_memory_is_refused() -> None:
    replica = MapReplica(VoxelMapConfig(voxel_size=SIZE, memory_limit=0.001))
    scattered = np.arange(0, 8000, 8)[:, None] * np.ones((1, 3), np.int64)

    with pytest.raises(CapacityError, match="shared map"):
        replica.apply(make_update(0, 1, 1, scattered))
    assert replica.voxel_map.known_voxels == 0
