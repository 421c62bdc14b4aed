"""Gaussians as they are stored: codes, and records by block against a plain dictionary."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.mapping.voxels.records import (
    growth_of_surface,
    put_records,
    records_of,
    surface_of,
)
from infomap_ros.mapping.voxels.surface import (
    CHUNK,
    FULL_BYTES,
    MASK_BYTES,
    empty_surface,
    surface_bytes,
    with_pages,
)
from infomap_ros.mapping.voxels.surface_code import (
    CODE_BYTES,
    decode,
    decode_information,
    encode,
    encode_information,
    is_isotropic,
)

BLOCKS = 12
SHEETS = 2 * BLOCKS


def isotropic(weight: float, mean: NDArray[np.float64]) -> NDArray[np.float32]:
    """Information of an isotropic Gaussian, shape (9,)."""
    return np.array([weight, 0, 0, weight, 0, weight, *(weight * mean)], np.float32)


def code_of(weight: float, *mean: float) -> tuple[np.uint64, np.uint16]:
    """Code of an isotropic Gaussian, in the types in which a map keeps it."""
    word, tail = encode(weight, *mean)
    return np.uint64(word), np.uint16(tail)


def random_information(rng: np.random.Generator, full: float) -> NDArray[np.float32]:
    """Of a point near a voxel's centre; not isotropic with probability `full`."""
    mean = rng.uniform(-0.1, 0.1, 3)
    if rng.random() >= full:
        return isotropic(rng.uniform(50.0, 5000.0), mean)
    factor = rng.normal(size=(3, 3)) * 30.0
    matrix = factor @ factor.T + 100.0 * np.eye(3)
    return np.r_[matrix[np.triu_indices(3)], matrix @ mean].astype(np.float32)


