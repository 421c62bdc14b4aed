"""Gaussians as they are stored: rows by block against a plain dictionary."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from infomap_ros.mapping.voxels.surface import (
    PAGE_BYTES,
    ROW_BYTES,
    count_new,
    empty_surface,
    put_records,
    records_of,
    surface_bytes,
    surface_of,
    with_records,
)
from infomap_ros.mapping.voxels.surface_kernels import (
    CLOCK,
    EXCESS,
    ROW_SIZE,
    add_observations,
    inflation,
    read_block,
    read_information,
)

BLOCKS = 12
SHEETS = 2 * BLOCKS
HALF = 0.025


def random_row(rng: np.random.Generator) -> NDArray[np.float32]:
    """Of a point near a voxel's center, with an excess."""
    factor = rng.normal(size=(3, 3)) * 30.0
    matrix, mean = factor @ factor.T + 100.0 * np.eye(3), rng.uniform(-0.01, 0.01, 3)
    rest = rng.uniform(0.0, 1e5), rng.uniform(0.0, 10.0), rng.uniform(0.0, 5.0)
    return np.r_[matrix[np.triu_indices(3)], matrix @ mean, rest].astype(np.float32)


def scan(rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Observations of some voxels, in no order."""
    voxels = rng.choice(SHEETS * 512, rng.integers(1, 900), replace=False).astype(np.int64)
    return voxels, np.array([random_row(rng) for _ in voxels])


def test_sums_are_those_of_a_dictionary(rng):
    surface, sums = empty_surface(), {}
    for clock in range(25):
        voxels, rows = scan(rng)
        surface, places = with_records(surface, BLOCKS, voxels)
        order = rng.permutation(len(voxels))
        given = order, rows[:, :9], np.zeros((len(voxels), 2), np.float32), float(clock)
        add_observations(surface.rows, places[order], *given, 0, len(order))
        for voxel, row in zip(voxels.tolist(), rows.astype(np.float64), strict=True):
            sums[voxel] = sums.get(voxel, np.zeros(9)) + row[:9]

    voxels, rows = records_of(surface)

    assert voxels.tolist() == sorted(sums)
    expected = np.array([sums[voxel] for voxel in voxels.tolist()])
    scale = np.abs(expected[:, :6]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(rows[:, :9] / scale, expected / scale, atol=3e-6)
    assert (rows[:, EXCESS] == 0.0).all() and (rows[:, CLOCK] == -np.inf).all()


def test_what_is_put_replaces_what_was_there(rng):
    voxels = rng.permutation(SHEETS * 512)[:500].astype(np.int64)
    before, after = (np.array([random_row(rng) for _ in voxels]) for _ in range(2))
    fresh = surface_of(BLOCKS, voxels, after)
    changed = put_records(surface_of(BLOCKS, voxels, before), BLOCKS, voxels, after)
    np.testing.assert_array_equal(records_of(changed)[1], records_of(fresh)[1])


def test_a_record_without_information_is_none(rng):
    voxels, rows = scan(rng)
    surface = put_records(surface_of(BLOCKS, voxels, rows), BLOCKS, voxels[:1], np.zeros((1, 9)))
    assert records_of(surface)[0].tolist() == sorted(voxels[1:].tolist())


def test_records_survive_being_listed_and_built_again_in_any_order(rng):
    surface = surface_of(BLOCKS, *scan(rng))
    for _ in range(4):
        surface = put_records(surface, BLOCKS, *scan(rng))
    voxels, rows = records_of(surface)
    order = rng.permutation(len(voxels))
    again = surface_of(BLOCKS, voxels[order], rows[order])
    np.testing.assert_array_equal(records_of(again)[0], voxels)
    np.testing.assert_array_equal(records_of(again)[1], rows)
    assert surface_bytes(again, BLOCKS) == surface_bytes(surface, BLOCKS)


def test_new_pages_and_rows_are_counted(rng):
    surface = empty_surface()
    for _ in range(10):
        voxels, rows = scan(rng)
        pages, more = count_new(surface, voxels >> 9, voxels & 511)
        used = surface_bytes(surface, BLOCKS)
        surface = put_records(surface, BLOCKS, voxels, rows)
        assert surface_bytes(surface, BLOCKS) - used == pages * PAGE_BYTES + more * ROW_BYTES
    assert count_new(surface, np.array([-2, -1, -2]), np.array([5, 5, 6])) == (2, 3)


def test_the_excess_of_a_row_inflates_its_covariance():
    for weight, across in ((1e6, 1e4), (1e4, 1e4), (1e8, 1e3)):
        normal = np.array([0.6, 0.0, 0.8])
        matrix = across * np.eye(3) + (weight - across) * np.outer(normal, normal)
        row = np.r_[matrix[np.triu_indices(3)], np.zeros(6)]
        assert inflation(row) == 1.0
        row[EXCESS] = 3.0 * weight
        assert inflation(row) == pytest.approx(4.0)


def test_both_sides_of_a_voxel_and_its_block_are_read_alike(rng):
    voxels, rows = scan(rng)
    surface = surface_of(BLOCKS, voxels, rows)
    one, other = np.zeros(ROW_SIZE, np.float32), np.zeros(ROW_SIZE, np.float32)
    locals_, block = np.empty(512, np.int64), np.empty((512, ROW_SIZE), np.float32)
    stored = dict(zip(voxels.tolist(), rows.astype(np.float64), strict=True))
    for slot in range(BLOCKS + 1):
        count = read_block(surface, slot, HALF, locals_, block, other)
        found = dict(zip(locals_[:count].tolist(), block[:count], strict=True))
        for local in range(512):
            sides = [stored.get(1024 * slot + 512 * side + local) for side in (0, 1)]
            there = [row for row in sides if row is not None]
            assert read_information(surface, slot, local, HALF, one, other) == bool(there)
            if not there:
                assert local not in found
                continue
            total = np.sum(there, axis=0)
            expected = total[:9] / inflation(total)
            np.testing.assert_allclose(one[:9], expected, rtol=1e-4, atol=1e-3)
            np.testing.assert_array_equal(found[local][:9], one[:9])
