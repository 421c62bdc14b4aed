"""Drawing a world through any pinhole camera: color, depth, and what each pixel belongs to."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import SimulationError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation import ADVICE

import mujoco  # isort: skip  # after the backend has been chosen

_LOGGER = logging.getLogger(__name__)


def _log(warning: str) -> None:
    """Log what MuJoCo would write into a file of the current folder."""
    level = logging.DEBUG if "ignored" in warning else logging.WARNING
    _LOGGER.log(level, "MuJoCo: %s", warning)


mujoco.set_mju_user_warning(_log)

COLLISION_GROUP = 3
"""Geoms of this group collide but are not drawn."""

_SKY = -1


@dataclass(frozen=True, eq=False)
class View:
    """What a camera would see without lens and noise.

    Attributes:
        color: shape (H, W, 3), uint8 RGB.
        depth: z of the surface in the camera frame, shape (H, W), float32 [m]; NaN = sky.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]


class Renderer:
    """Draws one compiled model offscreen, for cameras of one image size.

    Holds an OpenGL context: use it in one thread and close it, best in a ``with`` statement.

    Args:
        model: the compiled MuJoCo model; its offscreen buffer must hold the image.
        width: image width [px].
        height: image height [px].

    Raises:
        SimulationError: this machine has no way to draw; the message names the Debian packages.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self._model = model
        # MuJoCo's GL loaders raise whatever the missing library happens to cause.
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise SimulationError(f"{ADVICE} ({error})") from error
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def color(
        self, data: mujoco.MjData, T_world_camera: FloatArray, camera: PinholeCamera
    ) -> NDArray[np.uint8]:
        """Color image, shape (H, W, 3), uint8 RGB, seen from an optical frame."""
        self._aim(data, T_world_camera, camera)
        image: NDArray[np.uint8] = self._renderer.render()
        return image

    def depth(
        self, data: mujoco.MjData, T_world_camera: FloatArray, camera: PinholeCamera
    ) -> NDArray[np.float32]:
        """Depth z along the optical axis, shape (H, W), float32 [m]; NaN = sky."""
        self._aim(data, T_world_camera, camera)
        self._renderer.enable_depth_rendering()
        depth: NDArray[np.float32] = self._renderer.render()
        self._renderer.disable_depth_rendering()
        far = self._model.vis.map.zfar * self._model.stat.extent
        return np.where(depth < 0.99 * far, depth, np.float32(np.nan))

    def view(self, data: mujoco.MjData, T_world_camera: FloatArray, camera: PinholeCamera) -> View:
        """Color and depth from the same place."""
        return View(
            self.color(data, T_world_camera, camera), self.depth(data, T_world_camera, camera)
        )

    def geom_ids(
        self, data: mujoco.MjData, T_world_camera: FloatArray, camera: PinholeCamera
    ) -> NDArray[np.int32]:
        """Index of the geom that each pixel shows, shape (H, W); -1 = sky."""
        self._aim(data, T_world_camera, camera)
        self._renderer.enable_segmentation_rendering()
        labels = self._renderer.render()
        self._renderer.disable_segmentation_rendering()
        is_geom = labels[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
        return np.where(is_geom, labels[..., 0], _SKY).astype(np.int32)

    def _aim(self, data: mujoco.MjData, T_world_camera: FloatArray, camera: PinholeCamera) -> None:
        if (camera.width, camera.height) != (self._renderer.width, self._renderer.height):
            raise SimulationError(
                f"renderer of {self._renderer.width}x{self._renderer.height} px was asked for "
                f"an image of {camera.width}x{camera.height} px"
            )
        self._renderer.update_scene(data, scene_option=self._options)
        for eye in self._renderer.scene.camera:
            self._place(eye, T_world_camera, camera)

    def _place(self, eye: Any, T_world_camera: FloatArray, camera: PinholeCamera) -> None:
        near = self._model.vis.map.znear * self._model.stat.extent
        left, right = -(camera.cx + 0.5) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
        eye.pos = T_world_camera[:3, 3]
        eye.forward = T_world_camera[:3, 2]
        eye.up = -T_world_camera[:3, 1]
        eye.frustum_near = near
        eye.frustum_center = 0.5 * (left + right) * near
        eye.frustum_width = 0.5 * (right - left) * near
        eye.frustum_top = (camera.cy + 0.5) / camera.fy * near
        eye.frustum_bottom = -(camera.height - 0.5 - camera.cy) / camera.fy * near
