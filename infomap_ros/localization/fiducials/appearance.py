"""Finding fiducials again by what they look like.

For coming back to a known place, after large steps, and after being lost. Every fiducial is
described by the gradients of its surroundings at several scales; corners of the new image are
described at one, and the best scale tells how much nearer or farther the camera is now.
docs/localization.md compares this with OpenCV's detectors and descriptors.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.range_view import RangeView, check_pixels

# Descriptors of image patches: histograms of gradients, at a spacing and turn that are asked for.
#
# The layout is that of SIFT (D. G. Lowe 2004, DOI 10.1023/B:VISI.0000029664.99615.94): 16 x 16
# gradients in 4 x 4 cells of 8 directions, weighted by a Gaussian and shared between neighboring
# bins. Square roots of the shares compare better than the shares themselves (R. Arandjelovic and A.
# Zisserman 2012, DOI 10.1109/CVPR.2012.6248018). There is no search for a scale or a direction: the
# scale follows from the range, the direction from the pose that is expected.

LENGTH = 128
"""Numbers of one descriptor."""

_GRID = 16  # gradients along a side
_CELLS = 4
_DIRECTIONS = 8
_SMOOTHING = 0.8  # of each level of the pyramid [px]
_WINDOW_SIGMA = 2.0  # of the Gaussian weight [cells]


def gradient_histograms(
    image: NDArray[np.uint8],
    pixels: FloatArray,
    spacings: tuple[float, ...],
    turn: float = 0.0,
) -> NDArray[np.uint8]:
    """Describe patches at several scales.

    Args:
        image: gray, shape (H, W); goes on beyond its border as its outermost pixels do.
        pixels: centers, shape (N, 2) [px].
        spacings: distances of neighboring gradients [px], S of them.
        turn: of the patches, from u towards v [rad].

    Returns:
        Square roots of the histograms' shares times 255, shape (N, S, 128), uint8; all zero where
        there is no gradient.
    """
    places = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    described = np.zeros((len(places), len(spacings), LENGTH), np.float32)
    levels = [max(0, round(np.log2(spacing))) for spacing in spacings]
    smooth, along = image, (np.cos(turn), np.sin(turn))
    for level in range(max(levels, default=0) + 1):
        smooth = image if level == 0 else cv2.pyrDown(smooth)
        blurred = np.asarray(cv2.GaussianBlur(smooth, (0, 0), _SMOOTHING))
        here = (places + 0.5) / 2.0**level - 0.5
        for scale, spacing in enumerate(spacings):
            if levels[scale] == level:
                step = spacing / 2.0**level
                _describe_all(blurred, here, step * along[0], step * along[1], described[:, scale])
    return np.asarray(np.rint(255.0 * described), dtype=np.uint8)


@njit(nogil=True, cache=True, error_model="numpy")
def _describe_all(image, pixels, du, dv, described):  # type: ignore[no-untyped-def]
    patch = np.empty((_GRID + 2, _GRID + 2))
    for n in range(len(pixels)):
        _sample(image, pixels[n, 0], pixels[n, 1], du, dv, patch)
        histogram = described[n]
        for j in range(_GRID):
            for i in range(_GRID):
                along = patch[j + 1, i + 2] - patch[j + 1, i]
                down = patch[j + 2, i + 1] - patch[j, i + 1]
                _vote(i, j, along, down, histogram)
        total = histogram.sum()
        if total > 0.0:
            for k in range(LENGTH):
                histogram[k] = np.sqrt(histogram[k] / total)


@njit(nogil=True, cache=True, error_model="numpy")
def _sample(image, u, v, du, dv, patch):  # type: ignore[no-untyped-def]
    """Bilinear samples on a square grid about a pixel, its rows along (du, dv), clamped."""
    height, width = image.shape
    middle = 0.5 * (patch.shape[0] - 1)
    for j in range(patch.shape[0]):
        y = j - middle
        for i in range(patch.shape[1]):
            x = i - middle
            s = min(max(u + x * du - y * dv, 0.0), width - 1.001)
            t = min(max(v + x * dv + y * du, 0.0), height - 1.001)
            column, row = int(s), int(t)
            f, g = s - column, t - row
            top = image[row, column] * (1.0 - f) + image[row, column + 1] * f
            bottom = image[row + 1, column] * (1.0 - f) + image[row + 1, column + 1] * f
            patch[j, i] = top * (1.0 - g) + bottom * g


@njit(nogil=True, cache=True, error_model="numpy")
def _vote(i, j, along, down, histogram):  # type: ignore[no-untyped-def]
    """Share a gradient between the two nearest cells each way and the two nearest directions."""
    size = np.hypot(along, down)
    if size == 0.0:
        return
    middle = 0.5 * (_GRID - 1)
    x, y = (i - middle) * _CELLS / _GRID, (j - middle) * _CELLS / _GRID
    size *= np.exp(-(x * x + y * y) / (2.0 * _WINDOW_SIGMA**2))
    turn = np.arctan2(down, along) * _DIRECTIONS / (2.0 * np.pi) % _DIRECTIONS
    column, row = x + 0.5 * (_CELLS - 1), y + 0.5 * (_CELLS - 1)
    c, r, d = int(np.floor(column)), int(np.floor(row)), int(np.floor(turn))
    for q in range(2):
        for p in range(2):
            if not (0 <= c + p < _CELLS and 0 <= r + q < _CELLS):
                continue
            share = size * (1.0 - abs(column - c - p)) * (1.0 - abs(row - r - q))
            cell = ((r + q) * _CELLS + c + p) * _DIRECTIONS
            histogram[cell + d % _DIRECTIONS] += share * (1.0 - (turn - d))
            histogram[cell + (d + 1) % _DIRECTIONS] += share * (turn - d)


SCALES = (0.5, 0.71, 1.0, 1.41, 2.0)
"""How many times larger a fiducial may look in a later view, as descriptors compare it."""

# Corners this near to the best match show the same thing and do not rival it [px].
_SAME_PLACE = 2.0
_TURN = np.pi / 9.0  # [rad]; descriptors compare well when turned by half of it
_SPACING = 2.0  # of the 16 x 16 gradients of a descriptor [px]
_CORNERS = 800  # most corners of an image that are compared
_CORNER_DISTANCE = 4.0  # least distance of two corners [px]
_CORNER_QUALITY = 0.003  # least response of a corner, as a share of the strongest
MAX_RATIO = 0.85
"""The best match must be nearer than this share of the second best's distance (Lowe 2004)."""


