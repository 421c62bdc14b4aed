"""Single rectified pairs with published calibrations, and a rover's pairs with an assumed one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import BagError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    PinholeCamera,
    PoseRecord,
    StereoRig,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.replay.sequences.entries import (
    FIRST_STAMP,
    LEFT_FRAME,
    RIGHT_FRAME,
    Entries,
    image_record,
    pinhole_calibration,
    read_image,
    read_text_table,
    rectified_pair,
)

_MOTORCYCLE_TILT = 15.2  # of the camera, downwards, from a plane fitted to the floor [deg]
_EXACT = np.diag([1e-12] * 6)  # the pose of the only pair defines the map
_CENTIMETRE = np.diag([1e-4] * 3 + [1e-4] * 3)


def motorcycle(folder: Path) -> Entries:
    """Middlebury 2014 "Motorcycle" at a quarter of its size.

    Scharstein et al., GCPR 2014, DOI 10.1007/978-3-319-11752-2_3.

    Raises:
        BagError: an image is missing.
    """
    left = read_image(folder / "motorcycle_left.png")
    right = read_image(folder / "motorcycle_right.png")
    height, width = left.shape[:2]
    rig = StereoRig(
        PinholeCamera(width, height, 994.978, 994.978, 311.193, 254.877),
        PinholeCamera(width, height, 994.978, 994.978, 311.193 + 31.086, 254.877),
        baseline=0.193001,
    )
    yield from _single_pair(rig, left, right, _MOTORCYCLE_TILT)


def aloe(folder: Path) -> Entries:
    """Middlebury 2006 "Aloe" at full size.

    The collection states focal length (3740 px) and baseline (0.16 m); the images are cropped by
    270 px against each other.

    Raises:
        BagError: an image is missing.
    """
    left, right = read_image(folder / "aloeL.jpg"), read_image(folder / "aloeR.jpg")
    height, width = left.shape[:2]
    centre = (width - 1) / 2.0, (height - 1) / 2.0
    rig = StereoRig(
        PinholeCamera(width, height, 3740.0, 3740.0, *centre),
        PinholeCamera(width, height, 3740.0, 3740.0, centre[0] + 270.0, centre[1]),
        baseline=0.16,
    )
    yield from _single_pair(rig, left, right)


def _single_pair(rig: StereoRig, left: np.ndarray, right: np.ndarray, tilt: float = 0.0) -> Entries:
    """The pair, seen from the origin of a map with z up and `tilt` [deg] downwards."""
    yield "/camera_pose", PoseRecord(FIRST_STAMP, "map", _looking_along_x(tilt), _EXACT)
    yield from rectified_pair(FIRST_STAMP, rig, left, right)


def rover_pairs(folder: Path) -> Entries:
    """Pairs of a small rover in a sandbox, with its path in the plane.

    The calibration is assumed: the focal length for 512 px of width, the baseline from 0.07 to
    0.10 m, and a right image 3.13 px lower than the left. Height and tilt of the camera are what
    the horizon and the path suggest. Good for robustness, not for accuracy.

    Raises:
        BagError: a file is missing or holds something else.
    """
    path = read_text_table(folder / "gt.csv", delimiter=",", skiprows=1)
    files = sorted((folder / "left").glob("frame*.png"))
    if not files:
        raise BagError(f"{folder} has no left/frame*.png")
    left, right = _assumed_rover_cameras()
    for file in files:
        index = int(file.stem.removeprefix("frame"))
        stamp = FIRST_STAMP + round(path[index, 0] * 1e9)
        pose = _rover_pose(path[:, 1:3], index)
        yield "/camera_pose", PoseRecord(stamp, "map", pose, 25.0 * _CENTIMETRE)
        images = read_image(file), read_image(folder / "right" / file.name)
        yield "/left/camera_info", CameraInfoRecord(stamp, LEFT_FRAME, left)
        yield "/right/camera_info", CameraInfoRecord(stamp, RIGHT_FRAME, right)
        yield "/left/image_raw", image_record(stamp, LEFT_FRAME, images[0])
        yield "/right/image_raw", image_record(stamp, RIGHT_FRAME, images[1])


def _assumed_rover_cameras() -> tuple[CameraCalibration, CameraCalibration]:
    camera = PinholeCamera(512, 288, 322.0, 322.0, 255.5, 143.5)
    lower = camera.matrix
    lower[1, 2] += 3.13
    right = pinhole_calibration(camera, baseline=0.085)
    shifted = CameraCalibration(
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        distortion=np.zeros(5),
        intrinsics=lower,
        projection=right.projection,
    )
    return pinhole_calibration(camera), shifted


def _rover_pose(path: FloatArray, index: int) -> FloatArray:
    """Camera 0.3 m above the plane, 17 degrees down, ahead along the path of the next metre."""
    ahead = path[min(len(path) - 1, index + 24)] - path[max(0, index - 8)]
    heading = Rotation.from_euler("z", float(np.arctan2(ahead[1], ahead[0]))).as_matrix()
    return make_transform(heading @ _looking_along_x(17.0)[:3, :3], [*path[index], 0.3])


def _looking_along_x(tilt: float) -> FloatArray:
    """Optical frame at the origin that looks along x and down by `tilt` [deg]; T_map_camera."""
    down = Rotation.from_euler("y", tilt, degrees=True).as_matrix()
    return make_transform(down @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0, 0, 0])