def scan(rng: np.random.Generator, full: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Observations of some voxels, in no order."""
    voxels = rng.choice(SHEETS * 512, rng.integers(1, 900), replace=False).astype(np.int64)
    return voxels, np.array([random_information(rng, full) for _ in voxels])


@pytest.mark.parametrize("reach", [1e-4, 0.05, 3.0, 1000.0])
def test_a_code_keeps_weight_and_mean(rng, reach):
    for _ in range(300):
        weight, mean = 10.0 ** rng.uniform(-4, 13), rng.uniform(-reach, reach, 3)
        found = decode(*code_of(weight, *mean))
        assert found[0] == pytest.approx(weight, rel=2.0**-19)
        np.testing.assert_allclose(found[1:], mean, atol=np.abs(mean).max() * 2.0**-16 + 1e-11)


def test_encoding_what_was_decoded_gives_the_same_code(rng):
    information = np.empty(9, np.float32)
    for _ in range(2000):
        code = code_of(10.0 ** rng.uniform(-4, 13), *rng.uniform(-0.2, 0.2, 3))
        decode_information(*code, information)
        assert is_isotropic(information)
        assert encode_information(information) == code


def test_a_code_saturates_and_never_overflows():
    assert decode(*code_of(1e30, 0.0, 0.0, 0.0))[0] == pytest.approx(2.0**46, rel=1e-5)
    assert decode(*code_of(1.0, 9e9, 0.0, -9e9))[1:] == (65535 * 2.0**-5, 0.0, -65535 * 2.0**-5)


@pytest.mark.parametrize(
    "other",
    [
        [4, 0, 0, 4, 0, 5, 0, 0, 0],
        [4, 1e-6, 0, 4, 0, 4, 0, 0, 0],
        [1e-6, 0, 0, 1e-6, 0, 1e-6, 0, 0, 0],
        [1e15, 0, 0, 1e15, 0, 1e15, 0, 0, 0],
        [1, 0, 0, 1, 0, 1, 1e6, 0, 0],
    ],
)
def test_what_a_code_cannot_tell_is_no_matter_of_codes(other):
    assert not is_isotropic(np.array(other, np.float32))


@pytest.mark.parametrize("full", [0.0, 0.02, 0.5])
def test_sums_are_those_of_a_dictionary(rng, full):
    surface, sums = empty_surface(), {}
    for _ in range(25):
        voxels, information = scan(rng, full)
        surface = put_records(surface, BLOCKS, voxels, information, adding=True)
        for voxel, row in zip(voxels.tolist(), information.astype(np.float64), strict=True):
            sums[voxel] = sums.get(voxel, np.zeros(9)) + row

    voxels, information = records_of(surface)

    assert voxels.tolist() == sorted(sums)
    expected = np.array([sums[voxel] for voxel in voxels.tolist()])
    scale = np.abs(expected[:, :6]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(information / scale, expected / scale, atol=3e-5)


def test_order_does_not_matter_within_rounding(rng):
    scans = [scan(rng, 0.05) for _ in range(8)]
    found = []
    for order in (range(8), rng.permutation(8)):
        surface = empty_surface()
        for i in order:
            surface = put_records(surface, BLOCKS, *scans[i], adding=True)
        found.append(records_of(surface))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    scale = np.abs(found[0][1][:, :6]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found[0][1] / scale, found[1][1] / scale, atol=3e-5)


def test_what_is_put_replaces_what_was_there_whatever_its_form(rng):
    voxels = rng.permutation(SHEETS * 512)[:500].astype(np.int64)
    before = np.array([random_information(rng, 0.5) for _ in voxels])
    after = np.array([random_information(rng, 0.5) for _ in voxels])
    fresh = surface_of(BLOCKS, voxels, after)
    changed = put_records(surface_of(BLOCKS, voxels, before), BLOCKS, voxels, after, adding=False)
    np.testing.assert_array_equal(records_of(changed)[1], records_of(fresh)[1])


def test_a_bit_set_for_full_information_is_there_where_it_is_needed(rng):
    voxels = np.arange(0, SHEETS * 512, 512)
    codes = np.array([random_information(rng, 0.0) for _ in voxels])
    plain = surface_bytes(surface_of(BLOCKS, voxels, codes), BLOCKS)
    codes[5] = random_information(rng, 1.0)
    mixed = surface_bytes(surface_of(BLOCKS, voxels, codes), BLOCKS)
    assert mixed - plain == MASK_BYTES + CHUNK * (FULL_BYTES - CODE_BYTES)


def test_records_survive_being_listed_and_built_again(rng):
    surface = empty_surface()
    for _ in range(4):
        surface = put_records(surface, BLOCKS, *scan(rng, 0.2), adding=True)
    listed = records_of(surface)
    again = surface_of(BLOCKS, *listed)
    for a, b in zip(listed, records_of(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert surface_bytes(again, BLOCKS) <= surface_bytes(surface, BLOCKS)


@pytest.mark.parametrize("full", [0.0, 1.0])
def test_blocks_that_grow_together_leave_few_gaps(rng, full):
    surface, sums = empty_surface(), {}
    for _ in range(150):
        voxels, information = (part[:40] for part in scan(rng, full))
        surface = put_records(surface, BLOCKS, voxels, information, adding=True)
        for voxel, row in zip(voxels.tolist(), information.astype(np.float64), strict=True):
            sums[voxel] = sums.get(voxel, np.zeros(9)) + row
        stored = len(sums) * (36 if full else CODE_BYTES)
        assert surface_bytes(surface, BLOCKS) < 1.4 * stored + 120_000
    assert records_of(surface)[0].tolist() == sorted(sums)
    expected = np.array([sums[voxel] for voxel in sorted(sums)])
    np.testing.assert_allclose(records_of(surface)[1], expected, rtol=1e-3, atol=0.3)


def test_growth_is_not_above_what_was_foretold(rng):
    surface = empty_surface()
    for _ in range(20):
        voxels, information = scan(rng, 0.3)
        slots, blocks = np.unique(voxels >> 9, return_inverse=True)
        used = surface_bytes(surface, BLOCKS)
        bound = growth_of_surface(surface, slots, blocks, information)
        surface = put_records(surface, BLOCKS, voxels, information, adding=True)
        assert surface_bytes(surface, BLOCKS) - used <= bound


def test_more_blocks_than_can_be_numbered_are_refused():
    with pytest.raises(CapacityError, match="blocks"):
        with_pages(empty_surface(), 2**23 + 1, 0)


def test_rows_of_a_file_may_come_in_any_order(rng):
    voxels, information = records_of(surface_of(BLOCKS, *scan(rng, 0.3)))
    order = rng.permutation(len(voxels))
    shuffled = records_of(surface_of(BLOCKS, voxels[order], information[order]))
    np.testing.assert_array_equal(shuffled[0], voxels)
    np.testing.assert_array_equal(shuffled[1], information)
