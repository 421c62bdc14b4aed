"""Tags in an image: which ones, and where their corners are.

Tags that another node has found: which of them are believed, and in which view they are.

Tags in photos: which there are, drawn where they are.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import comb, log2
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.records import Record, WaitingQueueConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import FAMILIES, cells, dictionary

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView

# Corners of tags to a fraction of a pixel, each with a covariance from the image itself.
#
# To the pixels beside each edge of the black square a straight step from dark to bright is fitted,
# blurred by a Gaussian: ``I = D(s) + (B(s) - D(s)) Phi((n p - offset - slope s) / sigma)`` with
# levels D and B that change linearly along the edge, as light does. The noise of a pixel is what
# the fit leaves; it gives the covariance of the line. Neighboring lines are intersected.

_LEAST_CONTOUR = 0.6  # pixels of a contour for each of its length: diagonal ones have 1/sqrt(2)
_ENDS = 0.12  # share of an edge at either end that the other edge's blur reaches
_INSIDE, _OUTSIDE = 0.55, 0.8  # reach of the pixels beside an edge, in cells
_LEAST_REACH, _LARGEST_REACH = 1.2, 5.0  # [px]
_BLUR, _LOG_BLUR_SIGMA = 0.8, 0.5  # prior of a step's blur: [px], and of its logarithm
_LEAST_NOISE = 0.3  # [gray levels], rounding to whole gray levels
_ITERATIONS = 12
_DETERMINED = 1e-10  # smallest eigenvalue of a line's information, scaled to a unit diagonal
_MIN_CONTRAST = 15.0  # smallest difference of white and black [gray levels]
_MIN_SIDE = 12.0  # tags with a shorter edge are left out [px]
# Share of the bits that a family can correct that are corrected. Fewer are safer.
_CORRECTED_BITS = 0.4
# Standard deviation of a corner from print, paper and lens, added to that of the image noise [px].
# About 0.3 for a sheet before a webcam, 0.03 for a rendered board.
_SIGMA_FLOOR = 0.25
_PARALLEL = 0.05  # sine of the angle between two edges below which they have no corner
_MOVED = 0.3  # [px] if corners moved by more, the pixels beside the edges are chosen again
_ROOT_TWO_PI = float(np.sqrt(2.0 * np.pi))


class TagCorners(NamedTuple):
    """Corners of one tag.

    Attributes:
        pixels: shape (4, 2) [px].
        covariances: shape (4, 2, 2) [px^2].
    """

    pixels: FloatArray
    covariances: FloatArray


def refine_corners(
    image: NDArray[np.uint8], corners: FloatArray, cells: int, min_contrast: float
) -> TagCorners | None:
    """Measure the corners of the black square of a tag.

    Args:
        image: gray image, shape (H, W).
        corners: where they are within a pixel or two, clockwise, shape (4, 2) [px].
        cells: cells along the edge of the tag: white and black reach one cell from it.
        min_contrast: smallest difference of white and black [gray levels].

    Returns:
        The corners, or None where an edge is not dark inside and bright outside all along, the
        pixels beside it are not all in the image or leave it open, or two edges have no corner.
    """
    for _ in range(3):
        cell = _narrowest_cell(corners, cells)
        lines = []
        for i in range(4):
            pixels = _beside(image, corners[i], corners[(i + 1) % 4], cell)
            line = _fit_step(pixels, min_contrast) if pixels is not None else None
            if line is None:
                return None
            lines.append(line)
        met = [_intersect(lines[i - 1], lines[i]) for i in range(4)]
        found = [corner for corner in met if corner is not None]
        if len(found) < 4:
            return None
        pixels_found = np.stack([point for point, _ in found])
        moved = float(np.abs(pixels_found - corners).max())
        if moved > max(2.0, cell):
            return None
        corners = pixels_found
        if moved < _MOVED:
            break
    return TagCorners(corners, np.stack([covariance for _, covariance in found]))


class _Beside(NamedTuple):
    """Pixels beside an edge, in its coordinates.

    Attributes:
        middle: of the edge, shape (2,) [px].
        along: unit vector from start to end, shape (2,).
        half: half the edge's length [px].
        s: place along the edge, -1 at its start and 1 at its end, shape (P,).
        d: distance from the edge, positive outside, shape (P,) [px].
        gray: shape (P,).
    """

    middle: FloatArray
    along: FloatArray
    half: float
    s: FloatArray
    d: FloatArray
    gray: FloatArray


class _Line(NamedTuple):
    """A measured edge: ``n (p - middle) = offset + slope s``.

    Attributes:
        edge: what it was measured on.
        offset: [px].
        slope: [px] per unit of s.
        covariance: of offset and slope, shape (2, 2) [px^2].
    """

    edge: _Beside
    offset: float
    slope: float
    covariance: FloatArray


def _narrowest_cell(corners: FloatArray, cells: int) -> float:
    """Width of a cell where the tag is most foreshortened [px]."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    x, y = corners.T
    area = 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))
    return area / (float(edges.max()) * cells)


