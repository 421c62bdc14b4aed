"""What can be wrong with the data of a live graph: checks on records, without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PoseRecord,
    Record,
    rig_from_calibrations,
)

_LEAST_MATCHES = 30
_ROW_TOLERANCE = 1.0  # [px]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        good: whether it is as it should be.
        subject: what was looked at, mostly a topic.
        text: what was found and, if it is not good, what to do.
    """

    good: bool
    subject: str
    text: str


def check_size(topic: str, image: ImageRecord, info: CameraInfoRecord) -> Finding:
    """Does the calibration fit the size of the image?"""
    height, width = image.pixels.shape[:2]
    expected = (info.calibration.width, info.calibration.height)
    if (width, height) == expected:
        return Finding(True, topic, f"{width}x{height} px, as calibrated")
    text = f"image is {width}x{height} px, calibration is for {expected[0]}x{expected[1]} px"
    return Finding(False, topic, text + ": calibrate at this size or scale the camera info")


def check_frames(topic: str, record: Record, other_topic: str, other: Record) -> Finding:
    """Do two topics that belong together name the same frame?"""
    if record.frame_id and record.frame_id == other.frame_id:
        return Finding(True, topic, f"frame '{record.frame_id}', as {other_topic}")
    text = f"frame '{record.frame_id}', but {other_topic} has '{other.frame_id}'"
    return Finding(False, topic, text + ": both must name the same optical frame")


def check_frame(topic: str, record: Record, expected: str) -> Finding:
    """Is the data in the frame in which it must be?"""
    if record.frame_id == expected:
        return Finding(True, topic, f"frame '{expected}'")
    return Finding(False, topic, f"frame '{record.frame_id}', expected '{expected}'")


def check_rig(topic: str, left: CameraCalibration, right: CameraCalibration) -> Finding:
    """Do the two calibrations make a stereo rig?"""
    try:
        rig = rig_from_calibrations(left, right)
    except CalibrationError as error:
        return Finding(False, topic, str(error))
    return Finding(True, topic, f"baseline {rig.baseline:.4f} m, focal length {rig.left.fx:.1f} px")


def check_rows(topic: str, left: ImageRecord, right: ImageRecord) -> Finding:
    """Are the rows of a pair aligned, as rectified images have them?"""
    offset = row_offset(_gray(left), _gray(right))
    if offset is None:
        return Finding(True, topic, "too little texture to tell whether rows are aligned")
    if offset <= _ROW_TOLERANCE:
        return Finding(True, topic, f"rows are aligned within {offset:.2f} px")
    text = f"rows of left and right differ by {offset:.1f} px: the images are not rectified"
    return Finding(
        False, topic, text + " (publish *_raw and start stereo_range with rectify:=true)"
    )


def check_distortion(topic: str, info: CameraInfoRecord) -> Finding:
    """Can raw images be rectified with this calibration?"""
    calibration = info.calibration
    if calibration.projection[0, 0] == 0.0 or calibration.intrinsics[0, 0] == 0.0:
        return Finding(False, topic, "is not calibrated (K or P is zero): run camera calibration")
    return Finding(True, topic, f"calibrated ({calibration.distortion_model or 'no'} distortion)")


def check_stamps(topic: str, stamps: Iterable[int], poses: Iterable[PoseRecord]) -> Finding:
    """Is there a pose at the stamps of the data?

    Args:
        topic: of the poses.
        stamps: of the data [ns].
        poses: that came meanwhile.
    """
    known = np.array(sorted(pose.stamp for pose in poses), dtype=np.int64)
    wanted = np.array(sorted(stamps), dtype=np.int64)
    if not len(known):
        return Finding(False, topic, "no pose came")
    if not len(wanted):
        return Finding(True, topic, f"{len(known)} poses, no data to compare with")
    inside = wanted[(wanted >= known[0]) & (wanted <= known[-1])]
    if not len(inside):
        gap = min(abs(float(w - k)) for w in (wanted[0], wanted[-1]) for k in (known[0], known[-1]))
        text = f"no pose at the stamps of the data, the nearest is {gap * 1e-9:.3f} s away"
        return Finding(False, topic, text + ": clocks differ, or use_sim_time is not the same")
    exact = int(np.isin(inside, known).sum())
    return Finding(True, topic, f"{exact} of {len(inside)} stamps have a pose of their own")


def row_offset(left: np.ndarray, right: np.ndarray) -> float | None:
    """Typical distance of matching features across rows.

    Args:
        left: shape (H, W), uint8.
        right: shape (H, W), uint8.

    Returns:
        Median absolute difference of rows [px]; None where too few features match.
    """
    detector = cv2.ORB.create(1000)
    points_left, words_left = detector.detectAndCompute(left, None)
    points_right, words_right = detector.detectAndCompute(right, None)
    if words_left is None or words_right is None:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(words_left, words_right)
    matches = [match for match in matches if match.distance < 40]
    if len(matches) < _LEAST_MATCHES:
        return None
    rows = [points_left[m.queryIdx].pt[1] - points_right[m.trainIdx].pt[1] for m in matches]
    return float(np.median(np.abs(rows)))


def _gray(image: ImageRecord) -> np.ndarray:
    pixels = np.asarray(image.pixels)
    if pixels.dtype != np.uint8:
        top = float(pixels.max()) or 1.0
        pixels = (pixels.astype(np.float32) * (255.0 / top)).astype(np.uint8)
    return pixels if pixels.ndim == 2 else pixels[..., :3].mean(axis=-1).astype(np.uint8)


def check_localization(name: str, values: Mapping[str, str]) -> Finding:
    """Whether the camera is located.

    Args:
        name: of the node that says so.
        values: state, reason, and how many fiducials are tracked.
    """
    state, reason = values["state"], values.get("reason", "")
    text = f"{state}, {values['fiducials tracked']} fiducials tracked"
    return Finding(state in ("tracking", "coasting"), name, f"{text}: {reason}" if reason else text)
