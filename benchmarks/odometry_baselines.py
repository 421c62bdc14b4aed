"""Visual odometry that one writes in an afternoon: what localization is compared with.

Each follows the camera from frame to frame with the functions of OpenCV, without any odometry or
map, from the image and the ranges of each view: `RangeView.inverse_depths` at the features, as
localization has them, or the dense range image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.localization.fiducials.range_view import RangeView

Motion = Callable[[RangeView, RangeView], np.ndarray | None]
"""T_after_before of two views, shape (4, 4); None where it cannot be told."""


class Followed(NamedTuple):
    """A camera that was followed.

    Attributes:
        stamps: of the views [ns].
        poses: T_first_camera of each, shape (N, 4, 4).
        failures: views whose motion was taken to be that of the view before.
        covariances: of the poses: position, then rotation, in the first camera's frame, shape
            (N, 6, 6) [m^2, m rad, rad^2]; None for a method that has none.
    """

    stamps: list[int]
    poses: np.ndarray
    failures: int
    covariances: np.ndarray | None = None


_FEATURES = 1000
_LEAST_INLIERS = 8
_LEAST_SIGMAS = 3.0  # of 1/z that a point must have for its place to be used
# Of Lucas and Kanade; OpenCV has 3 levels by default.
_SEARCH = {"winSize": (21, 21), "maxLevel": 5, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
_THERE_AND_BACK = 1.0  # of a corner followed to the other image and back [px]


def points_at(view: RangeView, pixels: np.ndarray) -> np.ndarray:
    """Points in the camera's frame, shape (N, 3) [m]; NaN where the range is not known."""
    inverse, sigma = view.inverse_depths(pixels)
    inverse = np.where(inverse > _LEAST_SIGMAS * sigma, inverse, np.nan)
    camera = view.camera
    rays = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.column_stack([rays, np.ones(len(rays))]) / inverse[:, None]


def follow_corners(
    before: RangeView, after: RangeView, corners: np.ndarray, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels in the second image, shape (N, 2), and which were found there, and back again.

    The search begins at the guess, shape (N, 2) [px].
    """
    if len(corners) == 0:
        return corners, np.zeros(0, bool)
    start, begin = (np.float32(each).reshape(-1, 1, 2) for each in (corners, guess))
    follow, images = cv2.calcOpticalFlowPyrLK, (before.image, after.image)
    moved, found, _ = follow(*images, start, begin.copy(), **_SEARCH)
    back, again, _ = follow(*images[::-1], moved, moved + start - begin, **_SEARCH)
    near = np.linalg.norm(back - start, axis=2) < _THERE_AND_BACK
    return moved.reshape(-1, 2).astype(np.float64), (near & (found == 1) & (again == 1)).ravel()


def motion_of_points(
    points: np.ndarray, pixels: np.ndarray, camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """T_camera_points, shape (4, 4), by PnP-RANSAC, and the indices of its inliers; None without.

    Points that are NaN are left out.
    """
    kept = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(kept) < _LEAST_INLIERS:
        return None
    points, pixels = points[kept], pixels[kept].astype(np.float64)
    good, turn, shift, inliers = cv2.solvePnPRansac(
        points, pixels, camera, None, reprojectionError=2.0, iterationsCount=300, confidence=0.999
    )
    if not good or inliers is None or len(inliers) < _LEAST_INLIERS:
        return None
    chosen = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(points[chosen], pixels[chosen], camera, None, turn, shift)
    return make_transform(cv2.Rodrigues(turn)[0], shift.ravel()), kept[chosen]


def orb_pnp(before: RangeView, after: RangeView) -> np.ndarray | None:
    """ORB features of both images, the range of the first, PnP-RANSAC refined on its inliers."""
    orb = cv2.ORB.create(nfeatures=_FEATURES)
    points, descriptors = orb.detectAndCompute(before.image, None)
    pixels, others = orb.detectAndCompute(after.image, None)
    if descriptors is None or others is None:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(descriptors, others)
    first = np.array([points[m.queryIdx].pt for m in matches]).reshape(-1, 2)
    second = np.array([pixels[m.trainIdx].pt for m in matches]).reshape(-1, 2)
    found = motion_of_points(points_at(before, first), second, before.camera.matrix)
    return None if found is None else found[0]


def klt_pnp(before: RangeView, after: RangeView) -> np.ndarray | None:
    """Corners followed by pyramidal Lucas-Kanade, the range of the first, PnP-RANSAC."""
    corners = cv2.goodFeaturesToTrack(before.image, _FEATURES, 0.01, 8)
    if corners is None:
        return None
    corners = corners.reshape(-1, 2).astype(np.float64)
    moved, kept = follow_corners(before, after, corners, corners)
    points = points_at(before, corners[kept])
    found = motion_of_points(points, moved[kept], before.camera.matrix)
    return None if found is None else found[0]


def rgbd_odometry(before: RangeView, after: RangeView) -> np.ndarray | None:
    """OpenCV's dense odometry on brightness and depth (cv2.Odometry, RGB_DEPTH)."""
    settings = cv2.OdometrySettings()
    settings.setCameraMatrix(before.camera.matrix.astype(np.float32))
    settings.setMaxTranslation(0.5)
    settings.setMaxRotation(30.0)
    odometry = cv2.Odometry(cv2.OdometryType_RGB_DEPTH, settings, cv2.OdometryAlgoType_COMMON)
    frames = [
        cv2.OdometryFrame(
            depth=view.cloud().range_image.copy(),
            image=cv2.cvtColor(view.image, cv2.COLOR_GRAY2BGR),
        )
        for view in (before, after)
    ]
    try:
        odometry.prepareFrames(*frames)
        good, motion = odometry.compute(*frames)
    except cv2.error:
        return None
    return np.asarray(motion, np.float64) if good else None


def follow(views: Iterable[RangeView], motion: Motion) -> Followed:
    """Add up the motion of all views.

    Where the motion of two views is not found, it is taken to be that of the two before.
    """
    stamps: list[int] = []
    poses, step = [np.eye(4)], np.eye(4)
    failures, last = 0, None
    for view in views:
        stamps.append(view.stamp)
        if last is not None:
            T_after_before = motion(last, view)
            failures += T_after_before is None
            step = step if T_after_before is None else invert_transform(T_after_before)
            poses.append(poses[-1] @ step)
        last = view
    return Followed(stamps, np.array(poses), failures)


BASELINES: dict[str, Callable[[Iterable[RangeView]], Followed]] = {
    "orb_pnp": partial(follow, motion=orb_pnp),
    "klt_pnp": partial(follow, motion=klt_pnp),
    "rgbd_odometry": partial(follow, motion=rgbd_odometry),
}
