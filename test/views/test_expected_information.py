"""What a view is expected to tell, against slow oracles, closed forms and the paper's intent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, StereoRig, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.views.information.gains import expected_reduction
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig

from . import naive
from .voxels import map_of

CAMERA = PinholeCamera(64, 48, 50.0, 45.0, 30.0, 25.0)
GRID = VoxelMapConfig(voxel_size=0.2, error_correlation=0.3)
COARSE = InformationConfig(ray_spacing=0.09, range_noise=0.02)


def random_map(rng: np.random.Generator, side: int = 24) -> VoxelMap:
    """Clutter of unknown, empty, uncertain and solid voxels, a third of the blocks all alike."""
    kinds = np.array([UNKNOWN_QUANTA, -30, -5, 0, 3, 10, 20])
    quanta = rng.choice(kinds, (side, side, side), p=[0.2, 0.65, 0.06, 0.04, 0.02, 0.01, 0.02])
    for corner in np.ndindex(side // 8, side // 8, side // 8):
        if rng.random() < 0.33:
            block = tuple(slice(8 * c, 8 * c + 8) for c in corner)
            quanta[block] = rng.choice([UNKNOWN_QUANTA, -30, -4])
    return map_of(quanta, (-8, -16, -8), GRID)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    position = (np.array([-8, -16, -8]) + rng.uniform(6.0, 18.0, 3)) * GRID.voxel_size
    return make_transform(Rotation.random(random_state=rng).as_matrix(), position)


@pytest.mark.parametrize(("occlusion", "hiding"), [(0.0, 0.5), (0.6, 0.5), (0.0, 0.9)])
def test_agrees_with_a_naive_sum(rng: np.random.Generator, occlusion: float, hiding: float) -> None:
    m, config = (
        random_map(rng),
        InformationConfig(
            0.09, unknown_occlusion=occlusion, known_weight=0.4, hiding_probability=hiding
        ),
    )
    poses = np.array([random_pose(rng) for _ in range(4)])
    bits = expected_information(m, poses, CAMERA, 3.1, config=config)
    expected = [naive.view_bits(m, pose, CAMERA, 3.1, config) for pose in poses]
    np.testing.assert_allclose(bits, expected, rtol=1e-4)
    assert min(expected) > 1.0


def test_only_the_region_counts_but_all_hides(rng: np.random.Generator) -> None:
    m, region = random_map(rng), np.array([[-1.0, -3.0, -0.7], [2.0, 0.5, 1.9]])
    poses = np.array([random_pose(rng) for _ in range(4)])
    poses[0, :3, 3] = (-2.0, 0.9, 0.3)  # outside
    bits = expected_information(m, poses, CAMERA, 4.0, config=COARSE, region=region)
    expected = [naive.view_bits(m, pose, CAMERA, 4.0, COARSE, region) for pose in poses]
    np.testing.assert_allclose(bits, expected, rtol=0.01, atol=0.5)  # steps at the region's edge
    assert (bits < 0.8 * expected_information(m, poses, CAMERA, 4.0, config=COARSE)).all()


def test_doubtful_voxels_in_a_gap_do_not_close_it_for_a_stereo_pair() -> None:
    """Three layers of them, of evidence that is less than that of one hit; of one hit they do."""
    rig = StereoRig(CAMERA, CAMERA, 0.1)
    config = InformationConfig.of_stereo(rig)
    bits = []
    for evidence in (-30, GRID.hit_quanta - 1, GRID.hit_quanta):
        quanta = np.full((40, 40, 40), UNKNOWN_QUANTA)
        quanta[:, :, :14] = -30
        quanta[:, :, 10:13] = evidence
        m = map_of(quanta, (-20, -20, 0), GRID)
        far = np.array([[-4.0, -4.0, 2.8], [4.0, 4.0, 8.0]])
        bits += [expected_information(m, np.eye(4), CAMERA, 4.0, config=config, region=far)[0]]
    assert bits[0] > 100.0
    assert bits[1] == pytest.approx(bits[0], rel=1e-6)
    assert bits[2] < 0.1 * bits[0]


def test_unknown_space_tells_its_volume_integral() -> None:
    config = InformationConfig(min_range=0.5, range_noise=0.01)
    m = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    bits = expected_information(m, np.eye(4), CAMERA, 6.0, config=config)[0]
    gain = naive.voxel_gain(m, False, 0.0, config)
    integral = quad(lambda r: naive.observed_share(m, r, config) * r * r, 0.5, 6.0)[0]
    angle = sum(cell[1] for cell in naive.image_cells(CAMERA, 0.5))
    assert bits == pytest.approx(gain * angle * integral / 0.05**3, rel=1e-3)


def test_sum_over_visible_voxels_one_by_one() -> None:
    """Voxel by voxel, visible where the line to its middle meets nothing solid."""
    side, rng = 40, np.random.default_rng(5)
    quanta = np.where(rng.random((side, side, side)) < 0.5, UNKNOWN_QUANTA, -30)
    for corner in rng.integers(4, side - 10, (25, 3)):
        quanta[tuple(slice(c, c + 5) for c in corner)] = 30
    grid = VoxelMapConfig(voxel_size=0.1)
    m = map_of(quanta, (0, 0, 0), grid)
    config = InformationConfig(ray_spacing=0.01, min_range=0.0)
    pose = make_transform(Rotation.from_rotvec([0.3, 0.5, 0.2]).as_matrix(), (0.4, 0.5, 0.3))
    region = np.array([[0.0] * 3, [4.0] * 3])  # all beyond is unknown
    bits = expected_information(m, pose, CAMERA, 3.0, config=config, region=region)[0]
    offsets = (np.argwhere(quanta == UNKNOWN_QUANTA) + 0.5) * 0.1 - pose[:3, 3]
    distances = np.linalg.norm(offsets, axis=1)
    u, v = CAMERA.project(offsets @ pose[:3, :3]).T
    seen = (distances < 3.0) & (u > -0.5) & (u < 63.5) & (v > -0.5) & (v < 47.5)
    free_distance, _ = m.first_occupied(pose[:3, 3], offsets[seen], 3.0)
    visible = distances[seen][free_distance > distances[seen] - 0.05]
    gain = naive.voxel_gain(m, False, 0.0, config)
    expected = gain * sum(naive.observed_share(m, r, config) for r in visible)
    assert bits == pytest.approx(expected, rel=0.02)


def test_bits_do_not_depend_on_rays_or_pixels(rng: np.random.Generator) -> None:
    m, poses = random_map(rng), np.array([random_pose(rng) for _ in range(3)])
    fine = expected_information(m, poses, CAMERA, 3.0, config=InformationConfig(0.005))
    for spacing in (0.01, 0.02, 0.04):
        bits = expected_information(m, poses, CAMERA, 3.0, config=InformationConfig(spacing))
        np.testing.assert_allclose(bits, fine, rtol=2.0 * spacing)
    reduced = expected_information(m, poses, CAMERA.scaled(0.25), 3.0)
    np.testing.assert_allclose(reduced, fine, rtol=0.02)


def test_threads_change_nothing(rng: np.random.Generator) -> None:
    m, poses = random_map(rng), np.array([random_pose(rng) for _ in range(3)])
    one = expected_information(m, poses, CAMERA, 3.0, config=COARSE)
    two = expected_information(m, poses, CAMERA, 3.0, config=COARSE, threads=2)
    np.testing.assert_allclose(two, one, rtol=1e-12)


def test_a_far_glance_tells_less_than_a_near_look() -> None:
    quanta = np.full((64, 16, 16), -30)
    quanta[56:] = UNKNOWN_QUANTA
    m = map_of(quanta, (0, -8, -8), VoxelMapConfig(voxel_size=0.1))
    forward = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).as_matrix()
    region = np.array([[5.6, -0.1, -0.1], [6.0, 0.1, 0.1]])  # within every image
    poses = np.array([make_transform(forward, (x, 0.0, 0.0)) for x in (0.5, 2.0, 3.5)])
    wide = PinholeCamera(48, 48, 100.0, 100.0, 23.5, 23.5)
    config = InformationConfig(ray_spacing=0.001, range_noise=0.01)
    bits = expected_information(m, poses, wide, 8.0, config=config, region=region)
    assert bits[0] < 0.8 * bits[1] < 0.64 * bits[2]
    exact = InformationConfig(ray_spacing=0.001, range_noise=0.0, pixel_angle=1e-5)
    bits = expected_information(m, poses[1:], wide, 8.0, config=exact, region=region)
    assert bits[0] == pytest.approx(bits[1], rel=0.05)


@pytest.mark.parametrize("p", [0.02, 0.2, 0.5, 0.77, 0.999])
def test_value_of_an_observation_is_the_mutual_information(p: float) -> None:
    for hit, miss in ((2.25, -1.5), (0.4, -0.1), (1.0, -3.0)):
        expected = naive.mutual_information(p, hit, miss)
        assert expected_reduction(p, hit, miss) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("poses", "max_range", "metric", "message"),
    [
        (np.zeros((2, 3)), 3.0, "expected_entropy_reduction", "poses"),
        (np.diag([2.0, 1.0, 1.0, 1.0]), 3.0, "expected_entropy_reduction", "rotation"),
        (np.diag([1.0, 1.0, np.nan, 1.0]), 3.0, "expected_entropy_reduction", "NaN"),
        (np.eye(4), -1.0, "expected_entropy_reduction", "max_range"),
        (np.eye(4), 3.0, "luck", "luck"),
    ],
)
def test_bad_input_is_named(poses: np.ndarray, max_range: float, metric: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        expected_information(VoxelMap(), poses, CAMERA, max_range, metric)


def test_no_poses_tell_nothing() -> None:
    assert expected_information(VoxelMap(), np.empty((0, 4, 4)), CAMERA, 3.0).shape == (0,)
