"""Evidence from one place is limited; against a count voxel by voxel."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.mapping.voxels.surface import (
    LIMIT,
    STEP,
    Witnesses,
    admit_hit,
    admit_misses,
)

SLOTS = 5
STEPPED = make_transform(np.eye(3), [2.0 * STEP, 0.0, 0.0])
TURNED = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.0, 0.0, 0.0])


def words_of(voxels):
    """Bit set of a boolean array of shape (512,)."""
    return np.packbits(voxels, bitorder="little").view(np.uint64).copy()


def voxels_of(words):
    return np.unpackbits(words.view(np.uint8), bitorder="little").astype(bool)


@pytest.mark.parametrize("seed", range(4))
def test_sums_are_those_of_a_plain_count(seed):
    rng = np.random.default_rng(seed)
    witnesses, sums = Witnesses(), np.zeros((SLOTS, 512), int)
    for _ in range(40):
        arrays = witnesses.at(np.eye(4), SLOTS, SLOTS)
        slot = int(rng.integers(SLOTS))
        if rng.random() < 0.5:
            local = int(rng.integers(512)) if rng.random() < 0.5 else 77
            admitted = sums[slot, local] < LIMIT
            assert admit_hit(arrays, slot, local) == admitted
            sums[slot, local] += admitted
        else:
            seen = rng.random(512) < rng.choice([0.2, 0.9])
            bits, admitted = words_of(seen), seen & (sums[slot] > -LIMIT)
            admit_misses(arrays, slot, bits)
            np.testing.assert_array_equal(voxels_of(bits), admitted)
            sums[slot] -= admitted


@pytest.mark.parametrize("there", [STEPPED, TURNED])
def test_another_place_begins_anew(there):
    witnesses, everything = Witnesses(), np.ones(512, bool)
    for place in (np.eye(4), there, np.eye(4)):
        for scan in range(5):
            bits = words_of(everything)
            admit_misses(witnesses.at(place, 1, 1), 0, bits)
            assert voxels_of(bits).all() == (scan < LIMIT)
            assert voxels_of(bits).any() == (scan < LIMIT)


def test_the_scatter_of_poses_is_no_other_place(rng):
    witnesses, one = Witnesses(), np.arange(512) == 9
    admitted = 0
    for _ in range(50):
        bits = words_of(one)
        pose = make_transform(np.eye(3), rng.normal(0.0, 0.005, 3))
        admit_misses(witnesses.at(pose, 1, 1), 0, bits)
        admitted += bool(voxels_of(bits).any())
    assert admitted == LIMIT


def test_what_changes_in_view_is_still_seen():
    """Seen through for long, then something stands there, then it has gone: each is admitted."""
    witnesses, one = Witnesses(), np.arange(512) == 9
    freed = [_freed(witnesses, one) for _ in range(100)]
    assert freed == [True] * LIMIT + [False] * (100 - LIMIT)
    hit = [admit_hit(witnesses.at(np.eye(4), 1, 1), 0, 9) for _ in range(100)]
    assert hit == [True] * 2 * LIMIT + [False] * (100 - 2 * LIMIT)
    assert [_freed(witnesses, one) for _ in range(7)] == [True] * 2 * LIMIT + [False]


def _freed(witnesses, voxels):
    bits = words_of(voxels)
    admit_misses(witnesses.at(np.eye(4), 1, 1), 0, bits)
    return bool(voxels_of(bits).any())
