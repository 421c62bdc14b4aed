from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.stereo import StereoConfig
from infomap_ros.stereo.evaluation import load_pairs
from infomap_ros.stereo.matching import DisparityMatcher, disparity_range


def rig(width=640, focal=500.0, baseline=0.1, offset=0.0):
    left = PinholeCamera(width, 480, focal, focal, 320.0, 240.0)
    right = PinholeCamera(width, 480, focal, focal, 320.0 + offset, 240.0)
    return StereoRig(left, right, baseline)


@given(
    focal=st.floats(100.0, 2000.0),
    baseline=st.floats(0.02, 0.5),
    offset=st.floats(-50.0, 50.0),
    near=st.floats(0.2, 5.0),
    ratio=st.floats(1.5, 30.0),
)
def test_the_search_covers_the_wanted_depths_or_gives_way_at_the_near_end(
    focal, baseline, offset, near, ratio
):
    pair = rig(focal=focal, baseline=baseline, offset=offset)
    config = StereoConfig(min_depth=near, max_depth=near * ratio)
    search = disparity_range(pair, config)
    assert search.count % 16 == 0
    assert search.minimum <= pair.disparity_from_depth(near * ratio)
    covered = search.maximum >= pair.disparity_from_depth(near)
    assert covered or search.count == 16 * int(config.max_search * 640 / 16)


def test_a_principal_offset_shifts_the_search():
    config = StereoConfig(min_depth=1.0, max_depth=10.0)
    plain, shifted = (disparity_range(rig(offset=o), config) for o in (0.0, 30.0))
    assert (plain.minimum, shifted.minimum) == (5, -25)
    assert plain.count == shifted.count


def test_an_image_too_narrow_to_search_is_refused():
    with pytest.raises(CalibrationError, match="20 px"):
        disparity_range(rig(width=20), StereoConfig())


@pytest.mark.parametrize("matcher", ["sgbm_3way", "sgbm", "sgbm_hh"])
def test_a_real_pair_upside_down_has_the_same_disparities(real_data: Path, matcher: str) -> None:
    (pair,) = load_pairs(real_data / "stereo_motorcycle")
    config = pair.search(StereoConfig(matcher=matcher))
    searcher = DisparityMatcher(disparity_range(pair.rig, config), config)
    upright, turned = (
        searcher.match(
            cv2.cvtColor(left, cv2.COLOR_RGB2GRAY), cv2.cvtColor(right, cv2.COLOR_RGB2GRAY)
        )
        for left, right in ((pair.left, pair.right), (pair.left[::-1], pair.right[::-1]))
    )
    found = (upright > searcher.invalid) & (turned[::-1] > searcher.invalid)
    assert found.mean() > 0.6
    difference = upright.astype(int) - turned[::-1]
    assert np.abs(difference[found]).max() <= 1
