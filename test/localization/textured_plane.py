"""A textured plane seen by a stereo camera, drawn by intersecting rays: the truth is exact."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, StereoRig, invert_transform, make_transform
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.stereo import StereoConfig, StereoRangeSensor

CAMERA = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5)
RIG = StereoRig(CAMERA, CAMERA, 0.1)
SENSOR = StereoRangeSensor(RIG, StereoConfig(min_depth=0.8))
TILT = make_transform(Rotation.from_euler("xy", [0.35, -0.25]).as_matrix(), [0.0, 0.0, 2.0])
_DENSITY = 300.0  # texels per meter
_SIZE = 2400


def camera_at(position: list[float], turn: list[float] | None = None) -> np.ndarray:
    """T_map_camera for a position [m] and a rotation vector [rad]."""
    return make_transform(Rotation.from_rotvec(turn or [0.0, 0.0, 0.0]).as_matrix(), position)


class TexturedPlane:
    """Draws the plane z = 0 of the frame TILT (T_map_plane)."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        image = np.zeros((_SIZE, _SIZE), np.float32)
        for blur in (2.0, 5.0, 14.0):
            noise = self.rng.standard_normal((_SIZE, _SIZE)).astype(np.float32)
            smooth = cv2.GaussianBlur(noise, (0, 0), blur)
            image += smooth / smooth.std()
        self._texture = 120.0 + 28.0 * image

    def inverse_depths(self, T_map_camera: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """True 1/z, shape (N,): a plane's is linear in the pixel."""
        T = invert_transform(TILT) @ T_map_camera
        normal, offset = T[2, :3], T[2, 3]
        across = (pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
        return -(across @ normal[:2] + normal[2]) / offset

    def moved(self, before: np.ndarray, after: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Where pixels seen from one pose are seen from another, shape (N, 2)."""
        depth = 1.0 / self.inverse_depths(before, pixels)
        across = (pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
        points = np.column_stack([across * depth[:, None], depth])
        T = invert_transform(after) @ before
        return CAMERA.project(points @ T[:3, :3].T + T[:3, 3])

    def light(self, T_map_camera: np.ndarray) -> np.ndarray:
        """Noise-free image, shape (240, 320)."""
        u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
        depth = 1.0 / self.inverse_depths(T_map_camera, pixels)
        across = (pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
        points = np.column_stack([across * depth[:, None], depth])
        T = invert_transform(TILT) @ T_map_camera
        place = (points @ T[:2, :3].T + T[:2, 3]) * _DENSITY + 0.5 * _SIZE
        x, y = (place[:, i].reshape(u.shape).astype(np.float32) for i in (0, 1))
        return cv2.remap(self._texture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)

    def expose(self, light: np.ndarray, noise: float = 1.5) -> np.ndarray:
        """A noisy 8-bit image."""
        noisy = light + self.rng.normal(0.0, noise, light.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def view(
        self,
        T_map_camera: np.ndarray,
        stamp: int = 0,
        gain: float = 1.0,
        offset: float = 0.0,
        blur: float = 0.0,
    ) -> StereoView:
        """A stereo view, with the exposure and blur that are wanted."""
        T_map_right = T_map_camera @ camera_at([RIG.baseline, 0.0, 0.0])
        images = []
        for pose in (T_map_camera, T_map_right):
            light = gain * self.light(pose) + offset
            if blur > 0.0:
                light = cv2.GaussianBlur(light, (0, 0), blur)
            images.append(self.expose(light))
        return StereoView(stamp, images[0], images[1], SENSOR)
