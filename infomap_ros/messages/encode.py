"""Records and arrays into messages.

Every function takes first the `MessageTypes` that make the objects, so the same code serves bags
and live topics.

What nodes compute and publish, into messages: disparity, occupancy grid, octree, clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.camera import StereoRig
from infomap_ros.geometry.records import (
    CameraInfoRecord,
    ImageRecord,
    ImuRecord,
    JointStateRecord,
    OdometryRecord,
    PointCloudRecord,
    PoseRecord,
    Record,
    TextRecord,
    TransformRecord,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.clouds import POINT_CLOUD, encode_point_cloud
from infomap_ros.messages.fields import (
    MessageTypes,
    make_header,
    make_pose,
    make_quaternion,
    make_region,
    make_time,
    make_vector,
)
from infomap_ros.messages.images import CAMERA_INFO, IMAGE, pixel_layout
from infomap_ros.messages.poses import (
    ABSENT,
    IMU,
    JOINT_STATE,
    ODOMETRY,
    POSE_WITH_COVARIANCE,
    STRING,
    TF,
    TRANSFORM,
)


def encode_image(types: MessageTypes, record: ImageRecord) -> Any:
    """Build a ``sensor_msgs/Image``.

    Raises:
        InvalidInputError: the pixels do not fit the encoding.
    """
    layout, pixels = pixel_layout(record.encoding), np.asarray(record.pixels)
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if layout is None or layout != (pixels.dtype.str[1:], channels) or pixels.ndim not in (2, 3):
        raise InvalidInputError(
            "image", f"{pixels.dtype} of shape {pixels.shape} is not '{record.encoding}'"
        )
    content = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("<"))
    return types.make(
        IMAGE,
        header=make_header(types, record.stamp, record.frame_id),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=record.encoding,
        is_bigendian=0,
        step=pixels.shape[1] * channels * pixels.dtype.itemsize,
        data=content.reshape(-1).view(np.uint8),
    )


def encode_camera_info(types: MessageTypes, record: CameraInfoRecord) -> Any:
    """Build a ``sensor_msgs/CameraInfo``."""
    calibration = record.calibration
    return types.make(
        CAMERA_INFO,
        header=make_header(types, record.stamp, record.frame_id),
        height=calibration.height,
        width=calibration.width,
        distortion_model=calibration.distortion_model,
        d=calibration.distortion,
        k=calibration.intrinsics.reshape(-1),
        r=calibration.rectification.reshape(-1),
        p=calibration.projection.reshape(-1),
        binning_x=0,
        binning_y=0,
        roi=make_region(types, 0, 0, 0, 0),
    )


def encode_pose(types: MessageTypes, record: PoseRecord) -> Any:
    """Build a ``geometry_msgs/PoseWithCovarianceStamped``; unknown covariance is zeros in ROS."""
    return types.make(
        POSE_WITH_COVARIANCE,
        header=make_header(types, record.stamp, record.frame_id),
        pose=_pose_with_covariance(types, record),
    )


def encode_odometry(types: MessageTypes, record: OdometryRecord) -> Any:
    """Build a ``nav_msgs/Odometry``; an unknown twist is zeros."""
    velocity = np.zeros(6) if record.twist is None else np.asarray(record.twist, dtype=np.float64)
    twist = types.make(
        "geometry_msgs/msg/Twist",
        linear=make_vector(types, velocity[:3]),
        angular=make_vector(types, velocity[3:]),
    )
    return types.make(
        ODOMETRY,
        header=make_header(types, record.stamp, record.frame_id),
        child_frame_id=record.child_frame_id,
        pose=_pose_with_covariance(types, record),
        twist=types.make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=twist,
            covariance=_flat_covariance(record.twist_covariance),
        ),
    )


def encode_joint_state(types: MessageTypes, record: JointStateRecord) -> Any:
    """Build a ``sensor_msgs/JointState``."""
    velocities = np.zeros(0) if record.velocities is None else record.velocities
    return types.make(
        JOINT_STATE,
        header=make_header(types, record.stamp, record.frame_id),
        name=list(record.names),
        position=np.array(record.positions, dtype=np.float64),
        velocity=np.array(velocities, dtype=np.float64),
        effort=np.zeros(0),
    )


def encode_imu(types: MessageTypes, record: ImuRecord) -> Any:
    """Build a ``sensor_msgs/Imu`` without an orientation; what is not known is marked so."""
    absent = np.array([ABSENT, *np.zeros(8)])
    force = np.zeros(3) if record.acceleration is None else record.acceleration
    return types.make(
        IMU,
        header=make_header(types, record.stamp, record.frame_id),
        orientation=make_quaternion(types, np.eye(4)),
        orientation_covariance=absent,
        angular_velocity=make_vector(types, record.angular_velocity),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=make_vector(types, force),
        linear_acceleration_covariance=absent if record.acceleration is None else np.zeros(9),
    )


def encode_transforms(types: MessageTypes, records: Sequence[TransformRecord]) -> Any:
    """Build a ``tf2_msgs/TFMessage``."""
    transforms = [
        types.make(
            TRANSFORM,
            header=make_header(types, record.stamp, record.frame_id),
            child_frame_id=record.child_frame_id,
            transform=types.make(
                "geometry_msgs/msg/Transform",
                translation=make_vector(types, record.transform[:3, 3]),
                rotation=make_quaternion(types, record.transform),
            ),
        )
        for record in records
    ]
    return types.make(TF, transforms=transforms)


def encode_text(types: MessageTypes, record: TextRecord) -> Any:
    """Build a ``std_msgs/String``."""
    return types.make(STRING, data=record.text)


_ENCODERS: dict[type[Record], tuple[str, Callable[[MessageTypes, Any], Any]]] = {
    ImageRecord: (IMAGE, encode_image),
    CameraInfoRecord: (CAMERA_INFO, encode_camera_info),
    PointCloudRecord: (POINT_CLOUD, encode_point_cloud),
    OdometryRecord: (ODOMETRY, encode_odometry),
    PoseRecord: (POSE_WITH_COVARIANCE, encode_pose),
    JointStateRecord: (JOINT_STATE, encode_joint_state),
    ImuRecord: (IMU, encode_imu),
    TransformRecord: (TF, lambda types, record: encode_transforms(types, [record])),
    TextRecord: (STRING, encode_text),
}


def message_type_of(record: Record) -> str:
    """ROS type name of the message that `encode` makes of a record."""
    return _encoder(record)[0]


def encode(types: MessageTypes, record: Record) -> Any:
    """Build the message that carries a record.

    Raises:
        InvalidInputError: the record's content contradicts itself, or it has no message.
    """
    return _encoder(record)[1](types, record)


def _encoder(record: Record) -> tuple[str, Callable[[MessageTypes, Any], Any]]:
    encoder = _ENCODERS.get(type(record))
    if encoder is None:
        raise InvalidInputError("record", f"{type(record).__name__} has no message type")
    return encoder


def _flat_covariance(covariance: FloatArray | None) -> FloatArray:
    return (
        np.zeros(36) if covariance is None else np.array(covariance, dtype=np.float64).reshape(36)
    )


def _pose_with_covariance(types: MessageTypes, record: PoseRecord) -> Any:
    return types.make(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=make_pose(types, record.transform),
        covariance=_flat_covariance(record.covariance),
    )


OCTOMAP = "octomap_msgs/msg/Octomap"


def encode_clock(types: MessageTypes, stamp: int) -> Any:
    """Build a ``rosgraph_msgs/Clock``; stamp [ns]."""
    return types.make("rosgraph_msgs/msg/Clock", clock=make_time(types, stamp))


def encode_disparity(
    types: MessageTypes,
    stamp: int,
    frame_id: str,
    disparity: ArrayLike,
    rig: StereoRig,
    disparity_range: tuple[float, float],
    resolution: float = 1.0 / 16.0,
) -> Any:
    """Build a ``stereo_msgs/DisparityImage``.

    The message wants disparities for which ``depth = f * T / d``, so `principal_offset` is added.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: left optical frame.
        disparity: ``u_left - u_right``, shape (H, W) [px]; NaN where not measured.
        rig: the rectified rig.
        disparity_range: smallest and largest disparity that was searched [px].
        resolution: smallest step of disparity [px].

    Raises:
        InvalidInputError: the disparity is not two-dimensional.
    """
    values = np.asarray(disparity, dtype=np.float32)
    if values.ndim != 2:
        raise InvalidInputError("disparity", f"shape {values.shape}, expected (H, W)")
    shifted = values + np.float32(rig.principal_offset)
    return types.make(
        "stereo_msgs/msg/DisparityImage",
        header=make_header(types, stamp, frame_id),
        image=encode_image(types, ImageRecord(stamp, frame_id, shifted, "32FC1")),
        f=float(rig.left.fx),
        t=float(rig.baseline),
        valid_window=make_region(types, 0, 0, values.shape[1], values.shape[0]),
        min_disparity=float(disparity_range[0] + rig.principal_offset),
        max_disparity=float(disparity_range[1] + rig.principal_offset),
        delta_d=float(resolution),
    )


def encode_octomap(
    types: MessageTypes, stamp: int, frame_id: str, resolution: float, data: bytes, *, binary: bool
) -> Any:
    """Build an ``octomap_msgs/Octomap`` of an OcTree.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: frame of the tree.
        resolution: edge of a voxel [m].
        data: the tree as OctoMap stores it, without a file's header.
        binary: whether it tells free and occupied only, as a .bt file does.
    """
    return types.make(
        OCTOMAP,
        header=make_header(types, stamp, frame_id),
        binary=binary,
        id="OcTree",
        resolution=float(resolution),
        data=np.frombuffer(data, np.int8),
    )


def encode_occupancy_grid(
    types: MessageTypes,
    stamp: int,
    frame_id: str,
    cells: NDArray[np.int8],
    resolution: float,
    origin: tuple[float, float],
) -> Any:
    """Build a ``nav_msgs/OccupancyGrid``.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: frame of the grid.
        cells: shape (rows along y, columns along x), -1 unknown, 0 free to 100 occupied.
        resolution: edge of a cell [m].
        origin: x, y of the corner of cell (0, 0) [m].

    Raises:
        InvalidInputError: the cells are not two-dimensional.
    """
    if cells.ndim != 2:
        raise InvalidInputError("cells", f"shape {cells.shape}, expected (rows, columns)")
    corner = np.eye(4)
    corner[:2, 3] = origin
    info = types.make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=make_time(types, stamp),
        resolution=float(resolution),
        width=cells.shape[1],
        height=cells.shape[0],
        origin=make_pose(types, corner),
    )
    return types.make(
        "nav_msgs/msg/OccupancyGrid",
        header=make_header(types, stamp, frame_id),
        info=info,
        data=np.ascontiguousarray(cells, dtype=np.int8).reshape(-1),
    )
