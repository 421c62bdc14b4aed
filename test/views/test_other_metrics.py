"""The metrics of the paper as printed, and those of others, against slow oracles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.studies.published_metrics import EVERY_METRIC, near_share
from infomap_ros.views.information.printed_metrics import stretched
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig

from . import naive, naive_metrics
from .voxels import map_of

CAMERA = PinholeCamera(64, 48, 50.0, 45.0, 30.0, 25.0)
CONFIG = InformationConfig(ray_spacing=0.15, min_range=0.4)
RANGE = 2.3
OTHERS = (
    "occlusion_aware",
    "unobserved_voxels",
    "rear_side_voxel",
    "rear_side_entropy",
    "proximity_count",
    "average_entropy",
    "area_factor",
)
PRINTED = ("scene_entropy", "stretched_scene_entropy", "weighted_scene_entropy")


def clutter(seed: int) -> tuple[VoxelMap, np.ndarray, np.ndarray]:
    """A map in clumps, the indices of its surfaces, and a pose in it."""
    rng = np.random.default_rng(seed)
    coarse = rng.choice(
        [UNKNOWN_QUANTA, -13, -6, -2, 1, 9], (8, 8, 8), p=[0.4, 0.3, 0.1, 0.1, 0, 0.1]
    )
    quanta = np.kron(coarse, np.ones((3, 3, 3), int))
    quanta[rng.random(quanta.shape) < 0.1] = UNKNOWN_QUANTA
    first = (-8, -8, -16)
    surfaces = np.argwhere(quanta > 0) + first
    position = (np.array(first) + rng.uniform(8.0, 16.0, 3)) * 0.2
    rotation = Rotation.random(random_state=rng).as_matrix()
    return (
        map_of(quanta, first, VoxelMapConfig(voxel_size=0.2)),
        surfaces,
        make_transform(rotation, position),
    )


@pytest.mark.parametrize("seed", range(3))
def test_metrics_of_others_agree_with_naive_sums(seed: int) -> None:
    m, surfaces, pose = clutter(seed)
    expected = naive_metrics.summed(m, pose, CAMERA, RANGE, CONFIG, surfaces)
    assert set(expected) == set(OTHERS)
    for metric in OTHERS:
        value = expected_information(m, pose, CAMERA, RANGE, EVERY_METRIC[metric], CONFIG)[0]
        assert value == pytest.approx(expected[metric], rel=1e-5), metric
    assert sum(value > 0.0 for value in expected.values()) >= 5


@pytest.mark.parametrize("seed", range(3))
def test_printed_equations_agree_with_naive_histograms(seed: int) -> None:
    m, _, pose = clutter(seed)
    expected = naive_metrics.printed(m, pose, CAMERA, RANGE, CONFIG)
    assert set(expected) == set(PRINTED)
    for metric in PRINTED:
        value = expected_information(m, pose, CAMERA, RANGE, EVERY_METRIC[metric], CONFIG)[0]
        assert value == pytest.approx(expected[metric], rel=1e-6), metric
        assert value > 0.1


def test_every_metric_is_tested_here_or_is_the_default() -> None:
    assert set(EVERY_METRIC) == {*OTHERS, *PRINTED, "expected_entropy_reduction"}


def test_printed_entropy_of_a_wholly_unknown_view_is_zero() -> None:
    """The trap that the default metric does not share."""
    m = VoxelMap(VoxelMapConfig(voxel_size=0.2))
    for metric in PRINTED[:1] + PRINTED[2:]:
        assert expected_information(m, np.eye(4), CAMERA, RANGE, metric)[0] < 1e-9
    assert expected_information(m, np.eye(4), CAMERA, RANGE)[0] > 100.0


def test_stretched_gray_levels_stay_in_their_half() -> None:
    p, d = np.linspace(0.0, 1.0, 101), np.linspace(0.01, 1.0, 50)[:, None]
    levels = stretched(p, d)
    assert ((levels >= 0.0) & (levels <= 1.0)).all()
    assert (levels[:, p < 0.5] <= 0.5).all() and (levels[:, p >= 0.5] >= 0.5).all()
    np.testing.assert_allclose(levels[-1, [0, 25, 50, 75, 100]], [0, 1 / 6, 0.5, 5 / 6, 1])


@pytest.mark.parametrize("metric", [*OTHERS, *PRINTED])
def test_do_not_depend_on_the_number_of_rays(metric: str) -> None:
    value = EVERY_METRIC[metric]
    m, _, pose = clutter(1)
    fine, finer = (
        expected_information(m, pose, CAMERA, RANGE, value, InformationConfig(spacing))[0]
        for spacing in (0.01, 0.005)
    )
    assert fine == pytest.approx(finer, rel=0.02)


@pytest.mark.parametrize("metric", [*OTHERS, *PRINTED])
def test_only_the_region_counts(metric: str) -> None:
    """Information of two halves is that of the whole, where a metric is a sum over voxels."""
    value = EVERY_METRIC[metric]
    m, _, pose = clutter(2)
    cut = pose[0, 3] + 0.7 * pose[0, 2]
    halves = np.array([[[-99.0] * 3, [cut, 99.0, 99.0]], [[cut, -99.0, -99.0], [99.0] * 3]])
    whole = expected_information(m, pose, CAMERA, RANGE, value, CONFIG)[0]
    parts = [
        expected_information(m, pose, CAMERA, RANGE, value, CONFIG, region=half, threads=2)[0]
        for half in halves
    ]
    if metric in ("occlusion_aware", "unobserved_voxels", "proximity_count", "rear_side_voxel"):
        assert sum(parts) == pytest.approx(whole, rel=1e-9)
    nowhere = np.array([[50.0] * 3, [51.0] * 3])
    assert expected_information(m, pose, CAMERA, RANGE, value, CONFIG, nowhere)[0] == 0.0


def test_area_factor_is_largest_at_the_wanted_shares() -> None:
    for wanted in (0.2, 0.8):
        shares = np.linspace(0.0, 1.0, 101)
        values = near_share(shares, wanted)
        assert shares[values.argmax()] == pytest.approx(wanted)
        np.testing.assert_allclose(
            values, [naive_metrics.factor(x, wanted) for x in shares], atol=1e-12
        )
        assert values.max() == 1.0 and values[0] == values[-1] == 0.0


def test_predicted_unknown_voxels_tell_what_their_probability_does() -> None:
    """The default metric with the Markov prediction: near free space the unknown tells less."""
    quanta = np.full((24, 16, 16), UNKNOWN_QUANTA)
    quanta[:14] = -10
    m = map_of(quanta, (0, -8, -8), VoxelMapConfig(voxel_size=0.1))
    forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose = make_transform(forward, (0.33, 0.02, 0.03))
    narrow = PinholeCamera(48, 48, 200.0, 200.0, 23.5, 23.5)
    config = InformationConfig(0.01, predict_unknown=True)
    region = np.array([[1.45, -0.8, -0.8], [2.05, 0.8, 0.8]])  # a few steps from the known
    told = expected_information(m, pose, narrow, 3.0, config=config, region=region)[0]
    prior = expected_information(
        m, pose, narrow, 3.0, config=InformationConfig(0.01), region=region
    )[0]
    p = 1.0 / (1.0 + np.exp(10 * 0.25))
    gains = [naive.mutual_information(q, 2.25, -1.5) for q in (p, 0.5)]
    assert told / prior == pytest.approx(gains[0] / gains[1], rel=1e-3)
