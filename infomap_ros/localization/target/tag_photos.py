"""Tags in photos: which there are, drawn where they are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import FAMILIES
from infomap_ros.localization.target.tag_detection import TagFinder, Tags

_OUTLINE, _FIRST_CORNER = (0, 200, 0), (0, 0, 255)  # BGR


def read_photo(path: Path) -> NDArray[np.uint8]:
    """A photo as BGR, shape (H, W, 3).

    Raises:
        InvalidInputError: it is not there or not an image.
    """
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise InvalidInputError(str(path), "is not there or not an image")
    return np.asarray(pixels, dtype=np.uint8)


def find_tags(photo: NDArray[np.uint8], family: str = "") -> tuple[str, Tags]:
    """Tags in a photo, and their family.

    Args:
        photo: BGR, shape (H, W, 3).
        family: of `TagBoardConfig`; where empty, the one whose tags are the least likely to be
            random patterns.
    """
    gray = np.asarray(cv2.cvtColor(photo, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    finders = {name: TagFinder(name) for name in ([family] if family else FAMILIES)}
    found = {name: finder.find(gray, may_repeat=True) for name, finder in finders.items()}
    best = max(found, key=lambda name: len(found[name].ids) * finders[name].evidence)
    return best, found[best]


def draw_tags(photo: NDArray[np.uint8], tags: Tags) -> NDArray[np.uint8]:
    """The photo with outlines and ids; a dot marks the top left corner of each print."""
    drawn = photo.copy()
    width = max(1, round(max(photo.shape) / 700))
    for one, corners in zip(tags.ids, tags.corners, strict=True):
        points = np.rint(corners).astype(np.int32)
        cv2.polylines(drawn, [points], True, _OUTLINE, width, cv2.LINE_AA)
        cv2.circle(drawn, [int(v) for v in points[0]], 2 * width, _FIRST_CORNER, -1, cv2.LINE_AA)
        place = [int(v) for v in np.rint(corners.mean(axis=0))]
        for color, thickness in (((255, 255, 255), 3 * width), (_OUTLINE, width)):
            cv2.putText(
                drawn, str(one), place, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * width, color, thickness,
                cv2.LINE_AA,
            )  # fmt: skip
    return drawn


def tag_positions(tags: Tags, side: float, camera: PinholeCamera) -> FloatArray:
    """Middles of the tags in the camera's optical frame, shape (T, 3) [m].

    Args:
        tags: in an image without distortion.
        side: edge of a black square [m].
        camera: that took it.
    """
    half = 0.5 * side
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    places = [
        cv2.solvePnP(square, corners, camera.matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)[2]
        for corners in tags.corners
    ]
    return np.reshape(np.array(places, dtype=np.float64), (-1, 3))
