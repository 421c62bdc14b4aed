"""A stereo camera as it leaves the workshop: lens distortion, and not quite aligned.

The frames ``*_optical_frame`` of the robot description are those of the rectified images. Each raw
camera is turned against its frame by a small rotation, which its camera info tells
(``p_rectified = R @ p_raw``).

From light to gray values: exposure, vignetting, shot noise, read noise, quantization.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    CameraCalibration,
    PinholeCamera,
    StereoRig,
    make_transform,
    rig_from_calibrations,
)
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.cameras.rendering import Renderer

import mujoco  # isort: skip  # after the backend has been chosen


_LUMINANCE = np.array((0.299, 0.587, 0.114), dtype=np.float32)
# plumb_bob coefficients k1 k2 p1 p2 k3 of the left lens; the right one differs slightly.
_DISTORTION = (-0.17, 0.045, 0.0006, -0.0004, -0.005)
_MISALIGNMENT = 0.006  # standard deviation of each raw camera's rotation [rad]
_FULL_WELL = 9000.0  # electrons at gray value 255; fewer means more shot noise
_READ_NOISE = 14.0  # standard deviation, in electrons
_VIGNETTING = 0.25  # share of light that is lost in the corners
_TARGET_LEVEL = 115.0  # median gray value that the exposure control aims at
_EXPOSURE_STEP = 0.125  # of the exposure control, as power of two


@dataclass(frozen=True)
class StereoCameraConfig:
    """Parameters of the stereo camera."""

    width: int = parameter(512, "Image width", unit="px", low=16, high=4096)
    height: int = parameter(384, "Image height", unit="px", low=16, high=4096)
    field_of_view: float = parameter(
        1.30, "Horizontal opening of the rectified image", unit="rad", low=0.1, high=2.2
    )
    supersampling: int = setting(
        2, "Samples per pixel and direction; more means cleaner edges", low=1, high=4
    )
    multisampling: int = setting(
        4, "Samples of the renderer at edges; 0 draws faster, with jagged edges", low=0, high=16
    )
    shadow_map: int = setting(
        4096, "Edge length of the image of shadows; smaller is faster", unit="px", low=64, high=8192
    )
    seed: int = setting(3, "Seed of what differs from camera to camera", low=0)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


DRAWN_FAST = {"supersampling": 1, "multisampling": 0, "shadow_map": 1024}
"""Fields of `StereoCameraConfig` for a machine that draws without graphics hardware."""


class StereoCamera:
    """Takes pairs of raw images in a world, noise excluded.

    Args:
        config: the parameters.
        baseline: distance of the optical centers [m].
    """

    def __init__(self, config: StereoCameraConfig, baseline: float) -> None:
        self.config = config
        rng = np.random.default_rng(config.seed)
        rectified = _rectified_camera(config)
        self.left = _calibration(config, rectified, 0.0, rng)
        self.right = _calibration(config, rectified, -rectified.fx * baseline, rng)
        self.rig: StereoRig = rig_from_calibrations(self.left, self.right)
        self._left_rays = self._subpixel_rays(self.left)
        self._right_rays = self._subpixel_rays(self.right)
        self.render_camera = self._wide_camera(rectified)

    def renderer(self, model: mujoco.MjModel) -> Renderer:
        """A renderer of the size that `capture` needs."""
        model.vis.quality.offsamples = self.config.multisampling
        model.vis.quality.shadowsize = self.config.shadow_map
        return Renderer(model, self.render_camera.width, self.render_camera.height)

    def capture(
        self,
        renderer: Renderer,
        data: mujoco.MjData,
        T_world_left: FloatArray,
        T_world_right: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Take a raw pair.

        Args:
            renderer: made by `renderer`.
            data: state of the world.
            T_world_left: pose of the left optical (rectified) frame, shape (4, 4).
            T_world_right: pose of the right one.

        Returns:
            Light on the pixels of left and right, shape (H, W) each; 1 = white in full light.
        """
        left = self._image(renderer, data, T_world_left, self.left, self._left_rays)
        right = self._image(renderer, data, T_world_right, self.right, self._right_rays)
        return left, right

    def _image(
        self,
        renderer: Renderer,
        data: mujoco.MjData,
        T_world_rectified: FloatArray,
        calibration: CameraCalibration,
        rays: FloatArray,
    ) -> FloatArray:
        T_world_raw = T_world_rectified @ make_transform(calibration.rectification, np.zeros(3))
        gray = renderer.color(data, T_world_raw, self.render_camera) @ _LUMINANCE / 255.0
        wide = self.render_camera
        u = (wide.fx * rays[..., 0] + wide.cx).astype(np.float32)
        v = (wide.fy * rays[..., 1] + wide.cy).astype(np.float32)
        fine = cv2.remap(gray, u, v, cv2.INTER_LINEAR)
        size = (self.config.width, self.config.height)
        return np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), dtype=np.float64)

    def _subpixel_rays(self, calibration: CameraCalibration) -> FloatArray:
        """Rays (x, y, 1) of the samples within each pixel, shape (n H, n W, 2)."""
        n = self.config.supersampling
        u = (np.arange(n * calibration.width) + 0.5) / n - 0.5
        v = (np.arange(n * calibration.height) + 0.5) / n - 0.5
        return undistort(np.stack(np.meshgrid(u, v), axis=-1), calibration)

    def _wide_camera(self, rectified: PinholeCamera) -> PinholeCamera:
        """The pinhole camera that sees all that both raw cameras see."""
        rays = np.concatenate([self._left_rays.reshape(-1, 2), self._right_rays.reshape(-1, 2)])
        focal = rectified.fx * self.config.supersampling
        low, high = focal * rays.min(axis=0) - 2.0, focal * rays.max(axis=0) + 2.0
        width, height = np.ceil(high - low).astype(int) + 1
        cx, cy = -float(low[0]), -float(low[1])
        return PinholeCamera(int(width), int(height), focal, focal, cx, cy)


