"""Raw fisheye pairs with a Kalibr calibration and motion capture, as TUM-VI has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from infomap_ros.errors import BagError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    PoseRecord,
    check_transform,
    invert_transform,
    make_transform,
    transform_from_quaternion,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.replay.sequences.entries import (
    LEFT_FRAME,
    RIGHT_FRAME,
    Entries,
    image_record,
    read_image,
    read_text_table,
)
from infomap_ros.stereo.rectification import rectify_calibrations

# A pinhole image cannot show the whole fisheye image: as large as the raw image, at this share of
# its focal length, it shows 107 degrees and keeps most of the resolution in the middle.
_FOCAL_SHARE = 1.0

# Of the camera's pose: motion capture and the calibration of camera and markers, assumed [m, rad].
_POSITION_SIGMA, _ROTATION_SIGMA = 0.003, 0.002
_COVARIANCE = np.diag([_POSITION_SIGMA**2] * 3 + [_ROTATION_SIGMA**2] * 3)


def kalibr_pairs(folder: Path) -> Entries:
    """Read ``cam0/``, ``cam1/``, ``camchain.yaml`` and the ground truth ``gt_imu_*.csv``.

    Poses are those of the rectified left camera, in whose frame ranges are measured. They are
    given as often as the ground truth, because the images lie between its stamps.

    Raises:
        BagError: a file is missing or holds something else.
    """
    chain = _read_chain(folder / "camchain.yaml")
    T_left_imu = check_transform(chain["cam0"]["T_cam_imu"], "T_cam_imu")
    T_right_left = check_transform(chain["cam1"]["T_cn_cnm1"], "T_cn_cnm1")
    left, right = rectify_calibrations(
        _raw_calibration(chain["cam0"]),
        _raw_calibration(chain["cam1"]),
        T_right_left,
        focal_length=_FOCAL_SHARE * chain["cam0"]["intrinsics"][0],
    )
    T_rectified_imu = make_transform(left.rectification, [0.0, 0.0, 0.0]) @ T_left_imu
    T_imu_rectified = invert_transform(T_rectified_imu)
    yield from _poses(folder, T_imu_rectified)
    for path in sorted((folder / "cam0").glob("*.png")):
        stamp = int(path.stem)
        pixels = read_image(path), read_image(folder / "cam1" / path.name)
        yield "/left/camera_info", CameraInfoRecord(stamp, LEFT_FRAME, left)
        yield "/right/camera_info", CameraInfoRecord(stamp, RIGHT_FRAME, right)
        yield "/left/image_raw", image_record(stamp, LEFT_FRAME, pixels[0])
        yield "/right/image_raw", image_record(stamp, RIGHT_FRAME, pixels[1])


def _read_chain(path: Path) -> dict[str, Any]:
    try:
        chain = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError) as error:
        raise BagError(f"{path} cannot be read: {error}") from error
    for camera in ("cam0", "cam1"):
        if not isinstance(chain, dict) or camera not in chain:
            raise BagError(f"{path} describes no camera {camera}")
        if chain[camera]["distortion_model"] != "equidistant":
            raise BagError(f"{path}: only equidistant cameras are read")
    return chain


def _raw_calibration(camera: dict[str, Any]) -> CameraCalibration:
    fx, fy, cx, cy = camera["intrinsics"]
    width, height = camera["resolution"]
    return CameraCalibration(
        width=width,
        height=height,
        distortion_model="equidistant",
        distortion=np.array(camera["distortion_coeffs"]),
        intrinsics=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
    )


def _poses(folder: Path, T_imu_camera: FloatArray) -> Entries:
    files = sorted(folder.glob("gt_imu*.csv"))
    if not files:
        raise BagError(f"{folder} has no ground truth gt_imu*.csv")
    stamps = read_text_table(files[0], delimiter=",", usecols=0, dtype=np.int64)
    values = read_text_table(files[0], delimiter=",", usecols=range(1, 8))
    for stamp, (x, y, z, qw, qx, qy, qz) in zip(stamps, values, strict=True):
        quaternion = Rotation.from_quat([qx, qy, qz, qw]).as_quat()
        T_world_imu = transform_from_quaternion(quaternion, [x, y, z])
        yield "/camera_pose", PoseRecord(int(stamp), "map", T_world_imu @ T_imu_camera, _COVARIANCE)
