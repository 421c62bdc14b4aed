"""The cameras on a simulated robot: a raw stereo pair with noise, when asked.

A depth camera at the place of the left camera of a simulated robot.

Noise along the ray follows Nguyen, Izadi and Lovell (2012, doi:10.1109/3DIMPVT.2012.84):
``sigma_base + sigma_quadratic (z - sigma_depth)^2``; part of it is the same for neighboring
pixels. Across the ray, each pixel reads the depth of a place beside it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import CameraCalibration, PinholeCamera, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_body import RobotBody
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import (
    ImageSensor,
    StereoCamera,
    StereoCameraConfig,
)

_GAIN_MISMATCH = 1.02
_EXPOSURES = 24  # images that the exposure control has seen since the last pair


class StereoPair(NamedTuple):
    """A raw stereo pair.

    Attributes:
        stamp: [ns].
        left: gray values, shape (H, W), uint8.
        right: likewise.
    """

    stamp: int
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]


class Eyes:
    """The stereo camera of a robot.

    Args:
        body: the robot.
        camera: parameters of the lenses.
        rng: source of the images' noise.

    Raises:
        RobotModelError: a camera frame is unknown.
    """

    def __init__(
        self,
        body: RobotBody,
        camera: StereoCameraConfig,
        rng: np.random.Generator,
    ) -> None:
        self._body = body
        left, right = self.poses()
        self.camera = StereoCamera(camera, float(np.linalg.norm(right[:3, 3] - left[:3, 3])))
        self._sensor = ImageSensor(rng)
        self._renderer: Renderer | None = None
        self._lights: tuple[FloatArray, FloatArray] | None = None
        self._seen_at: FloatArray = np.zeros(0)

    def poses(self) -> tuple[FloatArray, FloatArray]:
        """``T_world_camera`` of the left and right optical frame, shape (4, 4)."""
        setup = self._body.setup
        left = self._body.frame(setup.left_camera_frame)
        if setup.right_camera_frame:
            return left, self._body.frame(setup.right_camera_frame)
        return left, left @ make_transform(np.eye(3), (setup.baseline, 0.0, 0.0))

    def look(self, stamp: int) -> StereoPair:
        """Take a pair; the first one opens a renderer, which belongs to the calling thread.

        What the cameras see is drawn anew only when a robot has moved; the noise is always new.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        left, right = self._light()
        self._sensor.adjust(left, _EXPOSURES)
        return StereoPair(
            stamp, self._sensor.expose(left), self._sensor.expose(right, _GAIN_MISMATCH)
        )

    def _light(self) -> tuple[FloatArray, FloatArray]:
        if self._renderer is None:
            self._renderer = self.camera.renderer(self._body.model)
        now = self._body.appearance()
        if self._lights is None or not np.array_equal(now, self._seen_at):
            self._lights = self.camera.capture(self._renderer, self._body.data, *self.poses())
            self._seen_at = now
        return self._lights

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


_PATCH = 2.5  # [px] standard deviation of what neighboring pixels share
_SHARED = 0.3  # share of the variance that neighboring pixels have in common
_NEAREST, _FARTHEST = 0.3, 6.0  # depths that are measured [m]
# Noise at _SIGMA_DEPTH [m], where it is smallest [m], and its growth with the square of the depth
# beyond [1/m].
_SIGMA_BASE, _SIGMA_DEPTH, _SIGMA_QUADRATIC = 0.0012, 0.4, 0.0019
_PIXEL_SIGMA = 0.5  # of the ray across the image [px]
_QUANTIZATION = 0.001  # step of the depth values [m]


class DepthImage(NamedTuple):
    """A depth image.

    Attributes:
        stamp: [ns].
        depth: z in the left optical frame, shape (H, W), float32 [m]; NaN = no measurement.
    """

    stamp: int
    depth: NDArray[np.float32]


class DepthEye:
    """Takes depth images with noise.

    Args:
        body: the robot.
        camera: undistorted camera of the depth image.
        rng: source of the noise.
    """

    def __init__(
        self,
        body: RobotBody,
        camera: PinholeCamera,
        rng: np.random.Generator,
    ) -> None:
        self.camera = camera
        self._body, self._rng = body, rng
        self._renderer: Renderer | None = None

    @property
    def calibration(self) -> CameraCalibration:
        """What the camera info of the depth image says."""
        k, camera = self.camera.matrix, self.camera
        projection = np.column_stack([k, np.zeros(3)])
        return CameraCalibration(
            camera.width, camera.height, "plumb_bob", np.zeros(5), k, np.eye(3), projection
        )

    def look(self, stamp: int) -> DepthImage:
        """Take an image; the first one opens a renderer, which belongs to the calling thread.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        if self._renderer is None:
            camera = self.camera
            self._renderer = Renderer(self._body.model, camera.width, camera.height)
        place = self._body.frame(self._body.setup.left_camera_frame)
        truth = self._renderer.depth(self._body.data, place, self.camera)
        return DepthImage(stamp, self.measure(truth))

    def measure(self, truth: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the camera makes of true depths, shape (H, W) [m]; NaN = nothing there."""
        z = self._beside(truth)
        spread = _SIGMA_BASE + _SIGMA_QUADRATIC * (z - _SIGMA_DEPTH) ** 2
        z = z + spread * self._noise(z.shape)
        z = np.rint(z / _QUANTIZATION) * _QUANTIZATION
        in_range = (z >= _NEAREST) & (z <= _FARTHEST)
        return np.where(in_range, z, np.nan).astype(np.float32)

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _beside(self, depth: NDArray[np.float32]) -> FloatArray:
        """Each pixel from a place beside it."""
        rows, columns = np.indices(depth.shape)
        shifts = self._rng.normal(0.0, _PIXEL_SIGMA, (2, *depth.shape))
        v = (rows + shifts[0]).astype(np.float32)
        u = (columns + shifts[1]).astype(np.float32)
        moved = cv2.remap(depth, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, dtype=np.float64)

    def _noise(self, shape: tuple[int, ...]) -> FloatArray:
        """Unit noise, a share of it smooth over a few pixels."""
        white, rough = self._rng.standard_normal((2, *shape))
        smooth = cv2.GaussianBlur(rough, (0, 0), _PATCH)
        smooth *= 2.0 * np.sqrt(np.pi) * _PATCH  # back to unit variance
        share = _SHARED
        return np.asarray(np.sqrt(1.0 - share) * white + np.sqrt(share) * smooth)
