"""What nodes compute and publish, into messages: disparity, occupancy grid, octree, clock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.camera import StereoRig
from infomap_ros.geometry.records import ImageRecord
from infomap_ros.messages.encode import encode_image
from infomap_ros.messages.types import MessageTypes, make_header, make_pose, make_region, make_time

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
