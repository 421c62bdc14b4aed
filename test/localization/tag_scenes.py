"""Views of boards of tags, drawn through a homography with blur and noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig, draw_board
from infomap_ros.stereo import RangeCloud

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 321.3, 238.4)
_FINER = 3  # drawn pixels per pixel along each axis


class BoardView:
    """A view of one board, `RangeView`; range is exact plus noise, or none where sigma is None."""

    def __init__(
        self,
        board: TagBoard,
        T_camera_target: FloatArray,
        rng: np.random.Generator,
        range_sigma: float | None = None,
        camera: PinholeCamera = CAMERA,
    ) -> None:
        self.stamp, self.camera, self.has_cloud, self.tags = 0, camera, False, None
        self.image = draw_view(board, T_camera_target, rng, camera)
        self._plane = T_camera_target @ board.T_target_board
        self._rng, self._sigma = rng, range_sigma

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        pixels = np.asarray(pixels, dtype=np.float64)
        if self._sigma is None:
            return np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.camera.matrix).T
        normal = self._plane[:3, 2]
        rho = rays @ normal / (normal @ self._plane[:3, 3])
        return rho + self._rng.normal(0.0, self._sigma, len(rho)), np.full(len(rho), self._sigma)

    def cloud(self) -> RangeCloud:
        raise AssertionError("tags need no dense cloud")


def draw_view(
    board: TagBoard,
    T_camera_target: FloatArray,
    rng: np.random.Generator,
    camera: PinholeCamera = CAMERA,
    blur: float = 0.6,
    noise: float = 2.0,
) -> NDArray[np.uint8]:
    """What a camera sees: each pixel the mean of finer ones, blurred [px], with noise [gray]."""
    depth = float(T_camera_target[2, 3])
    scale = min(4.0 * _FINER * camera.fx / depth, 6000.0)
    print_ = draw_board(board.config, scale).astype(np.float32) / 255.0 * 195.0 + 25.0
    height, width = print_.shape
    plane_from_print = np.array(
        [
            [1.0 / scale, 0.0, (0.5 - 0.5 * width) / scale],
            [0.0, -1.0 / scale, (0.5 * height - 0.5) / scale],
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    middle = 0.5 * (_FINER - 1.0)
    finer = np.array([[_FINER, 0.0, middle], [0.0, _FINER, middle], [0.0, 0.0, 1.0]])
    plane = (T_camera_target @ board.T_target_board)[:3]
    homography = finer @ camera.matrix @ plane @ plane_from_print
    size = (camera.width * _FINER, camera.height * _FINER)
    image = cv2.warpPerspective(print_, homography, size, flags=cv2.INTER_LINEAR, borderValue=110.0)
    image = cv2.GaussianBlur(image, (0, 0), blur * _FINER)
    image = image.reshape(camera.height, _FINER, camera.width, _FINER).mean(axis=(1, 3))
    image = image + rng.normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0.0, 255.0).astype(np.uint8)


def seen_from(
    board: TagBoard, distance: float, tilt: float, rng: np.random.Generator
) -> FloatArray:
    """``T_camera_target`` with the board near the image's middle, tilted about a random axis."""
    angle, roll = rng.uniform(0.0, 2.0 * np.pi, 2)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    facing = Rotation.from_euler("z", roll).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    turn = facing @ Rotation.from_rotvec(tilt * axis).as_matrix()
    place = np.append(rng.uniform(-0.12, 0.12, 2) * distance, distance)
    return make_transform(turn, place) @ invert_transform(board.T_target_board)


def single_tag(side: float = 0.16) -> TagBoard:
    """A board of one tag."""
    return TagBoard(TagBoardConfig(columns=1, rows=1, side=side))


def pose_error(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """The error of the convention that takes the estimate to the truth, shape (6,)."""
    turn = Rotation.from_matrix(truth[:3, :3] @ estimate[:3, :3].T).as_rotvec()
    return np.concatenate([truth[:3, 3] - estimate[:3, 3], turn])
