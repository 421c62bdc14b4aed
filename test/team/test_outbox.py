"""What is told first, and what again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import make_transform
from infomap_ros.mapping import LOG_ODDS_QUANTUM, NOT_OBSERVED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.changes import changed_blocks, take_changes
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.contribution_kernels import unpack_keys
from infomap_ros.team.member import TeamMember
from infomap_ros.team.message_header import dtype_with_header
from infomap_ros.team.priority import priority_of_changes
from infomap_ros.team.update import MapUpdate, SentMessages
from infomap_ros.team.wire import decode_update

CONFIG = VoxelMapConfig(voxel_size=0.1, max_range=3.0)
Place = tuple[int, ...]


def look(own: VoxelMap, seed: int, count: int = 60, aside: float = 0.0) -> None:
    """Points of a wall at 1 m, of which a part is measured; from a place so far aside [m]."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.6, 0.6, (count, 2)), np.full(count, 1.0)])
    points[:, 2] += rng.normal(0.0, 0.01, count)
    covariances = np.broadcast_to(1e-4 * np.eye(3), (count, 3, 3))
    own.integrate(points, make_transform(np.eye(3), [aside, 0.0, 0.0]), covariances)


def mapped(looks: int) -> VoxelMap:
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    for seed in range(looks):
        look(own, seed)
    return own


def states(update: MapUpdate) -> dict[Place, tuple[float, float | None]]:
    """Probability of each voxel, and log2 of the determinant of its surface point, by place."""
    found: dict[Place, tuple[float, float | None]] = {}
    for n, place in enumerate(update.indices.tolist()):
        if update.log_odds[n] == NOT_OBSERVED:
            continue
        p = 1.0 / (1.0 + np.exp(-float(update.log_odds[n]) * LOG_ODDS_QUANTUM))
        spread = update.covariances[n]
        there = bool(update.has_gaussian[n])
        found[tuple(place)] = p, -float(np.linalg.slogdet(spread)[1] / np.log(2)) if there else None
    return found


def places_of(masks: NDArray[np.uint64], corners: NDArray[np.int32]) -> set[Place]:
    """Voxels whose bits are set."""
    bits = np.unpackbits(masks.view(np.uint8).reshape(len(masks), 64), axis=1, bitorder="little")
    block, local = np.nonzero(bits)
    inside = np.stack([local & 7, local >> 3 & 7, local >> 6], axis=1)
    return {tuple(place) for place in (8 * corners[block] + inside).tolist()}


def corners_of(own: VoxelMap, slots: NDArray[np.int64]) -> NDArray[np.int32]:
    """Where blocks of a map are [blocks]."""
    corners = np.zeros((len(slots), 3), np.int32)
    unpack_keys(own._storage.blocks.keys[slots], corners)
    return corners


def test_what_matters_is_what_a_plain_comparison_says() -> None:
    own, told = mapped(3), Contribution(CONFIG.voxel_size)
    first = MapUpdate.of_changes(own.take_changes(), CONFIG.voxel_size, 0, 1)
    told.accept(first)
    look(own, 7, 25, aside=0.2)
    storage = own._storage
    slots, _ = changed_blocks(storage)
    priority = priority_of_changes(own, told, slots)
    changes = take_changes(storage, CONFIG.voxel_size, 1 << 20, slots)
    before = states(first)
    after = states(MapUpdate.of_changes(changes, CONFIG.voxel_size, 0, 2))

    def matters(place: Place, less: float) -> bool:
        p, surface = after[place]
        if place not in before or abs(p - before[place][0]) >= 0.02 * less:
            return True
        was = before[place][1]
        return surface is not None and (was is None or 0.5 * abs(surface - was) >= less)

    found = places_of(priority.matters, corners_of(own, slots))
    sure = {place for place in after if matters(place, 1.02)}
    perhaps = {place for place in after if matters(place, 0.98)}
    rows = {(x >> 3, y, z) for x, y, z in perhaps if after[x, y, z][1] is None}
    riding = found - perhaps
    assert sure <= found
    assert 20 < len(sure) < len(after) - 20
    assert all(after[place][1] is None for place in riding)
    assert {(x >> 3, y, z) for x, y, z in riding} <= rows
    assert priority.sizes[:, 1].sum() > 0.0


def weighed(part: TeamMember, own: VoxelMap) -> tuple[set[Place], float]:
    """Changed voxels that matter or ride along, and about the bytes of those that matter."""
    slots, _ = changed_blocks(own._storage)
    told = part.replica.contribution(part.robot)
    assert told is not None
    priority = priority_of_changes(own, told, slots)
    return places_of(priority.matters, corners_of(own, slots)), float(priority.sizes[:, 0].sum())


def test_what_changed_a_little_waits_until_nothing_else_does() -> None:
    config = TeamConfig(bandwidth=0.02, message_size=2000)
    part, own = TeamMember(0, 1, 100, CONFIG, config), mapped(6)
    part.begin(own)
    for tick in range(1, 40):
        part.updates(own, float(tick))
    look(own, 50)
    wall = np.column_stack([np.random.default_rng(1).uniform(-1.0, 1.0, (300, 2)), np.ones(300)])
    own.integrate(wall, make_transform(np.eye(3), [0.3, 0.2, 0.5]))
    now, full, (matter, left) = 41.0, 0, weighed(part, own)
    while left > 0.0 and now < 80.0:
        now += 0.1
        messages = part.updates(own, now)
        told = {tuple(place) for rows in messages for place in decode_update(rows).indices.tolist()}
        before, (matter, left) = matter, weighed(part, own)
        if left > 0.0:
            full += 1
            assert told <= before
    assert full > 3
    for _ in range(200):
        now += 0.1
        part.updates(own, now)
    assert not len(changed_blocks(own._storage)[0])


def test_a_message_on_its_way_is_not_told_again_and_then_twice() -> None:
    sent = SentMessages(0, 1e6, request_timeout=0.3)
    dtype = dtype_with_header(np.dtype([("index", "u1")]), {"robot": 0})
    for number in range(3):
        sent.number(np.zeros(number + 1, dtype))
    sent.ask([2], 1.0)
    assert [len(rows) for rows in sent.resend(1e5, 1.0)] == [2]
    sent.ask([2, 3], 1.2)
    assert [len(rows) for rows in sent.resend(1e5, 1.2)] == [3]
    sent.ask([2], 1.31)
    assert [len(rows) for rows in sent.resend(1e5, 1.31)] == [2, 2]