class AppearanceMatches(NamedTuple):
    """Fiducials that were found again.

    Attributes:
        indices: rows of the descriptors that were searched for, each once, shape (M,).
        pixels: where they were found, within a pixel or two, shape (M, 2) [px].
        ratios: distance of the match over that of the second best, shape (M,); small is sure.
        scales: how many times larger they look now, one of `SCALES`, shape (M,).
    """

    indices: NDArray[np.int64]
    pixels: FloatArray
    ratios: FloatArray
    scales: FloatArray


def describe(image: NDArray[np.uint8], pixels: ArrayLike) -> NDArray[np.uint8]:
    """Describe the surroundings of pixels at all `SCALES`.

    Args:
        image: gray, shape (H, W).
        pixels: shape (N, 2) [px].

    Returns:
        Descriptors, shape (N, 640), uint8; all zero, so that they match nothing, where there is
        no gradient.
    """
    spacings = tuple(_SPACING / scale for scale in SCALES)
    return gradient_histograms(image, check_pixels(pixels), spacings).reshape(-1, descriptor_size())


def descriptor_size() -> int:
    """Length D of a descriptor."""
    return len(SCALES) * LENGTH


def find_again(
    view: RangeView,
    descriptors: NDArray[np.uint8],
    predicted: ArrayLike | None = None,
    radius: float | None = None,
    turns: FloatArray | None = None,
) -> AppearanceMatches:
    """Look for described fiducials in a view.

    Args:
        view: where to look.
        descriptors: made by `describe`, shape (N, D).
        predicted: where they are expected, shape (N, 2) [px]; NaN = unknown, not looked for.
        radius: a fiducial is looked for this far from where it is expected [px].
        turns: by which each is expected to look turned, from u towards v, since it was described,
            shape (N,) [rad]; not at all where None.

    Raises:
        InvalidInputError: shapes do not fit, or a prediction comes without a radius.
    """
    if descriptors.ndim != 2 or descriptors.shape[1] != descriptor_size():
        raise InvalidInputError("descriptors", f"shape {descriptors.shape}, expected (N, D)")
    if (predicted is None) != (radius is None):
        raise InvalidInputError("radius", "and predicted must come together")
    corners = corners_of(view.image)
    if len(corners) < 2 or len(descriptors) == 0:
        nothing = np.zeros(0)
        return AppearanceMatches(np.zeros(0, np.int64), np.zeros((0, 2)), nothing, nothing)
    steps = np.zeros(len(descriptors)) if turns is None else np.rint(turns / _TURN)
    distances, scales = np.zeros((2, len(descriptors), len(corners)))
    for step in np.unique(steps):
        same = steps == step
        described = gradient_histograms(view.image, corners, (_SPACING,), step * _TURN)[:, 0]
        distances[same], scales[same] = _distances(descriptors[same], described)
    if predicted is not None and radius is not None:
        places = check_pixels(predicted, "predicted")
        if len(places) != len(descriptors):
            raise InvalidInputError("predicted", f"{len(places)}, expected {len(descriptors)}")
        apart = np.linalg.norm(places[:, None] - corners[None], axis=2)
        distances[~(apart <= radius)] = np.inf
    rows, columns, ratios = _mutual_matches(distances, corners, MAX_RATIO)
    return AppearanceMatches(rows, corners[columns], ratios, scales[rows, columns])


