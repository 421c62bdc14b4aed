"""Map updates survive the wire within their quantisation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from infomap_ros.errors import InvalidInputError
from infomap_ros.team import (
    NOT_OBSERVED,
    OCCUPANCY_ROW,
    SURFACE_ROW,
    MapUpdate,
    decode_update,
    encode_update,
)


def make_update(rng: np.random.Generator, count: int = 400, voxel_size: float = 0.05) -> MapUpdate:
    indices = rng.integers(-(2**20), 2**20, (count, 3)).astype(np.int32)
    has_gaussian = rng.random(count) < 0.5
    means = (indices + rng.uniform(-1.0, 2.0, (count, 3))) * voxel_size
    factors = rng.normal(size=(count, 3, 3)) * rng.choice([0.001, 0.05, 1.0], (count, 1, 1))
    covariances = factors @ factors.transpose(0, 2, 1) + 1e-10 * np.eye(3)
    means[~has_gaussian] = np.nan
    covariances[~has_gaussian] = np.nan
    log_odds = rng.choice([*range(-20, 21), NOT_OBSERVED], count).astype(np.int8)
    return MapUpdate(
        voxel_size, 7, 3_000_000_000, indices, log_odds, has_gaussian, means, covariances
    )


def joined(update: MapUpdate, max_bytes: int) -> MapUpdate:
    parts = [decode_update(rows) for rows in encode_update(update, max_bytes)]
    names = ("indices", "log_odds", "has_gaussian", "means", "covariances")
    arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    assert {(p.robot, p.version) for p in parts} == {(update.robot, update.version)}
    return MapUpdate(parts[0].voxel_size, parts[0].robot, parts[0].version, *arrays)


def same_order(update: MapUpdate, name: str) -> np.ndarray:
    order = np.lexsort(update.indices.T)
    return getattr(update, name)[order]


@pytest.mark.parametrize("name", ["indices", "log_odds", "has_gaussian"])
def test_indices_and_log_odds_come_back_unchanged(rng: np.random.Generator, name: str) -> None:
    update = make_update(rng)

    received = joined(update, 2000)

    np.testing.assert_array_equal(same_order(received, name), same_order(update, name))


def test_means_come_back_within_half_a_step(rng: np.random.Generator) -> None:
    update = make_update(rng)

    received = joined(update, 2000)

    difference = same_order(received, "means") - same_order(update, "means")
    bound = 0.05 / 2048 + 1e-9 * np.nanmax(np.abs(update.means))
    assert np.nanmax(np.abs(difference)) <= bound
    np.testing.assert_array_equal(np.isnan(difference[:, 0]), ~same_order(update, "has_gaussian"))


def test_covariances_come_back_within_the_quantisation_in_every_direction(
    rng: np.random.Generator,
) -> None:
    update = make_update(rng)

    received = joined(update, 2000)

    sent, got = (same_order(u, "covariances") for u in (update, received))
    surface = same_order(update, "has_gaussian")
    for before, after in zip(sent[surface], got[surface], strict=True):
        # eigenvalues of after relative to before: the ratio of variances in any direction
        ratios = np.linalg.eigvals(np.linalg.solve(before, after)).real
        np.testing.assert_allclose(ratios, 1.0, atol=0.01)


def test_messages_stay_below_the_limit(rng: np.random.Generator) -> None:
    parts = encode_update(make_update(rng, 5000), max_bytes=10_000)

    assert max(part.nbytes for part in parts) <= 10_000
    assert sum(len(part) for part in parts) == 5000


def test_an_update_without_voxels_needs_no_message(rng: np.random.Generator) -> None:
    assert encode_update(make_update(rng, 0)) == []


def test_a_covariance_that_is_not_positive_definite_is_refused(rng: np.random.Generator) -> None:
    update = make_update(rng)
    update.covariances[update.has_gaussian] = np.diag([1.0, -1.0, 1.0])

    with pytest.raises(InvalidInputError, match="positive definite"):
        encode_update(update)


def test_a_mean_that_is_not_finite_is_refused(rng: np.random.Generator) -> None:
    update = make_update(rng)
    update.means[update.has_gaussian] = np.inf

    with pytest.raises(InvalidInputError, match="mean"):
        encode_update(update)


def test_rows_of_two_robots_in_one_message_are_refused(rng: np.random.Generator) -> None:
    rows = encode_update(make_update(rng))[0]
    rows["robot"][0] += 1

    with pytest.raises(InvalidInputError, match="more than one robot"):
        decode_update(rows)


def test_log_odds_beyond_the_limit_are_refused_on_both_sides(rng: np.random.Generator) -> None:
    update = make_update(rng)
    rows = encode_update(update)[0]
    rows["log_odds"][3] = 21
    update.log_odds[5] = -21

    with pytest.raises(InvalidInputError, match="log-odds 21"):
        decode_update(rows)
    with pytest.raises(InvalidInputError, match="log-odds -21"):
        encode_update(update)


def test_version_zero_is_refused(rng: np.random.Generator) -> None:
    rows = encode_update(make_update(rng))[0]
    rows["version"] = 0

    with pytest.raises(InvalidInputError, match="version 0"):
        decode_update(rows)


@pytest.mark.parametrize("dtype", [OCCUPANCY_ROW, SURFACE_ROW])
@settings(deadline=None, max_examples=50)
@given(data=st.data())
def test_any_bytes_are_decoded_or_refused(dtype: np.dtype, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 3))
    raw = data.draw(hnp.arrays(np.uint8, count * dtype.itemsize))

    try:
        update = decode_update(raw.view(dtype))
    except InvalidInputError:
        return

    assert len(update.indices) == count
    assert np.isfinite(update.means[update.has_gaussian]).all()
