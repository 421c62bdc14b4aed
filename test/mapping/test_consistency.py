"""The map is as sure as it should be: its errors fit its own covariances."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.studies.consistency_figure import draw_histograms
from infomap_ros.studies.map_consistency import (
    ConsistencyConfig,
    ConsistencyResult,
    nees_band,
    run_study,
    summary,
    table,
)


@pytest.fixture(scope="module")
def results() -> list[ConsistencyResult]:
    """A small run of the study, with other seeds than the published one."""
    return run_study(ConsistencyConfig(scenes=16, voxel_sizes=(0.02, 0.05), seed=10000))


def test_one_voxel_per_scene_is_within_the_chi_square_band(results):
    for result in results:
        low, high = result.band
        assert low <= result.mean_nees <= high


def test_no_voxel_size_is_overconfident_or_timid(results):
    """All voxels of a few scenes: the poses' errors leave about 10 % of freedom."""
    for result in results:
        assert 0.7 < result.mean_nees_of_all < 1.25


def test_errors_have_no_bias(results):
    for result in results:
        assert abs(np.mean(result.all_errors)) < 0.25


def test_band_is_that_of_simulated_means(rng):
    low, high = nees_band(50)
    means = (rng.normal(size=(20000, 50)) ** 2).mean(axis=1)
    assert np.mean(means < low) == pytest.approx(0.025, abs=0.005)
    assert np.mean(means > high) == pytest.approx(0.025, abs=0.005)


def test_overconfident_errors_are_called_inconsistent(rng):
    errors = rng.normal(size=200)
    assert ConsistencyResult(0.05, errors, errors).is_consistent
    assert not ConsistencyResult(0.05, 1.3 * errors, errors).is_consistent
    assert not ConsistencyResult(0.05, 0.7 * errors, errors).is_consistent


def test_results_are_told_and_drawn(results, tmp_path):
    assert "| 2 cm | 16 |" in table(results)
    figures = summary(results, 1.5)
    assert figures["nees_20mm"] == results[0].mean_nees
    assert figures["seconds"] == 1.5
    draw_histograms(results, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
