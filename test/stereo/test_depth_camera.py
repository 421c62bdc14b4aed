from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import CalibrationError, ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, transform_from_quaternion
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.scan_record import keep_scan
from infomap_ros.stereo import DepthCameraConfig, DepthCameraSensor, depth_camera

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)


def plane(normal, distance):
    """Depth image of the plane ``normal . p = distance``."""
    v, u = np.mgrid[0:48, 0:64]
    rays = np.stack([(u - 31.5) / 60.0, (v - 23.5) / 60.0, np.ones_like(u, float)], axis=-1)
    return (distance / (rays @ np.asarray(normal))).astype(np.float32)


def test_millimeters_and_meters_give_the_same_points():
    depth = plane((0.0, 0.0, 1.0), 2.0)
    sensor = DepthCameraSensor(CAMERA)
    meters = sensor.measure(depth)
    millimeters = sensor.measure(np.rint(depth * 1000.0).astype(np.uint16))
    np.testing.assert_allclose(meters.points, millimeters.points, atol=1e-6)
    assert meters.density > 0.85


@pytest.mark.parametrize("distance", [0.8, 2.0, 4.0])
def test_noise_seen_head_on_is_the_published_polynomial(distance):
    cloud = DepthCameraSensor(CAMERA).measure(plane((0.0, 0.0, 1.0), distance))
    center = np.sqrt(cloud.organized_covariances[24, 32, 2, 2])
    rounding = 0.001 / np.sqrt(12.0)
    expected = np.hypot(0.0012 + 0.0019 * (distance - 0.4) ** 2, rounding)
    assert center == pytest.approx(expected, rel=1e-3)
    lateral = np.sqrt(cloud.organized_covariances[24, 32, 0, 0])
    assert lateral == pytest.approx(0.8 * distance / 60.0, rel=1e-2)


def test_grazing_surfaces_are_noisier_and_then_dropped(monkeypatch):
    monkeypatch.setattr(depth_camera, "_EDGE_THRESHOLD", 1.0)
    monkeypatch.setattr(depth_camera, "_MAX_GRAZING_ANGLE", 1.2)
    sensor = DepthCameraSensor(CAMERA)
    angle = 1.0
    tilted = sensor.measure(plane((np.sin(angle), 0.0, np.cos(angle)), 2.0 * np.cos(angle)))
    ray = np.array([(32 - 31.5) / 60.0, (24 - 23.5) / 60.0, 1.0])
    incidence = np.arccos(np.dot([np.sin(angle), 0.0, np.cos(angle)], ray / np.linalg.norm(ray)))
    z = tilted.range_image[24, 32]
    ratio = incidence / (np.pi / 2.0 - incidence)
    expected = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * ratio**2
    found = np.sqrt(tilted.organized_covariances[24, 32, 2, 2])
    assert found == pytest.approx(expected, rel=1e-2)
    angle = 1.35
    steep = sensor.measure(plane((np.sin(angle), 0.0, np.cos(angle)), 2.0 * np.cos(angle)))
    assert np.isnan(steep.range_image[24, 32])


def test_holes_and_jumps_and_their_rims_are_dropped():
    depth = plane((0.0, 0.0, 1.0), 2.0)
    depth[:, 40:] = 3.0
    depth[10, 10] = 0.0
    depth[20, 20] = np.nan
    depth[30, 30] = np.inf
    valid = DepthCameraSensor(CAMERA).measure(depth).valid
    for v, u in ((10, 10), (20, 20), (30, 30)):
        assert not valid[v - 1 : v + 2, u - 1 : u + 2].any()
    assert not valid[:, 39:41].any()
    assert valid[5, 5]
    assert valid[5, 50]


def test_depths_out_of_range_are_dropped():
    config = DepthCameraConfig(min_depth=1.0, max_depth=3.0)
    for distance in (0.9, 3.1):
        flat = plane((0.0, 0.0, 1.0), distance)
        assert DepthCameraSensor(CAMERA, config).measure(flat).density == 0.0


def test_covariances_are_positive_definite_on_a_real_frame(real_data):
    import cv2

    file = next((real_data / "rgbd_kitchen" / "frames").glob("*.depth.png"))
    depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    camera = PinholeCamera(640, 480, 585.0, 585.0, 320.0, 240.0)
    cloud = DepthCameraSensor(camera).measure(depth)
    assert cloud.density > 0.5 * np.mean(depth > 0)
    assert np.linalg.eigvalsh(cloud.covariances[::50].astype(np.float64)).min() > 0.0


@pytest.mark.parametrize(
    ("depth", "error"),
    [
        (np.zeros((48, 64), np.int32), InvalidInputError),
        (np.zeros((48, 64, 1), np.float32), InvalidInputError),
        (np.zeros((40, 64), np.float32), CalibrationError),
    ],
)
def test_wrong_depth_images_are_refused(depth, error):
    with pytest.raises(error, match="depth image"):
        DepthCameraSensor(CAMERA).measure(depth)


def test_impossible_configurations_are_refused():
    with pytest.raises(ConfigError, match="max_depth"):
        DepthCameraConfig(min_depth=2.0, max_depth=1.0)


def test_free_space_needs_no_return():
    """REP 117: +inf is free up to the range of the map, -inf and NaN say nothing."""
    camera = PinholeCamera(160, 120, 100.0, 100.0, 79.5, 59.5)
    depth = np.full((120, 160), np.inf, np.float32)
    depth[:, :40], depth[:, 120:] = -np.inf, np.nan
    cloud = DepthCameraSensor(camera).measure(depth)
    assert not cloud.valid.any()
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=3.0))
    ahead = transform_from_quaternion((-0.5, 0.5, -0.5, 0.5), (0.0, 0.0, 0.0))
    triangles = cloud.covariance_triangles
    voxel_map.integrate(cloud.organized_points, ahead, triangles, camera=camera)
    places = np.array([[2.5, 0, 0], [2.5, 1.6, 0], [2.5, -1.6, 0], [3.2, 0, 0]])
    assert voxel_map.is_known(places).tolist() == [True, False, False, False]
    assert voxel_map.probability(places)[0] < 0.4
    assert voxel_map.surface_voxels == 0
    kept = keep_scan(cloud.organized_points, triangles, camera).restore()
    again = VoxelMap(voxel_map.config)
    again.integrate(kept.points, ahead, kept.covariances, camera=camera)
    assert again.known_voxels == voxel_map.known_voxels
