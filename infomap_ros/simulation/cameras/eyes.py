"""The cameras on a simulated robot: a raw stereo pair with noise, when asked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_body import RobotBody
from infomap_ros.simulation.cameras.image_sensor import ImageSensor, ImageSensorConfig
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import StereoCamera, StereoCameraConfig

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
        sensor: parameters of the image sensors.
        rng: source of the images' noise.

    Raises:
        RobotModelError: a camera frame is unknown.
    """

    def __init__(
        self,
        body: RobotBody,
        camera: StereoCameraConfig,
        sensor: ImageSensorConfig,
        rng: np.random.Generator,
    ) -> None:
        self._body = body
        left, right = self.poses()
        self.camera = StereoCamera(camera, float(np.linalg.norm(right[:3, 3] - left[:3, 3])))
        self._sensor = ImageSensor(sensor, rng)
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
