"""The target as a board of tags: found in the image, its pose refined with the measured range.

Steps: tags in the image; the poses that they allow; the tags that agree with each; refinement with
corners and inverse depths; the decision between the two poses of a plane; checks that refuse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, transform_points
from infomap_ros.geometry.config import check_config
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagFinder, Tags
from infomap_ros.localization.target.tag_pose import (
    KnownPoints,
    KnownRanges,
    PoseFit,
    fit_pose,
    initial_poses,
    no_ranges,
    pixel_residuals,
    point_jacobian,
    whitening_of,
)
from infomap_ros.localization.target.target import RefusalReason, TargetRefusal, TargetSighting

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView

_NAME = "tags"
_SAMPLES = (np.arange(5) + 0.5) / 5.0 - 0.5  # where on a tag range is asked for, in sides


@dataclass(frozen=True)
class TagTargetConfig:
    """A board of tags as target, and when a sighting of it is believed.

    Raises:
        ConfigError: a value is out of its range.
    """

    board: TagBoardConfig = field(default_factory=TagBoardConfig)
    range_scale_sigma: ClassVar[float] = 0.02
    """Standard deviation of the ratio between measured range and the range that the tags' size
    tells: errors of baseline and print.
    """
    ambiguity_cost: ClassVar[float] = 14.0
    """How much worse, in squared sigmas, the other pose of a plane must fit to be ruled out."""
    agreement: ClassVar[float] = 5.0
    """A tag with a corner farther from the board's pose, in sigmas, is left out."""
    agreement_pixels: ClassVar[float] = 0.5
    """Nor is a tag left out for less than this [px]."""
    max_rotation_sigma: ClassVar[float] = 0.1
    """A pose that is less certain about any axis is refused [rad]."""

    def __post_init__(self) -> None:
        check_config(self)


class _Fits(NamedTuple):
    """Poses that explain a view, the best first; see `TagTargetDetector`.

    Attributes:
        poses: at least one.
        inflation: of their covariances, by how badly the best fits.
        share: of the tags that agree.
    """

    poses: list[PoseFit]
    inflation: float
    share: float


