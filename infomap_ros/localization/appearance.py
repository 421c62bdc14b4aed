"""Finding fiducials again by what they look like.

For coming back to a known place, after large steps, and after being lost. Every fiducial is
described by the SIFT or ORB descriptor of its surroundings; corners of the new image are described
likewise and compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.range_view import RangeView, check_pixels

_UPRIGHT = 0.0  # [deg]


@dataclass(frozen=True)
class AppearanceConfig:
    """How fiducials are described and compared.

    Raises:
        ConfigError: a value is out of its range.
    """

    descriptor: str = parameter(
        "sift", "Descriptor of a fiducial's surroundings.", choices=("sift", "orb")
    )
    size: float = parameter(
        12.0, "Diameter of the described keypoint.", unit="px", low=2.0, high=100.0
    )
    corners: int = parameter(800, "Most corners of an image that are compared.", low=10, high=10000)
    corner_distance: float = parameter(
        4.0, "Least distance of two corners.", unit="px", low=1.0, high=50.0
    )
    corner_quality: float = parameter(
        0.003, "Least response of a corner, as a share of the strongest.", low=1e-6, high=1.0
    )
    max_ratio: float = parameter(
        0.8,
        "The best match must be nearer than this share of the second best's distance (Lowe 2004, "
        "DOI 10.1023/B:VISI.0000029664.99615.94).",
        low=0.1,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class AppearanceMatches(NamedTuple):
    """Fiducials that were found again.

    Attributes:
        indices: rows of the descriptors that were searched for, each once, shape (M,).
        pixels: where they were found, within a pixel or two, shape (M, 2) [px].
        ratios: distance of the match over that of the second best, shape (M,); small is sure.
    """

    indices: NDArray[np.int64]
    pixels: FloatArray
    ratios: FloatArray


def describe(
    image: NDArray[np.uint8], pixels: ArrayLike, config: AppearanceConfig | None = None
) -> NDArray[np.generic]:
    """Describe the surroundings of pixels.

    Args:
        image: grey, shape (H, W).
        pixels: shape (N, 2) [px].
        config: defaults where None.

    Returns:
        Descriptors, shape (N, D): float32 for SIFT, uint8 (bits) for ORB. Those of pixels that
        are too near to the border are all zero and match nothing.
    """
    config = config or AppearanceConfig()
    places = check_pixels(pixels)
    extractor = _extractor(config)
    kind = np.float32 if config.descriptor == "sift" else np.uint8
    descriptors = np.zeros((len(places), extractor.descriptorSize()), kind)
    keypoints = [
        cv2.KeyPoint(float(u), float(v), config.size, _UPRIGHT, 1.0, 0, index)
        for index, (u, v) in enumerate(places)
    ]
    if keypoints:
        kept, found = extractor.compute(image, keypoints)
        if found is not None:
            descriptors[[keypoint.class_id for keypoint in kept]] = found
    return descriptors


def find_again(
    view: RangeView,
    descriptors: NDArray[np.generic],
    predicted: ArrayLike | None = None,
    radius: float | None = None,
    config: AppearanceConfig | None = None,
) -> AppearanceMatches:
    """Look for described fiducials in a view.

    Args:
        view: where to look.
        descriptors: made by `describe` with the same configuration, shape (N, D).
        predicted: where they are expected, shape (N, 2) [px]; NaN = unknown.
        radius: a fiducial is looked for this far from where it is expected [px].
        config: defaults where None.

    Raises:
        InvalidInputError: shapes do not fit, or a prediction comes without a radius.
    """
    config = config or AppearanceConfig()
    if (predicted is None) != (radius is None):
        raise InvalidInputError("radius", "and predicted must come together")
    corners = corners_of(view.image, config)
    nothing = AppearanceMatches(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
    if len(corners) < 2 or len(descriptors) == 0:
        return nothing
    distances = _distances(descriptors, describe(view.image, corners, config))
    if predicted is not None and radius is not None:
        places = check_pixels(predicted, "predicted")
        if len(places) != len(descriptors):
            raise InvalidInputError("predicted", f"{len(places)}, expected {len(descriptors)}")
        apart = np.linalg.norm(places[:, None] - corners[None], axis=2)
        distances[apart > radius] = np.inf
    return _mutual_matches(distances, corners, config.max_ratio)


def corners_of(image: NDArray[np.uint8], config: AppearanceConfig) -> FloatArray:
    """Corners of an image (J. Shi and C. Tomasi 1994), strongest first, shape (K, 2) [px]."""
    found = cv2.goodFeaturesToTrack(
        image, config.corners, config.corner_quality, config.corner_distance
    )
    return np.zeros((0, 2)) if found is None else found[:, 0].astype(np.float64)


def _extractor(config: AppearanceConfig) -> cv2.Feature2D:
    if config.descriptor == "sift":
        return cv2.SIFT.create()
    return cv2.ORB.create(edgeThreshold=16, patchSize=31)


def _distances(first: NDArray[Any], second: NDArray[Any]) -> FloatArray:
    """Distances between descriptors, shape (N, K); infinite for those that are all zero."""
    if first.dtype == np.uint8:  # bits as -1 and 1: their product counts those that agree
        bits = [np.unpackbits(d, axis=1).astype(np.float32) * 2.0 - 1.0 for d in (first, second)]
        result = 0.5 * (bits[0].shape[1] - bits[0] @ bits[1].T).astype(np.float64)
    else:
        squares = [np.square(d).sum(axis=1) for d in (first, second)]
        product = (first @ second.T).astype(np.float64)
        result = np.sqrt(np.maximum(squares[0][:, None] + squares[1] - 2.0 * product, 0.0))
    result[~first.any(axis=1)] = np.inf
    result[:, ~second.any(axis=1)] = np.inf
    return result


def _mutual_matches(
    distances: FloatArray, corners: FloatArray, max_ratio: float
) -> AppearanceMatches:
    """Pairs that are each other's best, by a margin over the second best corner elsewhere."""
    rows = np.arange(len(distances))
    best = distances.argmin(axis=1)
    nearest = distances[rows, best]
    others = np.linalg.norm(corners[best][:, None] - corners[None], axis=2) > 2.0
    second = np.where(others, distances, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        ratios = np.where(np.isfinite(second), nearest / second, max_ratio)
    good = np.isfinite(nearest) & (ratios <= max_ratio)
    good &= distances.argmin(axis=0)[best] == rows
    chosen = np.flatnonzero(good)
    return AppearanceMatches(chosen, corners[best[chosen]], ratios[chosen])
