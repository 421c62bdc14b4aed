"""Folders of RGB-D frames with a pose each: colour, depth in mm, camera-to-world matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    PinholeCamera,
    PoseRecord,
    check_transform,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.replay.sequences.entries import (
    FIRST_STAMP,
    Entries,
    image_record,
    pinhole_calibration,
    read_image,
    read_text_table,
)
from infomap_ros.replay.sequences.registration import ColorCamera, register_depth

_FRAME = "camera_optical_frame"
_PERIOD = 1e9 / 30.0  # recorded at 30 Hz; the file names count the frames of the recording [ns]

# Of the tracking that gave the poses: they come from aligning each frame to a dense model.
_POSITION_SIGMA, _ROTATION_SIGMA = 0.005, 0.002  # assumed [m, rad]

# Direction of gravity and depth of the floor in the kitchen's own frame, from planes fitted to
# floor and table in six frames.
_KITCHEN_DOWN, _KITCHEN_FLOOR = (0.0, 0.893, 0.450), 1.53


# The kitchen's colour camera: its images are not registered to the depth images, so that a pixel's
# depth is up to 35 px away. Found by laying the depth edges of 50 frames onto the edges of their
# colour images (117,000 pixels; two halves of them agree within 0.3 px and 1 mm).
_KITCHEN_COLOR = ColorCamera(
    PinholeCamera(640, 480, 526.2, 526.2, 322.1, 235.9), (-0.0304, 0.0065, 0.0)
)

_COVARIANCE = np.diag([_POSITION_SIGMA**2] * 3 + [_ROTATION_SIGMA**2] * 3)


def kitchen(folder: Path) -> Entries:
    """The kitchen sequence, turned so that z is up and the floor is at z = 0; see `rgbd_frames`.

    Depth is registered to the colour image, and the poses are those of the colour camera.
    """
    return rgbd_frames(folder, _KITCHEN_DOWN, _KITCHEN_FLOOR, _KITCHEN_COLOR)


def rgbd_frames(
    folder: Path,
    down: tuple[float, float, float] = (0.0, 1.0, 0.0),
    floor: float = 0.0,
    color: ColorCamera | None = None,
) -> Entries:
    """Read ``frames/frame-NNNNNN.{color.jpg,depth.png,pose.txt}`` and ``camera-intrinsics.txt``.

    Frames whose pose is not a rigid transform (lost tracking) are left out.

    Args:
        folder: of the sequence.
        down: direction of gravity in the frame of the poses.
        floor: how far below its origin the map's z = 0 is to be [m].
        color: the colour camera, where depth has to be registered to it.

    Raises:
        BagError: a file is missing or holds something else.
    """
    intrinsics = read_text_table(folder / "camera-intrinsics.txt")
    pose_files = sorted((folder / "frames").glob("frame-*.pose.txt"))
    if not pose_files:
        raise BagError(f"{folder} has no frames/frame-*.pose.txt")
    T_map_world = _levelled(down, floor)
    for pose_file in pose_files:
        name = pose_file.name.removesuffix(".pose.txt")
        stamp = FIRST_STAMP + round(int(name.rpartition("-")[2]) * _PERIOD)
        yield from _frame(folder / "frames" / name, stamp, intrinsics, T_map_world, color)


def _levelled(down: tuple[float, float, float], floor: float) -> FloatArray:
    """Transform to a frame with z up whose x axis runs level along the old z axis, (4, 4)."""
    up = -np.asarray(down) / np.linalg.norm(down)
    left = np.cross(up, [0.0, 0.0, 1.0])
    left /= np.linalg.norm(left)
    return make_transform([np.cross(left, up), left, up], [0.0, 0.0, floor])


def _frame(
    stem: Path,
    stamp: int,
    intrinsics: FloatArray,
    T_map_world: FloatArray,
    color_camera: ColorCamera | None,
) -> Entries:
    pose_file = stem.with_name(f"{stem.name}.pose.txt")
    depth = read_image(stem.with_name(f"{stem.name}.depth.png")).astype(np.uint16)
    color = read_image(stem.with_name(f"{stem.name}.color.jpg"))
    try:
        pose = check_transform(_orthonormal(read_text_table(pose_file)), pose_file.name)
    except InvalidInputError:
        return
    height, width = depth.shape
    camera = PinholeCamera(
        width, height, intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    )
    if color_camera is not None:
        depth = register_depth(depth, camera, color_camera)
        camera, pose = color_camera.camera, pose @ color_camera.T_depth_color
    info = CameraInfoRecord(stamp, _FRAME, pinhole_calibration(camera))
    yield "/depth/camera_info", info
    yield "/rgb/camera_info", info
    yield "/camera_pose", PoseRecord(stamp, "map", T_map_world @ pose, _COVARIANCE)
    yield "/rgb/image_rect", image_record(stamp, _FRAME, color)
    yield "/depth/image_rect", ImageRecord(stamp, _FRAME, depth, "16UC1")


def _orthonormal(matrix: FloatArray) -> FloatArray:
    """The transform with its rotation, rounded in the file, made exact."""
    pose = np.array(matrix, dtype=np.float64)
    if np.isfinite(pose).all() and pose.shape == (4, 4):
        left, _, right = np.linalg.svd(pose[:3, :3])
        nearest = left @ right
        if np.allclose(nearest, pose[:3, :3], atol=1e-3):
            pose[:3, :3] = nearest
    return pose
