"""Tags in an image: which ones, and where their corners are."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, log2
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import cells, dictionary
from infomap_ros.localization.target.tag_corners import refine_corners

aruco: Any = cv2.aruco  # whose functions were renamed in OpenCV 4.7


@dataclass(frozen=True)
class TagDetectionConfig:
    """How tags are found.

    Raises:
        ConfigError: a value is out of its range.
    """

    min_contrast: float = setting(
        15.0, "Smallest difference of white and black [gray levels].", low=1.0, high=255.0
    )
    min_side: ClassVar[float] = 12.0
    """Tags with a shorter edge are left out [px]."""
    corrected_bits: ClassVar[float] = 0.4
    """Share of the bits that a family can correct that are corrected. Fewer are safer."""
    sigma_floor: float = setting(
        0.25,
        "Standard deviation of a corner from print, paper and lens, added to that of the image "
        "noise. About 0.3 for a sheet before a webcam, 0.03 for a rendered board.",
        unit="px",
        low=0.001,
        high=5.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class Tags(NamedTuple):
    """Tags that were found.

    Attributes:
        ids: shape (T,).
        corners: of the black squares, top left of the print first, clockwise, shape
            (T, 4, 2) [px].
        covariances: of the corners, shape (T, 4, 2, 2) [px^2].
    """

    ids: NDArray[np.int64]
    corners: FloatArray
    covariances: FloatArray


class TagFinder:
    """Finds the tags of one family.

    Args:
        family: one of `TagBoardConfig`.
        config: how.
    """

    def __init__(self, family: str, config: TagDetectionConfig | None = None) -> None:
        self.config = config or TagDetectionConfig()
        self._cells = cells(family)
        self._dictionary = dictionary(family)
        self._parameters = _detector_parameters(self.config)

    @property
    def evidence(self) -> float:
        """How unlikely it is that a random pattern passes for a tag, as ``-log2`` [bits]."""
        bits = int(self._dictionary.markerSize) ** 2
        wrong = int(self._dictionary.maxCorrectionBits * self.config.corrected_bits)
        patterns = (
            4 * len(self._dictionary.bytesList) * sum(comb(bits, n) for n in range(wrong + 1))
        )
        return bits - log2(patterns)

    def find(self, image: NDArray[np.uint8], may_repeat: bool = False) -> Tags:
        """Find tags.

        Args:
            image: gray image, shape (H, W).
            may_repeat: whether several tags of the scene may have the same id.

        Returns:
            Those whose four edges could be measured; of an id that occurs twice none, unless it may
            repeat, for one of them is not the tag that is meant.
        """
        quads, ids = self._detect(image)
        counts = {one: ids.count(one) for one in ids}
        found = []
        for one, quad in zip(ids, quads, strict=True):
            if (may_repeat or counts[one] == 1) and _shortest_edge(quad) >= self.config.min_side:
                corners = refine_corners(image, quad, self._cells, self.config.min_contrast)
                if corners is not None:
                    found.append((one, corners))
        floor = self.config.sigma_floor**2 * np.eye(2)
        return Tags(
            np.array([one for one, _ in found], dtype=np.int64),
            np.reshape([corners.pixels for _, corners in found], (-1, 4, 2)),
            np.reshape([corners.covariances + floor for _, corners in found], (-1, 4, 2, 2)),
        )

    def _detect(self, image: NDArray[np.uint8]) -> tuple[list[FloatArray], list[int]]:
        if hasattr(aruco, "ArucoDetector"):
            detector = aruco.ArucoDetector(self._dictionary, self._parameters)
            quads, ids, _ = detector.detectMarkers(image)
        else:  # OpenCV before 4.7
            quads, ids, _ = aruco.detectMarkers(
                image, self._dictionary, parameters=self._parameters
            )
        names = [] if ids is None else [int(one) for one in np.ravel(ids)]
        return [np.reshape(quad, (4, 2)).astype(np.float64) for quad in quads], names


def _detector_parameters(config: TagDetectionConfig) -> Any:
    if hasattr(aruco, "ArucoDetector"):
        parameters = aruco.DetectorParameters()
    else:
        parameters = aruco.DetectorParameters_create()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    parameters.errorCorrectionRate = config.corrected_bits
    parameters.minMarkerPerimeterRate = 0.01
    return parameters


def _shortest_edge(quad: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min())
