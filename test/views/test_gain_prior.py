"""What the map has gained by a view against what the view still promises."""

from __future__ import annotations

import numpy as np

from infomap_ros.views.decision import GainPrior


def test_share_is_what_was_told_of_all_that_could_be() -> None:
    kept = GainPrior()
    kept.note([100.0], 5000.0)  # nobody knows what the region's entropy was before
    kept.note([100.0], 4700.0)
    kept.note([250.0], 4700.0)
    kept.note([0.0], 4690.0)
    np.testing.assert_array_equal(kept.shares, [np.nan, 0.75, 0.0, 1.0])


def test_map_that_becomes_less_sure_has_been_told_nothing() -> None:
    kept = GainPrior()
    kept.note([10.0], 1000.0)
    kept.note([10.0], 1020.0)
    kept.note([10.0], 990.0)
    np.testing.assert_array_equal(kept.shares, [np.nan, 0.0, 0.75])


def test_views_between_which_nobody_has_measured_are_not_judged() -> None:
    kept = GainPrior()
    kept.note([10.0], 1000.0)
    kept.note([10.0, 20.0], 900.0)
    kept.note([], 880.0)
    kept.note([20.0], 800.0)
    np.testing.assert_array_equal(kept.shares, [np.nan, np.nan, np.nan, 0.8])


def test_view_into_known_space_is_not_judged() -> None:
    kept = GainPrior()
    kept.note([0.0], 1000.0)
    kept.note([0.0], 1000.0)
    assert np.isnan(kept.shares).all()


def test_a_view_that_was_only_wanted_leaves_the_one_taken_beside_it_known() -> None:
    kept = GainPrior()
    kept.note([10.0], 1000.0)
    kept.note([30.0, np.nan], 990.0)
    np.testing.assert_array_equal(kept.shares, [np.nan, 0.25, np.nan])