class TagTargetDetector:
    """Finds a board of tags; see `target.TargetDetector`.

    Args:
        config: the board, and when a sighting of it is believed.

    Attributes:
        board: where its tags are.
    """

    def __init__(self, config: TagTargetConfig | None = None) -> None:
        self.config = config or TagTargetConfig()
        self.board = TagBoard(self.config.board)
        self._finder = TagFinder(self.config.board.family)

    def detect(self, view: RangeView) -> TargetSighting | TargetRefusal:
        """Find the board, or say why not."""
        return self.locate(self.find(view), view)

    def find(self, view: RangeView) -> Tags:
        """The board's tags in a view."""
        return own_tags(self._finder.look(view), self.board)

    def locate(self, tags: Tags, view: RangeView) -> TargetSighting | TargetRefusal:
        """Work out the board's pose from tags that were found before.

        Args:
            tags: those of this board only.
            view: the view in which they were found.
        """
        fits = self._fits(tags, view)
        return fits if isinstance(fits, TargetRefusal) else self._decide(fits)

    def place(self, tags: Tags, view: RangeView) -> tuple[FloatArray, FloatArray] | None:
        """Where all corners of the board are, also where the two poses of a plane explain the view.

        Args:
            tags: those of this board only.
            view: the view in which they were found.

        Returns:
            Mean and covariance of the corners in the camera frame over the poses by how well they
            fit, shape (N, 3) [m] and (3N, 3N) [m^2]; None where no pose fits.
        """
        fits = self._fits(tags, view)
        if isinstance(fits, TargetRefusal) or self._contradicts_range(fits.poses[0]):
            return None
        corners = self.board.corners.reshape(-1, 3)
        worse = np.array([fit.cost - fits.poses[0].cost for fit in fits.poses])
        weights = np.exp(-0.5 * worse / fits.inflation)
        weights /= weights.sum()
        places = np.array([transform_points(fit.T_camera_target, corners) for fit in fits.poses])
        mean = np.tensordot(weights, places, 1)
        covariance = np.zeros((corners.size, corners.size))
        for weight, place, fit in zip(weights, places, fits.poses, strict=True):
            over = point_jacobian(corners, fit.T_camera_target).reshape(-1, 6)
            apart = (place - mean).ravel()
            own = fits.inflation * over @ fit.covariance @ over.T
            covariance += weight * (own + np.outer(apart, apart))
        return mean, covariance

    def _fits(self, tags: Tags, view: RangeView) -> _Fits | TargetRefusal:
        """The poses that explain a view, or why there are none."""
        camera = view.camera
        if not len(tags.ids):
            return _refuse("not in view", f"0 of {len(self.board.ids)} tags found")
        known = self._known(tags)
        starts = self._consensus(known, camera)
        agreeing = max((mask for _, mask in starts), key=np.sum, default=np.zeros(0, bool))
        if 2 * agreeing.sum() < len(tags.ids):
            return _refuse("inconsistent", f"{agreeing.sum()} of {len(tags.ids)} tags agree")
        known = _select(known, agreeing)
        ranges = self._ranges(tags.ids[agreeing], tags.corners[agreeing], view)
        fits = [fit_pose(camera, known, ranges, start) for start, _ in starts]
        found = [fit for fit in fits if fit is not None]
        if not found:
            return _refuse("inconsistent", "no pose fits")
        poses = sorted(found, key=lambda fit: fit.cost)
        inflation = max(1.0, poses[0].pixel_cost / max(2 * len(known.points) - 6, 1))
        return _Fits(poses, inflation, float(agreeing.sum()) / len(tags.ids))

    def _known(self, tags: Tags) -> KnownPoints:
        places = [self.board.ids.index(int(one)) for one in tags.ids]
        return KnownPoints(
            self.board.corners[places].reshape(-1, 3),
            tags.corners.reshape(-1, 2),
            whitening_of(tags.covariances.reshape(-1, 2, 2)),
        )

    def _consensus(
        self, known: KnownPoints, camera: PinholeCamera
    ) -> list[tuple[FloatArray, NDArray[np.bool_]]]:
        """Poses, and the tags that agree with each, from all corners and from each tag alone."""
        count = len(known.points) // 4
        groups = [np.ones(count, bool), *(np.eye(count, dtype=bool) if count > 1 else [])]
        found = []
        for group in groups:
            part = _select(known, group)
            for start in initial_poses(part.points, part.pixels, camera):
                fit = fit_pose(camera, part, no_ranges(), start)
                if fit is not None:
                    mask = self._agreeing(known, camera, fit.T_camera_target)
                    found.append((fit.T_camera_target, mask))
            if found and found[0][1].all():
                break  # all agree with the pose from all
        best = max((mask.sum() for _, mask in found), default=0)
        first = next((mask for _, mask in found if mask.sum() == best), None)
        return self._both_poses(known, camera, first) if first is not None and best else []

    def _both_poses(
        self, known: KnownPoints, camera: PinholeCamera, mask: NDArray[np.bool_]
    ) -> list[tuple[FloatArray, NDArray[np.bool_]]]:
        """Every pose that the agreeing tags allow together."""
        part = _select(known, mask)
        return [(pose, mask) for pose in initial_poses(part.points, part.pixels, camera)]

    def _agreeing(
        self, known: KnownPoints, camera: PinholeCamera, pose: FloatArray
    ) -> NDArray[np.bool_]:
        whitened = np.linalg.norm(pixel_residuals(camera, known, pose), axis=1)
        predicted = camera.project(transform_points(pose, known.points))
        distance = np.linalg.norm(predicted - known.pixels, axis=1)
        near = (whitened < self.config.agreement) | (distance < self.config.agreement_pixels)
        return np.asarray(near.reshape(-1, 4).all(axis=1))

    def _ranges(self, ids: NDArray[np.int64], corners: FloatArray, view: RangeView) -> KnownRanges:
        """Inverse depths measured on the agreeing tags, between their corners."""
        side = self.config.board.side
        x, y = (axis.ravel() * side for axis in np.meshgrid(_SAMPLES, -_SAMPLES))
        on_tag = np.column_stack([x, y, np.zeros(len(x))])
        half = 0.5 * side
        square = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
        points, pixels = [], []
        for one, quad in zip(ids, corners, strict=True):
            pose = self.board.tag_poses[self.board.ids.index(int(one))]
            points.append(transform_points(pose, on_tag))
            pixels.append(_through_homography(square, quad, on_tag[:, :2]))
        places = np.concatenate(pixels)
        rho, sigma = view.inverse_depths(places)
        good = np.isfinite(rho) & np.isfinite(sigma) & (rho > 0.0) & (sigma > 0.0)
        scale_sigma = self.config.range_scale_sigma
        return KnownRanges(np.concatenate(points)[good], rho[good], sigma[good], scale_sigma)

    def _contradicts_range(self, fit: PoseFit) -> bool:
        return abs(fit.scale) > 4.0 * self.config.range_scale_sigma

    def _decide(self, fits: _Fits) -> TargetSighting | TargetRefusal:
        config, best = self.config, fits.poses[0]
        covariance = best.covariance * fits.inflation
        if self._contradicts_range(best):
            text = f"by {100.0 * best.scale:.1f} %: is the tag's side right?"
            return _refuse("range contradicts size", text)
        for other in fits.poses[1:]:
            apart = _difference(best.T_camera_target, other.T_camera_target)
            worse = (other.cost - best.cost) / fits.inflation
            if worse < config.ambiguity_cost:
                if np.linalg.norm(apart[3:]) > 2.0 * config.max_rotation_sigma:
                    angle = np.degrees(np.linalg.norm(apart[3:]))
                    text = f"a pose turned by {angle:.0f} deg fits {worse:.1f} sigma^2 worse"
                    return _refuse("ambiguous", text)
                weight = 1.0 / (1.0 + np.exp(0.5 * worse))
                covariance = covariance + weight * np.outer(apart, apart)
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
        if sigma > config.max_rotation_sigma:
            return _refuse("too uncertain", f"rotation sigma {sigma:.3f} rad")
        return TargetSighting(best.T_camera_target, covariance, fits.share, _NAME)


def own_tags(tags: Tags, board: TagBoard) -> Tags:
    """Those of the tags that are on a board."""
    return tags.select(np.isin(tags.ids, board.ids))


def _select(known: KnownPoints, tags: NDArray[np.bool_]) -> KnownPoints:
    rows = np.repeat(tags, 4)
    return KnownPoints(known.points[rows], known.pixels[rows], known.whitening[rows])


def _difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Pose error, shape (6,), that takes the first pose to the second."""
    turn = Rotation.from_matrix(second[:3, :3] @ first[:3, :3].T).as_rotvec()
    return np.concatenate([second[:3, 3] - first[:3, 3], turn])


def _through_homography(square: FloatArray, quad: FloatArray, points: FloatArray) -> FloatArray:
    """Pixels of points in a tag's plane, by its four corners, shape (N, 2)."""
    rows = []
    for (x, y), (u, v) in zip(square, quad, strict=True):
        rows.append([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y])
        rows.append([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y])
    matrix = np.append(np.linalg.solve(np.array(rows), quad.ravel()), 1.0).reshape(3, 3)
    mapped = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _refuse(reason: RefusalReason, detail: str) -> TargetRefusal:
    return TargetRefusal(reason, detail, _NAME)