def _normal(along: FloatArray) -> FloatArray:
    """To the outside of a clockwise square, shape (2,)."""
    return np.array([along[1], -along[0]])


def _beside(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray, cell: float
) -> _Beside | None:
    """Pixels in the band along an edge; None where the band leaves the image."""
    half = 0.5 * float(np.linalg.norm(end - start))
    along, middle = (end - start) / (2.0 * half), 0.5 * (start + end)
    inside, outside = np.clip(np.array([_INSIDE, _OUTSIDE]) * cell, _LEAST_REACH, _LARGEST_REACH)
    low = np.floor(np.minimum(start, end) - outside).astype(int)
    high = np.ceil(np.maximum(start, end) + outside).astype(int) + 1
    if low.min() < 0 or high[0] > image.shape[1] or high[1] > image.shape[0]:
        return None
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    from_middle = np.stack([u.ravel(), v.ravel()], axis=1) - middle
    s, d = from_middle @ along / half, from_middle @ _normal(along)
    near = (np.abs(s) <= 1.0 - 2.0 * _ENDS) & (d >= -inside) & (d <= outside)
    gray = image[low[1] : high[1], low[0] : high[0]].ravel()[near].astype(np.float64)
    return _Beside(middle, along, half, s[near], d[near], gray)


def _fit_step(edge: _Beside, min_contrast: float) -> _Line | None:
    """Levenberg-Marquardt on offset, slope, log blur and four levels."""
    if len(edge.gray) < 14:
        return None
    state = np.array([0.0, 0.0, np.log(_BLUR), *_first_levels(edge)])
    residual, jacobian = _step_residuals(edge, state)
    damping = 1e-3
    for _ in range(_ITERATIONS):
        information = jacobian.T @ jacobian
        damped = information + damping * np.diag(np.diag(information) + 1e-9)
        change = -np.linalg.solve(damped, jacobian.T @ residual)
        moved = state + np.clip(change, -50.0, 50.0)
        moved[2] = np.clip(moved[2], -2.0, 2.0)
        next_residual, next_jacobian = _step_residuals(edge, moved)
        if next_residual @ next_residual <= residual @ residual:
            small = np.abs(change[:2]).max() < 1e-3
            state, residual, jacobian = moved, next_residual, next_jacobian
            damping = max(0.1 * damping, 1e-9)
            if small:
                break
        else:
            damping *= 10.0
    return _line(edge, state, residual, jacobian, min_contrast)


def _first_levels(edge: _Beside) -> tuple[float, float, float, float]:
    """Dark and bright levels with no change along the edge."""
    inner = np.median(edge.gray[edge.d <= 0.5 * edge.d.min()])
    outer = np.median(edge.gray[edge.d >= 0.5 * edge.d.max()])
    return float(inner), 0.0, float(outer), 0.0


