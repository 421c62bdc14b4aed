"""Fiducials as rows of a ``sensor_msgs/PointCloud2``; tags that another node detects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import MalformedMessageError
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.messages.clouds import POINT_CLOUD
from infomap_ros.messages.fields import MessageFields, MessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows

if TYPE_CHECKING:
    from infomap_ros.localization.target.tag_detection import TagDetectionsRecord

FIDUCIAL_ROW = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("id", "<i4"),
        ("sigma", "<f4"),
        *((f"cov_{name}", "<f4") for name in ("xx", "xy", "xz", "yy", "yz", "zz")),
    ]
)
"""A fiducial: position [m], id, largest standard deviation [m] and covariance [m^2]."""

_COVARIANCE = [name for name in FIDUCIAL_ROW.names or () if name.startswith("cov_")]
_UPPER_3 = np.triu_indices(3)
_ROUNDING = 1e-6  # of a float32 eigenvalue, as a share of the largest


def fiducial_rows(fiducials: Fiducials) -> NDArray[np.void]:
    """Fiducials as rows of `FIDUCIAL_ROW`, shape (N,)."""
    rows = np.zeros(len(fiducials), FIDUCIAL_ROW)
    rows["x"], rows["y"], rows["z"] = fiducials.positions.T
    rows["id"] = fiducials.ids
    if len(rows):
        rows["sigma"] = np.sqrt(np.linalg.eigvalsh(fiducials.covariances)[:, -1])
    for name, i, j in zip(_COVARIANCE, *_UPPER_3, strict=True):
        rows[name] = fiducials.covariances[:, i, j]
    return rows


def encode_fiducials(types: MessageTypes, stamp: int, frame_id: str, fiducials: Fiducials) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` of fiducials as they are known at `stamp` [ns]."""
    return encode_rows(types, stamp, frame_id, fiducial_rows(fiducials))


def decode_fiducials(message: object) -> tuple[int, str, Fiducials]:
    """Read rows of `FIDUCIAL_ROW`.

    Returns:
        Stamp [ns], frame, and the fiducials.

    Raises:
        MalformedMessageError: it has other fields, a number is not finite, an id is there twice,
            or a covariance is not positive.
    """
    stamp, frame_id, rows = decode_rows(message)
    if rows.dtype != FIDUCIAL_ROW:
        raise MalformedMessageError(POINT_CLOUD, "does not hold fiducials")
    if not all(np.isfinite(rows[name]).all() for name in ("x", "y", "z", *_COVARIANCE)):
        raise MalformedMessageError(POINT_CLOUD, "holds a fiducial with NaN or infinity")
    positions = np.column_stack([rows[name] for name in "xyz"]).astype(np.float64)
    covariances = np.empty((len(rows), 3, 3))
    for name, i, j in zip(_COVARIANCE, *_UPPER_3, strict=True):
        covariances[:, i, j] = covariances[:, j, i] = rows[name]
    if len(np.unique(rows["id"])) < len(rows):
        raise MalformedMessageError(POINT_CLOUD, "holds a fiducial twice")
    variances = np.linalg.eigvalsh(covariances)
    if len(rows) and not (variances[:, 0] > -_ROUNDING * variances[:, 2]).all():
        raise MalformedMessageError(POINT_CLOUD, "holds a covariance that is not positive")
    return stamp, frame_id, Fiducials(rows["id"].astype(np.int64), positions, covariances)


TAG_DETECTIONS = "apriltag_msgs/msg/AprilTagDetectionArray"
# AprilTag gives bottom left, bottom right, top right, top left of prints that stand upside down in
# OpenCV's dictionaries, with the center of the first pixel at (0.5, 0.5).
_APRILTAG_CORNERS, _APRILTAG_CENTER = [1, 0, 3, 2], 0.5


def decode_tag_detections(message: object) -> TagDetectionsRecord:
    """Read an ``apriltag_msgs/AprilTagDetectionArray``.

    Raises:
        MalformedMessageError: a tag has not four corners, or a number is not finite.
    """
    # Nodes that read fiducials only do not load what finds tags.
    from infomap_ros.localization.target.tag_detection import TAG, TagDetectionsRecord

    fields, rows = MessageFields(message, TAG_DETECTIONS), []
    for tag in fields.children("detections"):
        quad = np.array([(p.number("x"), p.number("y")) for p in tag.children("corners")])
        if quad.shape != (4, 2):
            fields.fail(f"{tag.path}corners are not four")
        corners = quad[_APRILTAG_CORNERS] - _APRILTAG_CENTER
        known = tag.name("family"), tag.integer("id"), tag.integer("hamming")
        rows.append((*known, tag.number("decision_margin"), corners))
    return TagDetectionsRecord(*fields.header(), np.array(rows, TAG))
