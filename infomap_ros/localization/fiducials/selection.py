"""Chooses scene fiducials: the best pixels by eqs. (19)-(20) of Sujan and Dubowsky (2005)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, transform_points
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.range_view import RangeView, check_pixels
from infomap_ros.mapping import VoxelMap

# How good a fiducial a pixel would make: the terms of eqs. (19) and (20).
#
# Sujan and Dubowsky (2005), DOI 10.1177/0278364905051774: ``F.E.F. = f(P) + g(C) + h(H)``,
# certainty in the map, visual contrast and depth contrast, less a penalty for being near another
# fiducial. Each term is a function of its own here; `selection` adds them up.

_LEAST_FALL = 0.01  # of the certainty from shell to shell
_LEAST_GRAY = 1.0  # keeps the contrast of black windows finite [gray levels]


def certainty(voxel_map: VoxelMap, points: FloatArray, largest_radius: int) -> FloatArray:
    """Certainty in the map, ``f = P / r``.

    P is the certainty that the voxel at the point is occupied, ``2 p - 1`` of its probability p, so
    that an unknown or free one has none; r is the number of shells about it over which the mean
    certainty ``|2 p - 1|`` keeps falling, at least 1: well known surroundings make it small.

    Args:
        voxel_map: the map.
        points: map frame, shape (N, 3) [m]; NaN gives 0.
        largest_radius: shells that are looked at, one voxel thick each.

    Returns:
        Values in [0, 1], shape (N,).
    """
    known = np.isfinite(points).all(axis=1)
    values = np.zeros(len(points))
    if not known.any():
        return values
    reach = np.arange(-largest_radius, largest_radius + 1)
    offsets = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = np.abs(offsets).max(axis=1)
    places = points[known][:, None] + offsets * voxel_map.config.voxel_size
    sure = 2.0 * voxel_map.probability(places.reshape(-1, 3)).reshape(-1, len(offsets)) - 1.0
    means = np.stack(
        [np.abs(sure[:, shell == radius]).mean(axis=1) for radius in range(largest_radius + 1)]
    )
    falling = np.cumprod(np.diff(means, axis=0) < -_LEAST_FALL, axis=0).sum(axis=0)
    values[known] = np.maximum(sure[:, shell == 0][:, 0], 0.0) / np.maximum(falling, 1)
    return values


def range_certainty(inverse_depths: FloatArray, sigmas: FloatArray, half: float) -> FloatArray:
    """Certainty of a point that is in no map yet, from the range itself.

    Args:
        inverse_depths: shape (N,) [1/m]; NaN gives 0.
        sigmas: their standard deviations, shape (N,) [1/m].
        half: relative standard deviation of the range at which the certainty is one half.

    Returns:
        Values in [0, 1], shape (N,).
    """
    usable = inverse_depths > 0.0
    relative = np.divide(sigmas, inverse_depths, out=np.full_like(sigmas, np.inf), where=usable)
    return np.asarray(1.0 / (1.0 + np.square(relative / half)))


def visual_contrast(image: NDArray[np.uint8], pixels: ArrayLike, largest_window: int) -> FloatArray:
    """Visual contrast ``g = C w``, with ``C = |I - I_w| / I_w`` (20).

    I is the intensity at the pixel (3 x 3 mean), I_w the mean of a window of side w, and w the
    largest window before the contrast falls as the window grows. The printed C has a sign; dark
    points are as good as bright ones, so the magnitude is meant.

    Args:
        image: gray, shape (H, W).
        pixels: shape (N, 2) [px].
        largest_window: windows of 5, 7, ... up to this side are tried [px].

    Returns:
        Values [px], shape (N,).
    """
    sums = cv2.integral(image)
    corners = np.rint(np.asarray(pixels, dtype=np.float64)).astype(np.int64).reshape(-1, 2)
    middle = _window_mean(sums, corners, 1)
    windows = np.arange(5, largest_window + 1, 2)
    around = np.stack([_window_mean(sums, corners, int(side) // 2) for side in windows])
    contrasts = np.abs(middle - around) / np.maximum(around, _LEAST_GRAY)
    best = np.cumprod(np.diff(contrasts, axis=0) >= 0.0, axis=0).sum(axis=0)
    rows = np.arange(len(corners))
    return np.asarray(contrasts[best, rows] * windows[best])


def _window_mean(sums: NDArray[np.int32], corners: NDArray[np.int64], reach: int) -> FloatArray:
    """Mean of the window about each pixel, cut at the image's border, shape (N,)."""
    limit = np.array([sums.shape[1] - 1, sums.shape[0] - 1])
    low = np.clip(corners - reach, 0, limit)
    high = np.clip(corners + reach + 1, 0, limit)
    total = sums[high[:, 1], high[:, 0]] - sums[low[:, 1], high[:, 0]]
    total = total - sums[high[:, 1], low[:, 0]] + sums[low[:, 1], low[:, 0]]
    return np.asarray(total / np.maximum(np.prod(high - low, axis=1), 1))


