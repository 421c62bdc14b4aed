"""Views of a textured room, ray cast, with exact truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.localization.fiducials.range_view import DepthView
from infomap_ros.localization.target.tag_board import TagBoardConfig, draw_board
from infomap_ros.stereo import DepthCameraSensor

CAMERA = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5)
STEP = 100_000_000
HALF = np.array([2.0, 2.0, 1.5])  # the room goes from -HALF to HALF [m]
_TEXELS = 160.0  # per meter
_SENSOR = DepthCameraSensor(CAMERA)
_V, _U = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
_RAYS = np.stack(
    [(_U - CAMERA.cx) / CAMERA.fx, (_V - CAMERA.cy) / CAMERA.fy, np.ones(_U.shape)], axis=-1
)


def _texture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    total = np.zeros((640, 640))
    for size in (2.0, 5.0, 14.0):
        part = cv2.GaussianBlur(rng.standard_normal(total.shape), (0, 0), size)
        total += part / part.std()
    return np.clip(120.0 + 28.0 * total, 0, 255).astype(np.float32)


_TEXTURES = [_texture(seed) for seed in range(6)]


def with_tags(
    side: float, places: Mapping[int, tuple[int, float, float]], first: int = 0
) -> list[np.ndarray]:
    """The room's walls with tags 36h11 on them.

    Args:
        side: of the black squares [m].
        places: number of the wall, and where on it the middle is along its two axes [m], by id.
        first: pattern of the first wall.
    """
    walls = [_TEXTURES[(first + i) % len(_TEXTURES)].copy() for i in range(6)]
    for one, (number, *place) in places.items():
        board = TagBoardConfig(side=side, columns=1, rows=1, margin=side / 8.0, first_id=one)
        drawn = draw_board(board, _TEXELS)
        # Walls are drawn along the map's axes: some are seen from behind.
        drawn = drawn[:, ::-1] if number in (0, 3) else drawn
        across = [k for k in range(3) if k != number // 2]
        u, v = (int((p + HALF[k]) * _TEXELS) for p, k in zip(place, across, strict=True))
        rows, columns = drawn.shape
        walls[number][v - rows // 2 :, u - columns // 2 :][:rows, :columns] = drawn
    return walls


def looking(position: tuple[float, float, float], yaw: float, pitch: float = 0.0) -> np.ndarray:
    """T_map_camera of a camera that looks along a heading; map z is up, shape (4, 4)."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return make_transform(Rotation.from_euler("zy", [yaw, pitch]).as_matrix() @ level, position)


def view(
    stamp: int, T_map_camera: np.ndarray, seed: int = 0, walls: Sequence[np.ndarray] = _TEXTURES
) -> DepthView:
    """What a depth camera sees: brightness noise of 1.5 gray levels, depth noise of its model."""
    rng = np.random.default_rng(seed)
    directions = _RAYS @ T_map_camera[:3, :3].T
    origin = T_map_camera[:3, 3]
    with np.errstate(divide="ignore"):
        reach = np.where(directions > 0.0, HALF - origin, -HALF - origin) / directions
    axis = reach.argmin(axis=-1)
    depth = reach.min(axis=-1)
    places = origin + depth[..., None] * directions
    image = np.zeros(depth.shape, np.float32)
    for number in range(6):
        on = (axis == number // 2) & ((np.take_along_axis(
            directions, axis[..., None], axis=-1)[..., 0] > 0.0) == bool(number % 2))  # fmt: skip
        across = [k for k in range(3) if k != number // 2]
        u, v = ((places[..., k] + HALF[k]) * _TEXELS for k in across)
        drawn = cv2.remap(
            walls[number], u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )  # fmt: skip
        image[on] = drawn[on]
    gray = np.clip(image + rng.normal(0.0, 1.5, image.shape), 0, 255).astype(np.uint8)
    noisy = depth + (0.0015 + 0.0015 * depth**2) * cv2.GaussianBlur(
        rng.standard_normal(depth.shape), (0, 0), 1.0
    )
    return DepthView(stamp, gray, _SENSOR.measure(noisy.astype(np.float32)))


def dark(stamp: int) -> DepthView:
    """What a covered camera sees."""
    nothing = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    return DepthView(stamp, np.zeros(nothing.shape, np.uint8), _SENSOR.measure(nothing))