def undistort(pixels: FloatArray, calibration: CameraCalibration) -> FloatArray:
    """Rays of raw pixels through a plumb_bob lens (Brown 1966), by fixed-point iteration.

    Args:
        pixels: (u, v) of the raw image, shape (..., 2) [px].
        calibration: of the raw camera.

    Returns:
        (x, y) at z = 1 in the raw camera frame, shape (..., 2).
    """
    k = calibration.intrinsics
    k1, k2, p1, p2, k3 = calibration.distortion
    distorted_x = (pixels[..., 0] - k[0, 2]) / k[0, 0]
    distorted_y = (pixels[..., 1] - k[1, 2]) / k[1, 1]
    x, y = distorted_x.copy(), distorted_y.copy()
    for _ in range(40):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift_x = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        shift_y = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        x, y = (distorted_x - shift_x) / radial, (distorted_y - shift_y) / radial
    return np.stack([x, y], axis=-1)


def _rectified_camera(config: StereoCameraConfig) -> PinholeCamera:
    focal = float(0.5 * config.width / np.tan(0.5 * config.field_of_view))
    middle = (0.5 * (config.width - 1), 0.5 * (config.height - 1))
    return PinholeCamera(config.width, config.height, focal, focal, *middle)


def _calibration(
    config: StereoCameraConfig, rectified: PinholeCamera, shift: float, rng: np.random.Generator
) -> CameraCalibration:
    """A camera with its own small deviations; `shift` is P[0, 3] [px m]."""
    intrinsics = rectified.matrix
    intrinsics[[0, 1], [0, 1]] *= 1.0 + rng.normal(0.0, 0.004) + rng.normal(0.0, 0.0005, 2)
    intrinsics[:2, 2] += rng.normal(0.0, 0.006 * config.width, 2)
    projection: NDArray[np.float64] = np.zeros((3, 4))
    projection[:, :3], projection[0, 3] = rectified.matrix, shift
    return CameraCalibration(
        config.width,
        config.height,
        "plumb_bob",
        np.asarray(_DISTORTION) * (1.0 + rng.normal(0.0, 0.03, 5)),
        intrinsics,
        Rotation.from_rotvec(rng.normal(0.0, _MISALIGNMENT, 3)).as_matrix(),
        projection,
    )


class ImageSensor:
    """One sensor with exposure control; both cameras of a pair use the same exposure.

    Args:
        rng: source of the noise.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._steps: int | None = None

    @property
    def exposure(self) -> float:
        """Present exposure; at 1 a white surface just saturates."""
        return float(2.0 ** ((self._steps or 0) * _EXPOSURE_STEP))

    def adjust(self, light: FloatArray, images: int = 1) -> None:
        """Move the exposure towards the target level, by one step per image.

        The first image sets it at once.

        Args:
            light: light on the pixels, 1 = white in full light, any shape.
            images: so many are taken of it.
        """
        median = max(float(np.median(light)), 1e-6)
        wanted = np.log2(_TARGET_LEVEL / (255.0 * median)) / _EXPOSURE_STEP
        if self._steps is None:
            self._steps = round(wanted)
        self._steps += int(np.clip(round(wanted - self._steps), -images, images))

    def expose(self, light: FloatArray, gain: float = 1.0) -> NDArray[np.uint8]:
        """Take one image.

        Args:
            light: light on the pixels, shape (H, W), 1 = white in full light.
            gain: sensitivity of this sensor relative to nominal.

        Returns:
            Gray values, shape (H, W), uint8.
        """
        electrons = _FULL_WELL * self.exposure * gain * light * self._falloff(light.shape)
        noisy = self._rng.normal(electrons, np.sqrt(electrons + _READ_NOISE**2))
        return np.clip(np.rint(255.0 * noisy / _FULL_WELL), 0, 255).astype(np.uint8)

    def _falloff(self, shape: tuple[int, ...]) -> FloatArray:
        """Light that each pixel keeps, falling with the square of the distance to the middle."""
        v, u = (np.linspace(-1.0, 1.0, n) ** 2 for n in shape)
        return np.asarray(1.0 - 0.5 * _VIGNETTING * (v[:, None] + u[None, :]))