def corners_of(image: NDArray[np.uint8]) -> FloatArray:
    """Corners of an image (J. Shi and C. Tomasi 1994), strongest first, shape (K, 2) [px]."""
    found = cv2.goodFeaturesToTrack(image, _CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE)
    return np.zeros((0, 2)) if found is None else found[:, 0].astype(np.float64)


def _distances(
    fiducials: NDArray[np.uint8], corners: NDArray[np.uint8]
) -> tuple[FloatArray, FloatArray]:
    """Distances at the best scale, infinite for empty descriptors, and that scale; (N, K) each."""
    second = corners.astype(np.float32)
    best = np.full((len(fiducials), len(corners)), np.inf)
    scales = np.ones_like(best)
    for scale, first in zip(SCALES, np.split(fiducials, len(SCALES), axis=1), strict=True):
        first = first.astype(np.float32)
        squares = np.square(first).sum(axis=1)[:, None] + np.square(second).sum(axis=1)
        squared = np.maximum(squares - 2.0 * (first @ second.T), 0.0)
        squared[~first.any(axis=1)] = np.inf
        nearer = squared < best
        best[nearer], scales[nearer] = squared[nearer], scale
    best[:, ~second.any(axis=1)] = np.inf
    return np.sqrt(best), scales


def _mutual_matches(
    distances: FloatArray, corners: FloatArray, max_ratio: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Pairs that are each other's best, by a margin over the second best corner elsewhere.

    Returns:
        Rows, columns and ratios of the pairs, shape (M,) each.
    """
    rows = np.arange(len(distances))
    best = distances.argmin(axis=1)
    nearest = distances[rows, best]
    elsewhere = np.linalg.norm(corners[best][:, None] - corners[None], axis=2) > _SAME_PLACE
    second = np.where(elsewhere, distances, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        ratios = np.where(np.isfinite(second), nearest / second, max_ratio)
    good = np.isfinite(nearest) & (ratios <= max_ratio)
    good &= distances.argmin(axis=0)[best] == rows
    chosen = np.flatnonzero(good)
    return chosen, best[chosen], ratios[chosen]
