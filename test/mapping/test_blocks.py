"""Blocks of occupancy against a dictionary of integers.

The planes are long enough for the compiler to vectorise the kernels, so a miscompiled store shows.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.mapping.config import SHARED_LOG_ODDS_LIMIT
from infomap_ros.mapping.scans.update import free_voxels
from infomap_ros.mapping.voxels.block_kernels import (
    add_quanta,
    add_quanta_to_all,
    find_block,
    find_or_add_block,
    make_room,
    quanta_at,
)
from infomap_ros.mapping.voxels.keys import (
    BLOCK_COUNT,
    BLOCK_VOXELS,
    COORDINATE_LIMIT,
    NARROW,
    UNIFORM,
    UNSEEN,
    WIDE,
    BlockArrays,
    empty_blocks,
    pack,
    unpack,
    with_room,
)
from infomap_ros.mapping.voxels.surface import Witnesses

KEYS = [pack(0, 0, 0), pack(-1, 5, 2), pack(1000, -7, 3)]
COORDINATES = np.array([unpack(key) for key in KEYS], np.int32)


class Model:
    """What the blocks should hold: evidence by (block, voxel), known voxels only."""

    def __init__(self) -> None:
        self.values: dict[tuple[int, int], int] = {}
        self.changed: set[tuple[int, int]] = set()

    def add(self, block: int, voxel: int, quanta: int) -> None:
        """Add evidence to a voxel, known or not."""
        old = self.values.get((block, voxel))
        new = (old or 0) + quanta
        self.values[block, voxel] = new
        limit = SHARED_LOG_ODDS_LIMIT
        if old is None or max(-limit, min(limit, old)) != max(-limit, min(limit, new)):
            self.changed.add((block, voxel))


def voxel_sets() -> st.SearchStrategy[np.ndarray]:
    """Bits of 512 voxels: few, many, all but few, or all."""
    seeds = st.integers(0, 2**32 - 1)
    shares = st.sampled_from([0.003, 0.1, 0.5, 0.97, 1.0])
    return st.builds(lambda seed, p: np.random.default_rng(seed).random(512) < p, seeds, shares)


small = st.integers(-12, 12)
large = st.integers(-300, 300)
blocks = st.integers(0, len(KEYS) - 1)
operations = st.lists(
    st.one_of(
        st.tuples(st.just("all"), blocks, st.one_of(small, large), st.none()),
        st.tuples(st.just("some"), blocks, st.one_of(small, large), voxel_sets()),
        st.tuples(st.just("free"), blocks, st.integers(-30, -1), voxel_sets()),
    ),
    max_size=14,
)


def spread(quanta: int, voxels: np.ndarray) -> list[tuple[int, int]]:
    """Different evidence for each of the voxels, of magnitude up to |quanta|."""
    return [
        (int(v), quanta - int(v) % (abs(quanta) + 1) * (1 if quanta > 0 else -1)) for v in voxels
    ]


def apply(store: BlockArrays, model: Model, operation: tuple) -> BlockArrays:
    name, block, quanta, voxels = operation
    store = with_room(store, 1, 1)
    slot = find_or_add_block(store, KEYS[block])
    if name == "all":
        add_quanta_to_all(store, slot, quanta)
        for voxel in range(BLOCK_VOXELS):
            model.add(block, voxel, quanta)
    elif name == "some":
        make_room(store, slot, max(0, -quanta), max(0, quanta))
        for voxel, amount in spread(quanta, np.flatnonzero(voxels)):
            add_quanta(store, slot, voxel, amount)
            model.add(block, voxel, amount)
    else:
        words = np.packbits(voxels, bitorder="little").view(np.uint64).reshape(1, 8)
        no_hits, no_bits = np.full(len(store.keys), -1, np.int32), np.zeros((1, 8), np.uint64)
        witnesses = Witnesses().at(np.eye(4), len(store.keys), 1)
        free_voxels(store, COORDINATES[[block]], words, no_hits, no_bits, witnesses, quanta)
        for voxel in np.flatnonzero(voxels):
            model.add(block, int(voxel), quanta)
    return store


def content(store: BlockArrays) -> dict[tuple[int, int], int]:
    found = {}
    for block, key in enumerate(KEYS):
        slot = find_block(store, key)
        for voxel in range(BLOCK_VOXELS if slot >= 0 else 0):
            known, value = quanta_at(store, slot, voxel)
            if known:
                found[block, voxel] = int(value)
            else:
                assert value == 0
    return found


@settings(max_examples=120, deadline=None)
@given(operations, st.booleans())
def test_any_sequence_of_additions_is_exact(sequence, tracked):
    store, model = empty_blocks(), Model()
    if tracked:
        store = store._replace(dirty=np.zeros((len(store.keys), 8), np.uint64))
    for operation in sequence:
        store = apply(store, model, operation)
    assert content(store) == model.values
    if tracked:
        bits = np.unpackbits(store.dirty.view(np.uint8), axis=1, bitorder="little")
        dirty = {(b, int(v)) for b, key in enumerate(KEYS) for v in marked(store, bits, key)}
        assert dirty >= model.changed


def marked(store: BlockArrays, bits: np.ndarray, key: int) -> np.ndarray:
    slot = find_block(store, key)
    return np.flatnonzero(bits[slot]) if slot >= 0 else np.zeros(0, int)


@pytest.mark.parametrize("seed", range(3))
def test_long_histories_pass_through_every_kind_of_block(seed):
    rng = np.random.default_rng(seed)
    store, model, kinds = empty_blocks(), Model(), set()
    for step in range(150):
        name = ("all", "some", "free")[rng.integers(3)]
        reach = 8 if step < 60 else 60
        quanta = int(rng.integers(-reach, 0) if name == "free" else rng.integers(-reach, reach + 1))
        voxels = None if name == "all" else rng.random(512) < rng.choice([0.02, 0.5, 1.0])
        store = apply(store, model, (name, int(rng.integers(len(KEYS))), quanta, voxels))
        kinds |= set(store.kind[: store.counts[BLOCK_COUNT]].tolist())
        if step % 10 == 9:
            assert content(store) == model.values
    assert kinds >= {NARROW, WIDE}


def kind_after(*sequence: tuple) -> int:
    store, model = empty_blocks(), Model()
    for operation in sequence:
        store = apply(store, model, operation)
    assert content(store) == model.values
    return int(store.kind[find_block(store, KEYS[0])])


EVEN = np.arange(512) % 2 == 0
NONE, EVERY = np.zeros(512, bool), np.ones(512, bool)


def test_a_block_takes_the_least_storage_that_holds_it():
    assert kind_after(("some", 0, 0, NONE)) == NARROW
    assert kind_after(("free", 0, -6, NONE)) == UNSEEN
    assert kind_after(("all", 0, -6, None)) == UNIFORM
    assert kind_after(("free", 0, -6, EVERY)) == UNIFORM
    assert kind_after(("all", 0, -6, None), ("free", 0, -6, EVEN)) == NARROW
    assert kind_after(("all", 0, -6, None), ("some", 0, 300, EVEN)) == WIDE


def test_a_block_whose_values_become_equal_gives_its_plane_back():
    store, model = empty_blocks(), Model()
    for operation in (
        ("free", 0, -6, EVEN),
        ("free", 0, -6, ~EVEN),
        ("all", 0, -6, None),
        ("free", 1, -6, EVEN),
    ):
        store = apply(store, model, operation)
    assert store.kind[find_block(store, KEYS[0])] == UNIFORM
    assert store.counts[1] == 1, "the second block takes the row that the first gave back"
    assert content(store) == model.values


def test_a_narrow_block_moves_its_base_rather_than_widening():
    steps = [("free", 0, -30, EVEN), ("free", 0, -30, ~EVEN)] * 40
    assert kind_after(*steps) == NARROW


def test_evidence_saturates_and_does_not_wrap():
    store = with_room(empty_blocks(), 1, 1)
    slot = find_or_add_block(store, KEYS[0])
    for _ in range(200):
        make_room(store, slot, 0, 300)
        add_quanta(store, slot, 7, 300)
    assert quanta_at(store, slot, 7) == (True, 32767)
    assert not quanta_at(store, slot, 8)[0]


def test_blocks_are_found_among_many(rng):
    coordinates = np.unique(rng.integers(-60, 60, (20000, 3)), axis=0)
    keys = [pack(*c) for c in coordinates.tolist()]
    store = empty_blocks()
    for key in keys:
        store = with_room(store, 1, 0)
        slot = find_or_add_block(store, key)
        assert store.keys[slot] == key
    assert store.counts[BLOCK_COUNT] == len(keys)
    assert all(find_block(store, key) == slot for slot, key in enumerate(keys))
    assert find_block(store, pack(500, 500, 500)) == -1
    assert len(store.table) <= 8 * len(keys)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_room_that_is_not_used_costs_no_memory():
    store, before = empty_blocks(), resident_bytes()
    for planes in (200_000, 310_000, 480_000):  # 1.5 kB each, were they used
        store = with_room(store, 10, planes)
    assert len(store.narrow) >= 480_000 and len(store.wide) >= 480_000
    assert resident_bytes() - before < 50e6


limits = st.integers(-COORDINATE_LIMIT, COORDINATE_LIMIT - 1)


@given(limits, limits, limits)
def test_keys_unpack_to_what_was_packed(x, y, z):
    assert unpack(pack(x, y, z)) == (x, y, z)
