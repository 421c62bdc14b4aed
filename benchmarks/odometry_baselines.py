"""Visual odometry that one writes in an afternoon: what localization is compared with.

Each follows the camera from frame to frame with the functions of OpenCV, from the image and the
dense range image of each view, without any odometry or map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.localization.fiducials.range_view import RangeView

Motion = Callable[[RangeView, RangeView], np.ndarray | None]
"""T_after_before of two views, shape (4, 4); None where it cannot be told."""

_FEATURES = 1000
_LEAST_INLIERS = 8


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
    return _motion_of_matches(before, first, second)


def klt_pnp(before: RangeView, after: RangeView) -> np.ndarray | None:
    """Corners followed by pyramidal Lucas-Kanade, the range of the first, PnP-RANSAC."""
    corners = cv2.goodFeaturesToTrack(before.image, _FEATURES, 0.01, 8)
    if corners is None:
        return None
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before.image, after.image, corners, None)
    kept = found.ravel() == 1
    return _motion_of_matches(before, corners[kept].reshape(-1, 2), moved[kept].reshape(-1, 2))


def _motion_of_matches(
    before: RangeView, first: np.ndarray, second: np.ndarray
) -> np.ndarray | None:
    columns, rows = np.rint(first).astype(int).T
    points = before.cloud().organized_points[rows, columns].astype(np.float64)
    kept = np.isfinite(points).all(axis=1)
    if kept.sum() < _LEAST_INLIERS:
        return None
    points, second, camera = points[kept], second[kept], before.camera.matrix
    good, turn, shift, inliers = cv2.solvePnPRansac(
        points, second, camera, None, reprojectionError=2.0, iterationsCount=300, confidence=0.999
    )
    if not good or inliers is None or len(inliers) < _LEAST_INLIERS:
        return None
    chosen = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(points[chosen], second[chosen], camera, None, turn, shift)
    return make_transform(cv2.Rodrigues(turn)[0], shift.ravel())


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


BASELINES: dict[str, Motion] = {
    "orb_pnp": orb_pnp,
    "klt_pnp": klt_pnp,
    "rgbd_odometry": rgbd_odometry,
}


def follow(views: Iterable[RangeView], motion: Motion) -> tuple[list[int], np.ndarray, int]:
    """Add up the motion of all views.

    Where the motion of two views cannot be told, the camera is taken to stand still.

    Returns:
        Stamps [ns], T_first_camera of each, shape (N, 4, 4), and how often it could not be told.
    """
    stamps: list[int] = []
    poses = [np.eye(4)]
    failures, last = 0, None
    for view in views:
        stamps.append(view.stamp)
        if last is not None:
            T_after_before = motion(last, view)
            failures += T_after_before is None
            step = np.eye(4) if T_after_before is None else invert_transform(T_after_before)
            poses.append(poses[-1] @ step)
        last = view
    return stamps, np.array(poses), failures