def depth_contrast(
    range_image: NDArray[np.float32],
    depth_sigmas: NDArray[np.float32],
    pixels: ArrayLike,
    windows: tuple[int, ...],
) -> FloatArray:
    """Depth contrast ``h = H w``: how finely the surface is shaped about a pixel.

    H is the root mean square spatial frequency [1/px] of the relief, that is the depth less a plane
    through the window, over the depth; by Parseval's theorem it follows from the relief's and its
    derivative's power without a transform. It counts by the share of the relief's power that range
    noise does not explain. w is the largest window before H rises as the window grows.

    Args:
        range_image: depth, shape (H, W) [m]; NaN = none.
        depth_sigmas: their standard deviations, shape (H, W) [m].
        pixels: shape (N, 2) [px].
        windows: sides that are tried, odd, growing [px].

    Returns:
        Values, shape (N,); 0 where less than half of the window was measured.

    Raises:
        InvalidInputError: a window is even or they do not grow.
    """
    if any(side % 2 == 0 for side in windows) or any(np.diff(windows) <= 0):
        raise InvalidInputError("windows", f"{windows}, expected growing odd numbers")
    places = np.rint(np.asarray(pixels, dtype=np.float64)).astype(np.int64).reshape(-1, 2)
    tried = [_relief_frequency(range_image, depth_sigmas, places, side // 2) for side in windows]
    frequency = np.stack([pair[0] for pair in tried])
    real = np.stack([pair[1] for pair in tried])
    best = np.cumprod(np.diff(frequency, axis=0) <= 0.0, axis=0).sum(axis=0)
    rows = np.arange(len(places))
    return np.asarray(frequency[best, rows] * real[best, rows] * np.asarray(windows)[best])


def _relief_frequency(
    depth: NDArray[np.float32], sigmas: NDArray[np.float32], places: NDArray[np.int64], reach: int
) -> tuple[FloatArray, FloatArray]:
    """Frequency of the relief [1/px] and the share of it that is not noise, shape (N,) each."""
    height, width = depth.shape
    offsets = np.arange(-reach, reach + 1)
    rows = np.clip(places[:, 1, None] + offsets, 0, height - 1)[:, :, None]
    columns = np.clip(places[:, 0, None] + offsets, 0, width - 1)[:, None, :]
    z = depth[rows, columns].astype(np.float64)
    noise = np.square(sigmas[rows, columns].astype(np.float64))
    measured = np.isfinite(z)
    count = np.maximum(measured.sum(axis=(1, 2)), 1)
    mean = np.where(measured, z, 0.0).sum(axis=(1, 2)) / count
    relief = np.where(measured, z - mean[:, None, None], 0.0)
    spread = float(np.mean(offsets**2))
    for axis in (1, 2):  # the plane through a window, whose axes are orthogonal
        along = offsets.reshape((1, -1, 1) if axis == 1 else (1, 1, -1))
        slope = (relief * along).sum(axis=(1, 2)) / (count * spread)
        relief = np.where(measured, relief - slope[:, None, None] * along, 0.0)
    power = np.square(relief).sum(axis=(1, 2)) / count
    steps = sum(np.square(np.diff(relief, axis=axis)).sum(axis=(1, 2)) for axis in (1, 2)) / count
    noise_power = np.where(measured, noise, 0.0).sum(axis=(1, 2)) / count
    frequency = np.sqrt(steps / np.maximum(power, 1e-12)) / (2.0 * np.pi)
    enough = count > 0.5 * measured[0].size
    return np.where(enough, frequency, 0.0), np.maximum(
        1.0 - noise_power / np.maximum(power, 1e-12), 0.0
    )


def spread_penalty(pixels: FloatArray, taken: FloatArray, distance: float) -> FloatArray:
    """Penalty for being near other fiducials: 1 on top of one, ``exp(-(r / distance)^2)`` at r.

    Args:
        pixels: shape (N, 2) [px].
        taken: pixels of the other fiducials, shape (M, 2) [px].
        distance: scale of the penalty [px].

    Returns:
        The largest penalty, in [0, 1], shape (N,).
    """
    if len(taken) == 0:
        return np.zeros(len(pixels))
    squared = np.square(pixels[:, None] - taken[None]).sum(axis=2).min(axis=1)
    return np.asarray(np.exp(-squared / distance**2))


# Of the mean gradient product, where OpenCV has the sum over 49 pixels of Sobel gradients (8 times
# the derivative), divided by 4 * 7 * 255.
_GRAY_LEVELS = np.float32((4.0 * 7.0 * 255.0 / 8.0) ** 2 / 49.0)
# Least corner strength: square root of the smaller eigenvalue of the mean gradient product in a
# 7 x 7 window (Shi and Tomasi 1994) [gray levels/px].
_MIN_CORNER = 4.0
_SPREAD_WEIGHT = 2.0  # of the penalty for being near another fiducial
_SPREAD_DISTANCE = 40.0  # scale of that penalty [px]
MIN_DISTANCE = 12.0
"""Fiducials are never nearer to each other [px]."""
BORDER = 16
"""Nothing is chosen this near to the image's border [px]."""
_LARGEST_WINDOW = 31  # of the visual contrast, odd [px]
_DEPTH_WINDOWS = (9, 13, 17)  # of the depth contrast, odd, growing [px]
_LARGEST_RADIUS = 3  # shells of voxels that the certainty looks at
_HALF_CERTAINTY = 0.05  # without a map: relative sigma of the range at which it is one half


@dataclass(frozen=True)
class FiducialSelectionConfig:
    """What makes a good fiducial.

    Raises:
        ConfigError: a value is out of its range.
    """

    certainty_weight: float = setting(1.0, "Weight of f(P), eq. (19).", low=0.0, high=100.0)
    contrast_weight: float = setting(1.0, "Weight of g(C), eqs. (19)-(20).", low=0.0, high=100.0)
    depth_weight: float = setting(
        0.2,
        "Weight of h(H), eq. (19). Small, because windows on depth edges show two surfaces.",
        low=0.0,
        high=100.0,
    )
    candidates: int = setting(250, "Most corners that are evaluated.", low=10, high=5000)
    dense_range: bool = setting(
        False,
        "Have the dense cloud worked out for the depth contrast where it is not at hand; "
        "otherwise that term is left out.",
    )

    def __post_init__(self) -> None:
        check_config(self)


class FiducialScores(NamedTuple):
    """Terms of eq. (19) for candidates, each in [0, 1), shape (N,).

    Attributes:
        certainty: of the range in the map.
        contrast: visual.
        depth: contrast of depth; zero where there is no dense cloud.
    """

    certainty: FloatArray
    contrast: FloatArray
    depth: FloatArray

    def total(self, config: FiducialSelectionConfig) -> FloatArray:
        """Weighted sum, eq. (19)."""
        return np.asarray(
            config.certainty_weight * self.certainty
            + config.contrast_weight * self.contrast
            + config.depth_weight * self.depth
        )


def select_fiducials(
    view: RangeView,
    taken: ArrayLike,
    count: int,
    voxel_map: VoxelMap | None = None,
    T_map_camera: ArrayLike | None = None,
    config: FiducialSelectionConfig | None = None,
) -> FloatArray:
    """Choose new fiducials.

    Args:
        view: what is seen.
        taken: pixels of the fiducials that are there already, shape (K, 2) [px].
        count: most that are chosen.
        voxel_map: for the certainty; without it that of the range itself counts.
        T_map_camera: pose of the camera in the map, shape (4, 4); needed with a map.
        config: defaults where None.

    Returns:
        Pixels, best first, shape (M, 2) [px] with M <= count.

    Raises:
        InvalidInputError: a map comes without a pose, or shapes do not fit.
    """
    config = config or FiducialSelectionConfig()
    if (voxel_map is None) != (T_map_camera is None):
        raise InvalidInputError("T_map_camera", "and voxel_map must come together")
    others = check_pixels(taken, "taken")
    pixels = corner_candidates(view.image, others, config)
    if count <= 0 or len(pixels) == 0:
        return np.zeros((0, 2))
    inverse, sigmas = view.inverse_depths(pixels)
    measured = inverse > 0.0
    pixels, inverse, sigmas = pixels[measured], inverse[measured], sigmas[measured]
    if voxel_map is None or T_map_camera is None:
        sure = range_certainty(inverse, sigmas, _HALF_CERTAINTY)
    else:
        pose = check_transform(T_map_camera, "T_map_camera")
        points = transform_points(pose, _points(view, pixels, inverse))
        sure = certainty(voxel_map, points, _LARGEST_RADIUS)
    scores = evaluate(view, pixels, sure, config)
    return pixels[_spread_out(pixels, scores.total(config), others, count)]


def evaluate(
    view: RangeView, pixels: FloatArray, sure: FloatArray, config: FiducialSelectionConfig
) -> FiducialScores:
    """Terms of eq. (19) for pixels.

    The contrasts are divided by themselves plus their median, so that the weights compare terms of
    one size whatever the scene.

    Args:
        view: what is seen.
        pixels: shape (N, 2) [px].
        sure: certainties, shape (N,), in [0, 1].
        config: weights.
    """
    contrast = visual_contrast(view.image, pixels, _LARGEST_WINDOW)
    depth = np.zeros(len(pixels))
    if config.depth_weight > 0.0 and (view.has_cloud or config.dense_range):
        cloud = view.cloud()
        sigmas = np.sqrt(cloud.covariance_triangles[..., 5])
        depth = depth_contrast(cloud.range_image, sigmas, pixels, _DEPTH_WINDOWS)
    return FiducialScores(sure, _saturated(contrast), _saturated(depth))


def corner_candidates(
    image: NDArray[np.uint8], taken: FloatArray, config: FiducialSelectionConfig
) -> FloatArray:
    """Corners that can be tracked in both directions, away from what is taken.

    The strongest ones of every part of the image, so that a part with weak texture is not left
    empty because another has strong texture.

    Returns:
        Pixels, shape (N, 2) [px].
    """
    height, width = image.shape
    response = cv2.cornerMinEigenVal(image, 7) * _GRAY_LEVELS
    peaks = response >= cv2.dilate(response, np.ones((5, 5), np.uint8))
    free = np.zeros(image.shape, np.uint8)
    free[BORDER : height - BORDER, BORDER : width - BORDER] = 1
    for u, v in np.rint(taken).astype(int).tolist():
        cv2.circle(free, (u, v), int(MIN_DISTANCE), 0, -1)
    peaks &= (response >= _MIN_CORNER**2) & (free > 0)
    rows, columns = np.nonzero(peaks)
    strength = response[rows, columns]
    cell = max(16, round(np.sqrt(height * width / config.candidates) * 3.0))
    cells = (rows // cell) * (width // cell + 1) + columns // cell
    chosen = _best_of_each(cells, strength, config.candidates)
    return np.column_stack([columns[chosen], rows[chosen]]).astype(np.float64)


def _best_of_each(
    cells: NDArray[np.int64], strength: NDArray[np.float32], count: int
) -> NDArray[np.int64]:
    """Rows by rank within their cell, then by strength; at most `count`."""
    order = np.lexsort((-strength, cells))
    ordered = cells[order]
    first = np.searchsorted(ordered, ordered)
    rank = np.arange(len(order)) - first
    return order[np.lexsort((-strength[order], rank))][:count]


def _points(view: RangeView, pixels: FloatArray, inverse: FloatArray) -> FloatArray:
    camera = view.camera
    depth = 1.0 / np.where(inverse > 0.0, inverse, np.nan)
    across = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.column_stack([across * depth[:, None], depth])


def _saturated(values: FloatArray) -> FloatArray:
    """Values over themselves plus the median of the positive ones, in [0, 1)."""
    positive = values[values > 0.0]
    return values / (values + np.median(positive)) if len(positive) else values


def _spread_out(
    pixels: FloatArray,
    scores: FloatArray,
    taken: FloatArray,
    count: int,
) -> NDArray[np.int64]:
    """Best first, each choice lowering the value of what is near it."""
    penalty = spread_penalty(pixels, taken, _SPREAD_DISTANCE)
    usable = np.isfinite(scores)
    chosen: list[int] = []
    while len(chosen) < count and usable.any():
        values = np.where(usable, scores - _SPREAD_WEIGHT * penalty, -np.inf)
        best = int(values.argmax())
        chosen.append(best)
        near = pixels[best : best + 1]
        penalty = np.maximum(penalty, spread_penalty(pixels, near, _SPREAD_DISTANCE))
        usable &= np.square(pixels - near).sum(axis=1) >= MIN_DISTANCE**2
    return np.array(chosen, dtype=np.int64)