def _step_residuals(edge: _Beside, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Predicted minus measured gray, and the blur's prior, shape (P + 1,); derivatives (P + 1, 7).

    The prior is weighed as if the noise were one gray level.
    """
    offset, slope, log_blur, dark, dark_slope, bright, bright_slope = state
    blur = np.exp(log_blur)
    ratio = (edge.d - offset - slope * edge.s) / blur
    share = ndtr(ratio)
    height = bright - dark + (bright_slope - dark_slope) * edge.s
    predicted = dark + dark_slope * edge.s + height * share
    by_place = -height * np.exp(-0.5 * ratio**2) / (_ROOT_TWO_PI * blur)
    jacobian = np.zeros((len(edge.s) + 1, 7))
    columns = [
        by_place,
        by_place * edge.s,
        by_place * ratio * blur,
        1.0 - share,
        (1.0 - share) * edge.s,
        share,
        share * edge.s,
    ]
    jacobian[:-1] = np.column_stack(columns)
    jacobian[-1, 2] = 1.0 / _LOG_BLUR_SIGMA
    prior = (log_blur - np.log(_BLUR)) / _LOG_BLUR_SIGMA
    return np.append(predicted - edge.gray, prior), jacobian


def _line(
    edge: _Beside, state: FloatArray, residual: FloatArray, jacobian: FloatArray, contrast: float
) -> _Line | None:
    """The line if it is a step from dark to bright along the whole edge, else None.

    None too where the pixels leave something of it open, as when it lies beyond all of them.
    """
    dark, bright = state[3] + state[4] * edge.s, state[5] + state[6] * edge.s
    if (bright - dark).min() < contrast:
        return None
    noise = float(residual[:-1] @ residual[:-1]) / (len(residual) - 8)
    if np.sqrt(noise) > 0.5 * float(np.mean(bright - dark)):
        return None
    inverse = _inverse(jacobian.T @ jacobian)
    if inverse is None:
        return None
    covariance = max(float(noise), _LEAST_NOISE**2) * inverse[:2, :2]
    return _Line(edge, float(state[0]), float(state[1]), covariance)


def _inverse(information: FloatArray) -> FloatArray | None:
    """Inverse of an information, shape (n, n); None where it leaves a direction open."""
    scale = np.sqrt(np.diag(information))
    if not (np.isfinite(information).all() and scale.min() > 0.0):
        return None
    alike = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(alike)[0] < _DETERMINED:
        return None
    return np.asarray(np.linalg.inv(alike) / np.outer(scale, scale))


def _intersect(first: _Line, second: _Line) -> tuple[FloatArray, FloatArray] | None:
    """Corner at the end of the first line and the start of the second, and its covariance.

    None where they are parallel.
    """
    normals, places, variances = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    for i, (line, s) in enumerate(((first, 1.0), (second, -1.0))):
        edge = line.edge
        direction = edge.along + line.slope / edge.half * _normal(edge.along)
        normals[i] = _normal(direction / np.linalg.norm(direction))
        places[i] = normals[i] @ (edge.middle + line.offset * _normal(edge.along))
        row = np.array([1.0, s])
        variances[i] = row @ line.covariance @ row
    if abs(float(np.linalg.det(normals))) < _PARALLEL:
        return None
    inverse = np.linalg.inv(normals)
    return inverse @ places, inverse @ np.diag(variances) @ inverse.T


aruco: Any = cv2.aruco  # whose functions were renamed in OpenCV 4.7


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

    def select(self, mask: NDArray[np.bool_]) -> Tags:
        """Some of them: mask, shape (T,)."""
        return Tags(self.ids[mask], self.corners[mask], self.covariances[mask])


class TagFinder:
    """Finds the tags of one family.

    Args:
        family: one of `TagBoardConfig`.
        config: how.
    """

    def __init__(self, family: str) -> None:
        self._family, self._cells = family, cells(family)
        self._dictionary = dictionary(family)
        self._parameters = _detector_parameters()

    @property
    def evidence(self) -> float:
        """How unlikely it is that a random pattern passes for a tag, as ``-log2`` [bits]."""
        bits = int(self._dictionary.markerSize) ** 2
        wrong = int(self._dictionary.maxCorrectionBits * _CORRECTED_BITS)
        patterns = (
            4 * len(self._dictionary.bytesList) * sum(comb(bits, n) for n in range(wrong + 1))
        )
        return bits - log2(patterns)

    def look(self, view: RangeView) -> Tags:
        """The tags in a view: as another node has found them, else as `find` finds them."""
        if view.tags is None:
            return self.find(view.image)
        given = view.tags[view.tags["family"] == self._family]
        covariance = (_SIGMA_FLOOR**2 + _GIVEN_SIGMA**2) * np.eye(2)
        return Tags(given["id"], given["corners"], np.tile(covariance, (len(given), 4, 1, 1)))

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
            if (may_repeat or counts[one] == 1) and _shortest_edge(quad) >= _MIN_SIDE:
                corners = refine_corners(image, quad, self._cells, _MIN_CONTRAST)
                if corners is not None:
                    found.append((one, corners))
        floor = _SIGMA_FLOOR**2 * np.eye(2)
        return Tags(
            np.array([one for one, _ in found], dtype=np.int64),
            np.reshape([corners.pixels for _, corners in found], (-1, 4, 2)),
            np.reshape([corners.covariances + floor for _, corners in found], (-1, 4, 2, 2)),
        )

    def _detect(self, image: NDArray[np.uint8]) -> tuple[list[FloatArray], list[int]]:
        shortest = _LEAST_CONTOUR * 4.0 * _MIN_SIDE
        self._parameters.minMarkerPerimeterRate = shortest / max(image.shape)
        if hasattr(aruco, "ArucoDetector"):
            detector = aruco.ArucoDetector(self._dictionary, self._parameters)
            quads, ids, _ = detector.detectMarkers(image)
        else:  # OpenCV before 4.7
            quads, ids, _ = aruco.detectMarkers(
                image, self._dictionary, parameters=self._parameters
            )
        names = [] if ids is None else [int(one) for one in np.ravel(ids)]
        return [np.reshape(quad, (4, 2)).astype(np.float64) for quad in quads], names


def _detector_parameters() -> Any:
    create = getattr(aruco, "DetectorParameters_create", None) or aruco.DetectorParameters
    parameters = create()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    parameters.errorCorrectionRate = _CORRECTED_BITS
    return parameters


def _shortest_edge(quad: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min())


_TAG_FIELDS = ("family", "U32"), ("id", "i8"), ("hamming", "i8"), ("margin", "f8")
TAG = np.dtype([*_TAG_FIELDS, ("corners", "f8", (4, 2))])
"""A tag in an image: wrong bits, mean distance of bits from the threshold [gray levels], corners of
the black square [px] as OpenCV gives them: clockwise from the top left, pixel centers are whole."""


@dataclass(frozen=True, eq=False)
class TagDetectionsRecord(Record):
    """Tags that another node has found in an image, shape (T,) of `TAG`."""

    tags: NDArray[np.void]


_GIVEN_SIGMA = 0.1  # [px] of a corner by AprilTag 3 on rendered boards: 0.04 to 0.09 were measured
_LEAST_MARGIN = 7.5  # [gray levels], half of the contrast that is asked of a tag found here
_MOST_WAITING = 100  # records that wait for their view


def believed_tags(
    tags: NDArray[np.void], shape: tuple[int, ...], on_drop: Callable[[str, str], object]
) -> NDArray[np.void]:
    """Those of the tags that are decoded for certain and can be where they are said to be.

    Args:
        tags: that another node has found, shape (T,) of `TAG`.
        shape: rows and columns of the image.
        on_drop: called with the reason and the name of each tag that is left out.
    """
    names = [f"{tag['family']}:{tag['id']}" for tag in tags]
    counts = Counter(names)
    families = {*tags["family"].tolist()} & FAMILIES.keys()
    known = {family: len(dictionary(family).bytesList) for family in families}
    corners = tags["corners"]
    edges = np.roll(corners, -1, axis=1) - corners
    after = np.roll(edges, -1, axis=1)
    turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
    beyond = (corners < -0.5) | (corners > np.array(shape[1::-1]) - 0.5)
    faults = {
        "tag of an unknown family or id": [t["id"] >= known.get(t["family"], 0) for t in tags],
        "tag with wrong bits": tags["hamming"] > 0,
        "tag of low decision margin": tags["margin"] < _LEAST_MARGIN,
        "tag twice in an image": [counts[name] > 1 for name in names],
        "tag with corners in another order": (turns <= 0.0).any(axis=1),
        "tag too small": np.linalg.norm(edges, axis=2).min(axis=1) < _MIN_SIDE,
        "tag beyond the image": beyond.any(axis=(1, 2)),
    }
    good = np.ones(len(tags), dtype=bool)
    for reason, bad in faults.items():
        for number in np.flatnonzero(good & np.array(bad, dtype=bool)):
            on_drop(reason, names[number])
            good[number] = False
    return tags[good]


class TagPairing:
    """Holds views until the tags that another node finds in their images have come.

    A view goes on without tags when those of a later one are there, or after `waiting`. From then
    on none waits until something comes again, so that a detector that has ended costs its tags
    only.

    Args:
        waiting: how long views wait, and how many.
        tolerance: largest difference of the stamps [s].
        on_drop: called with the reason, and more of it, for each record that is not used.

    Attributes:
        frame_id: of the images, empty while it is not known.
    """

    def __init__(
        self, waiting: WaitingQueueConfig, tolerance: float, on_drop: Callable[[str, str], object]
    ) -> None:
        self._waiting, self._on_drop = waiting, on_drop
        self._tolerance, self._longest = (round(1e9 * s) for s in (tolerance, waiting.max_wait))
        self.frame_id = ""
        self.clear()

    def clear(self) -> None:
        """Forget what waits, as when the clock has jumped."""
        self._given: dict[int, NDArray[np.void]] = {}
        self._held: deque[Any] = deque()
        self._gone = -(2**62)  # stamp of the last view that has gone on [ns]
        self._is_alive = True

    def add(self, detections: TagDetectionsRecord) -> None:
        """Take what was found in an image."""
        self._is_alive = True
        if self.frame_id and detections.frame_id != self.frame_id:
            text = f"tags in frame '{detections.frame_id}', images in '{self.frame_id}'"
            self._on_drop("wrong frame", text)
        elif detections.stamp <= self._gone:
            self._on_drop(
                "tags after their image", f"{1e-9 * (self._gone - detections.stamp):.3f} s"
            )
        else:
            self._given[detections.stamp] = detections.tags
            if len(self._given) > _MOST_WAITING:
                self._forget(next(iter(self._given)))

    def take(self, views: Sequence[Any]) -> Iterator[tuple[Any, NDArray[np.void]]]:
        """Add views, which have a stamp [ns], in order of time; gives those that can go on by now.

        Each with its tags, shape (T,) of `TAG`.
        """
        self._held.extend(views)
        while self._held and not self._is_awaited(self._held[0].stamp):
            view = self._held.popleft()
            self._gone = view.stamp
            nearest = min(self._given, key=lambda one: abs(one - view.stamp), default=2**62)
            is_near = abs(nearest - view.stamp) <= self._tolerance
            yield view, self._given.pop(nearest) if is_near else np.zeros(0, TAG)
            for stamp in [one for one in self._given if one <= view.stamp]:
                self._forget(stamp)

    def _is_awaited(self, stamp: int) -> bool:
        """Whether the tags of the oldest view that is held may still come."""
        late = stamp + self._longest
        if any(stamp - self._tolerance <= one <= late for one in self._given):
            return False
        too_late = not stamp <= self._held[-1].stamp <= late
        self._is_alive &= not (too_late or len(self._held) > self._waiting.capacity)
        return self._is_alive

    def _forget(self, stamp: int) -> None:
        del self._given[stamp]
        self._on_drop("tags without their image", f"at {stamp} ns")


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
