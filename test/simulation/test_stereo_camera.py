from __future__ import annotations

import cv2
import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import make_transform
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import StereoCamera, StereoCameraConfig, undistort
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.stereo import StereoRectifier

POSE = make_transform(
    np.column_stack(
        [(0.0, -1.0, 0.0), (-0.2873479, 0.0, -0.9578263), (0.9578263, 0.0, -0.2873479)]
    ),
    (0.4, 0.1, 0.9),
)


def test_undistort_inverts_opencvs_lens_model() -> None:
    calibration = StereoCamera(StereoCameraConfig(), 0.1).left
    u, v = np.meshgrid(np.linspace(0, 511, 20), np.linspace(0, 383, 15))
    pixels = np.stack([u, v], axis=-1)
    rays = undistort(pixels, calibration)
    points = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    projected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), calibration.intrinsics, calibration.distortion
    )
    np.testing.assert_allclose(projected.reshape(pixels.shape), pixels, atol=1e-6)


def test_rectified_image_equals_a_direct_view(world: World) -> None:
    camera = StereoCamera(StereoCameraConfig(width=256, height=192), 0.1)
    data = world.new_data()
    right_pose = POSE @ make_transform(np.eye(3), (0.1, 0.0, 0.0))
    with camera.renderer(world.model) as renderer:
        raw = camera.capture(renderer, data, POSE, right_pose)
    images = [np.rint(255.0 * light).astype(np.uint8) for light in raw]
    rectified = StereoRectifier(camera.left, camera.right).rectify(images[0], images[1])
    fine = camera.rig.left.scaled(2.0)
    with Renderer(world.model, fine.width, fine.height) as renderer:
        for image, unchanged, pose in zip(rectified, images, (POSE, right_pose), strict=True):
            color = renderer.color(data, pose, fine).astype(np.float32)
            truth = cv2.resize(color @ np.float32((0.299, 0.587, 0.114)), None, fx=0.5, fy=0.5,
                               interpolation=cv2.INTER_AREA)  # fmt: skip
            window = cv2.createHanningWindow((256, 192), cv2.CV_32F)
            shift, _ = cv2.phaseCorrelate(truth.copy(), image.astype(np.float32), window)
            assert np.abs(shift).max() < 0.03
            # The median, as silhouettes before the bright sky differ by how they are smoothed.
            error, before = np.abs(truth - image), np.abs(truth - unchanged)
            assert np.median(error) < 0.25 * np.median(before)


def test_calibration_differs_between_the_sides_and_is_seeded() -> None:
    camera, again = (StereoCamera(StereoCameraConfig(), 0.12) for _ in range(2))
    assert camera.left == again.left
    assert not np.allclose(camera.left.intrinsics, camera.right.intrinsics)
    assert not np.allclose(camera.left.rectification, np.eye(3), atol=1e-4)
    assert camera.rig.baseline == pytest.approx(0.12)


def test_impossible_parameters_are_refused() -> None:
    with pytest.raises(ConfigError, match="field_of_view"):
        StereoCameraConfig(field_of_view=3.0)
