"""Rigid transforms, cameras, simple solids, and data with its stamp and frame."""

from infomap_ros.geometry.camera import (
    CameraCalibration,
    PinholeCamera,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import (
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PointCloudRecord,
    PoseRecord,
    Record,
    TextRecord,
    TransformRecord,
)
from infomap_ros.geometry.solids import (
    Box,
    ConvexPolytope,
    Cylinder,
    PlacedSolid,
    Solid,
    Sphere,
    points_inside,
)
from infomap_ros.geometry.transforms import (
    check_covariance,
    check_transform,
    interpolate_transforms,
    invert_transform,
    make_transform,
    perturb_transform,
    quaternion_from_transform,
    skew,
    transform_from_quaternion,
    transform_points,
)
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig

__all__ = [
    "Box",
    "CameraCalibration",
    "CameraInfoRecord",
    "ConvexPolytope",
    "Cylinder",
    "ImageRecord",
    "JointStateRecord",
    "OdometryRecord",
    "PinholeCamera",
    "PlacedSolid",
    "PointCloudRecord",
    "PoseBuffer",
    "PoseBufferConfig",
    "PoseRecord",
    "Record",
    "Solid",
    "Sphere",
    "StereoRig",
    "TextRecord",
    "TransformRecord",
    "WaitingQueue",
    "WaitingQueueConfig",
    "check_covariance",
    "check_transform",
    "interpolate_transforms",
    "invert_transform",
    "make_transform",
    "perturb_transform",
    "points_inside",
    "quaternion_from_transform",
    "rig_from_calibrations",
    "skew",
    "transform_from_quaternion",
    "transform_points",
]
