"""The map is as sure as it should be: its errors fit its own covariances."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.cli.study_consistency import draw_histograms
from infomap_ros.studies.map_consistency import (
    INDEPENDENT,
    ConsistencyConfig,
    ConsistencyResult,
    Setting,
    nees_band,
    run_study,
    settings_of,
    summary,
    table,
)
from infomap_ros.studies.scan_sequences import CASES

AT_5_CM = Setting(INDEPENDENT, 0.0, 0.05)
SMALL = ConsistencyConfig(scenes=12, scans=20, correlations=(0.0,), voxel_sizes=(0.05,), seed=10000)


@pytest.fixture(scope="module")
def results() -> list[ConsistencyResult]:
    """A small run of the study, with other seeds than the published one."""
    return run_study(SMALL)


def test_independent_scans_are_within_the_chi_square_band(results):
    for result in results:
        if result.setting.case == INDEPENDENT:
            low, high = result.band
            assert low <= result.mean_nees <= high
            assert 0.7 < result.mean_nees_of_all < 1.25


def test_scans_that_share_errors_are_not_taken_as_independent(results):
    """20 scans with one error would have a NEES of 20 in a map that takes them as independent."""
    for result in results:
        assert 0.5 < result.mean_nees_of_all < 1.5, result.setting
        assert np.mean(np.abs(result.all_errors) < 2.0) > 0.9, result.setting


def test_errors_of_independent_scans_have_no_bias(results):
    for result in results:
        if result.setting.case == INDEPENDENT:
            assert abs(np.mean(result.all_errors)) < 0.25


def test_every_case_is_studied_and_a_misplaced_map_in_two_ways():
    settings = settings_of(SMALL)
    assert {setting.case for setting in settings} == {INDEPENDENT, *CASES}
    assert {setting.relative for setting in settings if setting.case == "offset"} == {False, True}


def test_band_is_that_of_simulated_means(rng):
    low, high = nees_band(50)
    means = (rng.normal(size=(20000, 50)) ** 2).mean(axis=1)
    assert np.mean(means < low) == pytest.approx(0.025, abs=0.005)
    assert np.mean(means > high) == pytest.approx(0.025, abs=0.005)


def test_overconfident_errors_are_called_inconsistent(rng):
    errors = rng.normal(size=200)
    assert ConsistencyResult(AT_5_CM, errors, errors).is_consistent
    assert not ConsistencyResult(AT_5_CM, 1.3 * errors, errors).is_consistent
    assert not ConsistencyResult(AT_5_CM, 0.7 * errors, errors).is_consistent


def test_results_are_told_and_drawn(results, tmp_path):
    assert "| independent | absolute | independent | 5 cm | 12 |" in table(results)
    figures = summary(results, 1.5)
    assert figures["nees_independent_50mm"] == results[0].mean_nees
    assert figures["seconds"] == 1.5
    draw_histograms(results, tmp_path / "histograms.png")
    assert (tmp_path / "histograms.png").stat().st_size > 10000
