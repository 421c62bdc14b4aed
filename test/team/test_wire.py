"""Map updates survive the wire within their quantization, in few bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import NOT_OBSERVED, VoxelChanges
from infomap_ros.team.message_header import dtype_with_header
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import OCCUPANCY_ROW, SURFACE_ROW, decode_update, encode_update

FACTS = {
    "robot": 7,
    "session": 1,
    "version": 3,
    "voxel_size": 0.05,
    "origin_x": 0,
    "origin_y": -16,
    "origin_z": 8,
}


def make_changes(
    rng: np.random.Generator, count: int = 400, voxel_size: float = 0.05, reach: int = 2**20
) -> VoxelChanges:
    indices = np.unique(rng.integers(-reach, reach, (count, 3)).astype(np.int32), axis=0)
    count = len(indices)
    log_odds = rng.choice([*range(-20, 21), NOT_OBSERVED], count).astype(np.int8)
    has_gaussian = (rng.random(count) < 0.5) & (log_odds != NOT_OBSERVED)
    means = (indices + rng.uniform(-0.1, 1.1, (count, 3))) * voxel_size
    turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    sigmas = 10.0 ** rng.uniform([-2.5, -1.0, -1.0], [-1.0, 0.0, 0.0], (count, 3)) * voxel_size
    covariances = np.einsum("kij,kj,klj->kil", turns, sigmas**2, turns)
    means[~has_gaussian] = np.nan
    covariances[~has_gaussian] = np.nan
    return VoxelChanges(indices, log_odds, has_gaussian, means, covariances)


def make_update(rng: np.random.Generator, count: int = 400, reach: int = 2**20) -> MapUpdate:
    changes = make_changes(rng, count, reach=reach)
    return MapUpdate.of_changes(changes, 0.05, 7, 3_000_000_000, 12)


def joined(update: MapUpdate, max_bytes: int) -> MapUpdate:
    parts = [decode_update(rows) for rows in encode_update(update, max_bytes)]
    names = ("versions", "indices", "log_odds", "codes")
    arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    own = {(p.robot, p.session, p.sender, p.voxel_size) for p in parts}
    assert own == {(update.robot, update.session, update.sender, update.voxel_size)}
    return MapUpdate(update.voxel_size, update.robot, *arrays, update.session, update.sender)


def same_order(update: MapUpdate | VoxelChanges, name: str) -> np.ndarray:
    order = np.lexsort(update.indices.T)
    return getattr(update, name)[order]


@pytest.mark.parametrize("reach", [2**20, 300, 12])
@pytest.mark.parametrize("name", ["indices", "log_odds", "codes", "versions"])
def test_states_come_back_unchanged(rng: np.random.Generator, name: str, reach: int) -> None:
    update = make_update(rng, reach=reach)

    received = joined(update, 2000)

    np.testing.assert_array_equal(same_order(received, name), same_order(update, name))


def test_states_of_several_versions_that_another_robot_tells_come_back(
    rng: np.random.Generator,
) -> None:
    source = make_update(rng, reach=12)
    versions = rng.integers(1, 4, len(source.indices)).astype(np.uint32)
    update = MapUpdate(0.05, 7, versions, source.indices, source.log_odds, source.codes, 5, 9)

    received = joined(update, 3000)

    for name in ("versions", "indices", "log_odds", "codes"):
        np.testing.assert_array_equal(same_order(received, name), same_order(update, name))


def test_gaussians_come_back_within_a_tenth_of_sigma_in_every_direction(
    rng: np.random.Generator,
) -> None:
    changes = make_changes(rng, 4000)

    received = joined(MapUpdate.of_changes(changes, 0.05, 7, 1), 100_000)

    surface = same_order(changes, "has_gaussian")
    sent, got = (same_order(u, "covariances")[surface] for u in (changes, received))
    whiten = np.linalg.inv(np.linalg.cholesky(sent))
    ratios = np.linalg.eigvalsh(whiten @ got @ whiten.transpose(0, 2, 1))
    np.testing.assert_allclose(np.sqrt(ratios), 1.0, atol=0.1)
    shift = same_order(received, "means")[surface] - same_order(changes, "means")[surface]
    assert np.linalg.norm(np.einsum("kij,kj->ki", whiten, shift), axis=1).max() < 0.1
    assert np.isnan(same_order(received, "means")[~surface]).all()


def test_a_voxel_takes_few_bytes(rng: np.random.Generator) -> None:
    alone = make_update(rng, 1000)
    alone.codes[:] = 0
    places = np.indices((40, 40, 40)).reshape(3, -1).T.astype(np.int32)
    nothing = np.zeros((len(places), 2), np.uint64)
    ones = np.ones(len(places), np.uint32)
    filled = MapUpdate(0.05, 1, ones, places, ones.astype(np.int8), nothing)
    surfaces = make_update(rng, 1000, reach=100)
    surfaces = surfaces.rows(surfaces.has_gaussian)

    def row_bytes(update: MapUpdate) -> float:
        return sum(rows.nbytes for rows in encode_update(update)) / len(update.indices)

    assert row_bytes(alone) <= 11.0
    assert row_bytes(filled) <= 1.5
    assert row_bytes(surfaces) <= 18.0


def test_messages_stay_below_the_limit(rng: np.random.Generator) -> None:
    parts = encode_update(make_update(rng, 5000, reach=40), max_bytes=10_000)

    names = sum(len(name) + 40 for name in parts[0].dtype.names)
    assert max(part.nbytes for part in parts) + names <= 10_000
    assert len(parts) > 2


def test_an_update_without_voxels_needs_no_message(rng: np.random.Generator) -> None:
    assert encode_update(make_update(rng, 0)) == []


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("covariances", np.diag([1.0, -1.0, 1.0]), "positive definite"),
        ("covariances", np.full((3, 3), np.nan), "not finite"),
        ("means", np.full(3, np.inf), "mean"),
        ("log_odds", -21, "log-odds -21"),
    ],
)
def test_impossible_changes_are_refused(
    rng: np.random.Generator, name: str, value: object, problem: str
) -> None:
    changes = make_changes(rng)
    getattr(changes, name)[changes.has_gaussian] = value

    with pytest.raises(InvalidInputError, match=problem):
        MapUpdate.of_changes(changes, 0.05, 7, 1)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("robot", 65536, "robot 65536"),
        ("robot", "x", "robot 'x'"),
        ("version", 0, "version 0"),
        ("version", 2**32, "version 4294967296"),
        ("voxel_size", "nan", "voxel size"),
        ("voxel_size", -1.0, "voxel size"),
        ("origin_x", 2**20 - 1, "outside the coordinate limits"),
        ("origin_y", 2**20, "origin_y"),
        ("session", "", "malformed"),
    ],
)
def test_impossible_facts_are_refused(name: str, value: object, problem: str) -> None:
    rows = np.ones(2, dtype_with_header(OCCUPANCY_ROW, FACTS | {name: value}))

    with pytest.raises(InvalidInputError, match=problem):
        decode_update(rows)


def test_log_odds_beyond_the_limit_are_refused() -> None:
    rows = np.zeros(2, dtype_with_header(OCCUPANCY_ROW, FACTS))
    rows["log_odds"][1, 3] = 21

    with pytest.raises(InvalidInputError, match="log-odds 21"):
        decode_update(rows)


@pytest.mark.parametrize("dtype", [OCCUPANCY_ROW, np.dtype([("x", "<f4")])])
def test_rows_without_facts_or_with_other_fields_are_refused(dtype: np.dtype) -> None:
    with pytest.raises(InvalidInputError, match="fields"):
        decode_update(np.zeros(1, dtype))
    if dtype != OCCUPANCY_ROW:
        with pytest.raises(InvalidInputError, match="fields"):
            decode_update(np.zeros(1, dtype_with_header(dtype, FACTS)))


@pytest.mark.parametrize("dtype", [OCCUPANCY_ROW, SURFACE_ROW])
@settings(deadline=None, max_examples=50)
@given(data=st.data())
def test_any_bytes_are_decoded_or_refused(dtype: np.dtype, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 3))
    raw = data.draw(hnp.arrays(np.uint8, count * dtype.itemsize))

    try:
        update = decode_update(raw.view(dtype_with_header(dtype, FACTS)))
    except InvalidInputError:
        return

    assert len(update.indices) == len(update.log_odds) <= 8 * count
    assert np.isfinite(update.means[update.has_gaussian]).all()
    covariances = update.covariances[update.has_gaussian]
    assert (np.linalg.eigvalsh(covariances / 0.05**2) > 0.0).all()
