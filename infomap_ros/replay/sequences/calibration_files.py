"""Calibration files that people have: Kalibr, EuRoC, ROS, OpenCV, KITTI, Middlebury, plain K."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from infomap_ros.errors import CalibrationError, InfomapError
from infomap_ros.geometry import CameraCalibration, check_transform, invert_transform
from infomap_ros.geometry.camera import LONGEST_BASELINE
from infomap_ros.geometry.transforms import FloatArray, make_transform
from infomap_ros.stereo.rectification import rectify_calibrations

Size = tuple[int, int]
"""Width and height of the images [px]."""

_MODELS = {
    "radtan": "plumb_bob",
    "radial-tangential": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "kannala_brandt": "equidistant",
    "none": "plumb_bob",
    "": "plumb_bob",
}
"""Distortion models by the names that files give them."""

_CAMODOCAL = {
    "PINHOLE": ("radtan", "fx fy cx cy", "k1 k2 p1 p2"),
    "KANNALA_BRANDT": ("equidistant", "mu mv u0 v0", "k2 k3 k4 k5"),
}
"""Distortion model, and names of focal lengths with principal point and of the coefficients."""

_NEAR_EDGE = 0.3  # share of an image: of half and of double size the principal point lies beyond
_LARGEST = 10_000_000  # bytes of a calibration file
_UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    OverflowError,
    RecursionError,
    yaml.YAMLError,
    cv2.error,
)
"""What the readers raise where a file is not what it seems."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What calibration files say of one camera or two.

    Attributes:
        cameras: one, or left and right, or depth and color; with R and P where known.
        T_second_first: takes points in the first to points in the second camera frame, (4, 4);
            None where the files do not say.
        T_first_body: takes points in the body's frame, of which poses are, to the first camera's
            raw frame, shape (4, 4); None where poses are the camera's.
        is_rectified: whether the images are those of P; None where the files do not say.
    """

    cameras: tuple[CameraCalibration, ...]
    T_second_first: FloatArray | None = None
    T_first_body: FloatArray | None = None
    is_rectified: bool | None = None

    def as_pair(self, names: str) -> Calibration:
        """With R and P of both cameras of a stereo pair.

        Raises:
            CalibrationError: it is not that of a pair, or an impossible one.
        """
        if len(self.cameras) < 2:
            raise CalibrationError(f"{names} describes one camera, and the images are pairs")
        left, right = self.cameras[:2]
        if right.projection[0, 3] == 0.0:
            if self.T_second_first is None:
                raise CalibrationError(
                    f"{names} has no transform from the left to the right camera"
                )
            fisheye = left.distortion_model == "equidistant"
            focal = float(left.intrinsics[0, 0]) if fisheye else None
            left, right = rectify_calibrations(left, right, self.T_second_first, focal)
        baseline = (left.projection[0, 3] - right.projection[0, 3]) / right.projection[0, 0]
        if not 0.0 < baseline < LONGEST_BASELINE:
            raise CalibrationError(
                f"{names} has a baseline of {baseline:g} m: is it in meters, and left before right?"
            )
        return replace(self, cameras=(left, right))


def read_calibration(files: Sequence[Path], size: Size) -> Calibration:
    """Read calibration files of any of the known formats.

    Args:
        files: one, or the left and the right camera's.
        size: of the images, for formats that do not say.

    Raises:
        CalibrationError: a file cannot be read, is of no known format, or its numbers are
            impossible; names it.
    """
    parts = [_read(path, size) for path in files]
    if len(parts) == 1:
        return parts[0]
    first, second = parts[:2]
    if len(first.cameras) == 2 or len(second.cameras) == 2:  # OpenCV's intrinsics and extrinsics
        whole, other = (first, second) if len(first.cameras) == 2 else (second, first)
        T = other.T_second_first if whole.T_second_first is None else whole.T_second_first
        return replace(whole, T_second_first=T)
    T = None
    if first.T_first_body is not None and second.T_first_body is not None:
        T = second.T_first_body @ invert_transform(first.T_first_body)
    return replace(first, cameras=(first.cameras[0], second.cameras[0]), T_second_first=T)


def _read(path: Path, size: Size) -> Calibration:
    try:
        text = _text_of(path)
        if re.search(r"^(model_type|cam0_calib)\s*:", text, re.MULTILINE):
            return _camodocal(path, text)
        settings = re.search(r"^Camera1?\.fx\s*:", text, re.MULTILINE)
        if settings and not re.search(r"^LEFT\.K\s*:", text, re.MULTILINE):
            return _of_size(_orb_slam(path, text, size), size)
        if "opencv-matrix" in text or "opencv_storage" in text:
            return _of_size(_opencv(path, size), size)
        if re.search(r"^\s*cam0\s*=\s*\[", text, re.MULTILINE):
            return _of_size(_middlebury(text, size), size)
        if re.search(r"^P(_rect_0)?[0-3]:", text, re.MULTILINE) or _is_numbers(text, 12):
            return _of_size(_kitti(text, size, path), size)
        if _is_numbers(text, 3):
            matrix = np.loadtxt(path)
            return _of_size(Calibration((_pinhole(matrix, size),), is_rectified=True), size)
        plain = re.sub(r"^%YAML.*$", "", text, flags=re.MULTILINE).replace("\t", " ")
        content = yaml.safe_load(plain)
        for key, read in _YAML_READERS.items():
            if isinstance(content, dict) and key in content:
                return read(content, size)
    except InfomapError as error:
        raise CalibrationError(f"calibration {path}: {error}") from error
    except _UNREADABLE as e:
        reason = e.strerror if isinstance(e, OSError) else " ".join(str(e).split()) or repr(e)
        reason = f"it has no {reason}" if isinstance(e, KeyError) else reason
        raise CalibrationError(f"calibration {path} cannot be read: {reason}") from e
    raise CalibrationError(
        f"calibration {path} is of no known format: expected Kalibr (camchain.yaml), EuRoC "
        "(sensor.yaml), ROS (camera_info yaml), OpenCV (yml or xml), ORB-SLAM (Camera.fx), VINS "
        "(model_type), KITTI or Middlebury (calib.txt), or a 3x3 matrix"
    )


def _of_size(calibration: Calibration, size: Size) -> Calibration:
    """Refuse numbers of images of another size, where a file does not tell its own.

    Another size moves the principal point towards a corner: along both axes by one factor.
    """
    for camera in calibration.cameras:
        place = camera.intrinsics[:2, 2] / size
        is_inside = (place > 0.0).all() and (place < 1.0).all()
        near_corner = (place < _NEAR_EDGE).all() or (place > 1.0 - _NEAR_EDGE).all()
        if (camera.width, camera.height) == size and (near_corner or not is_inside):
            u, v = camera.intrinsics[:2, 2]
            raise CalibrationError(
                f"has its principal point at ({u:.0f}, {v:.0f}) px, and the images have "
                f"{size[0]}x{size[1]} px: it is that of another size (if not, give one that "
                "states the size, as ROS has it)"
            )
    return calibration


def _text_of(path: Path) -> str:
    """What stands in a file, which is a regular one of a sensible size."""
    if path.exists() and not path.is_file():
        raise CalibrationError("is no file")
    with path.open("rb") as file:
        content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:
        raise CalibrationError(f"has more than {_LARGEST} bytes")
    return content.decode("utf-8", errors="replace")


def _is_numbers(text: str, columns: int) -> bool:
    """Whether a text is a table of numbers with so many columns and up to four rows."""
    rows = [line.split() for line in text.splitlines() if line.strip()]
    try:
        return 0 < len(rows) <= 4 and all(len([*map(float, row)]) == columns for row in rows)
    except ValueError:
        return False


def _pinhole(matrix: FloatArray, size: Size, shift: float = 0.0) -> CameraCalibration:
    """A rectified camera; `shift` is P[0, 3] [px m]."""
    projection = np.zeros((3, 4))
    projection[:, :3] = matrix
    projection[0, 3] = shift
    return CameraCalibration(*size, "plumb_bob", np.zeros(5), matrix, np.eye(3), projection)


def _raw(
    intrinsics: FloatArray, distortion: Sequence[float], model: str, size: Size
) -> CameraCalibration:
    """A camera with distortion; its P is known as far as it is its own."""
    name = model.lower()
    if name not in _MODELS:
        raise CalibrationError(f"distortion model '{model}' is not known")
    numbers = np.zeros(5) if not len(distortion) else np.asarray(distortion, dtype=np.float64)
    return CameraCalibration(*size, _MODELS[name], numbers.ravel(), intrinsics)


def _matrix_of(fx: float, fy: float, cx: float, cy: float) -> FloatArray:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _kalibr(content: Mapping[str, Any], size: Size) -> Calibration:
    cameras = [content[name] for name in ("cam0", "cam1") if name in content]
    for camera in cameras:
        model = str(camera.get("camera_model", "pinhole"))
        if model != "pinhole":
            raise CalibrationError(f"camera_model '{model}' is not supported, pinhole is")
    described = tuple(
        _raw(
            _matrix_of(*camera["intrinsics"]),
            camera.get("distortion_coeffs", ()),
            camera.get("distortion_model", ""),
            tuple(camera.get("resolution", size)),
        )
        for camera in cameras
    )
    bodies = [_kalibr_body(camera) for camera in cameras]
    given = cameras[1].get("T_cn_cnm1") if len(cameras) > 1 else None
    T = None if given is None else _transform(given, "T_cn_cnm1")
    if T is None and len(bodies) > 1 and bodies[0] is not None and bodies[1] is not None:
        T = bodies[1] @ invert_transform(bodies[0])
    return Calibration(described, T, bodies[0], is_rectified=False)


def _kalibr_body(camera: Mapping[str, Any]) -> FloatArray | None:
    """T_camera_body of one camera: of Kalibr, or its inverse as OpenVINS writes it."""
    if camera.get("T_cam_imu") is not None:
        return _transform(camera["T_cam_imu"], "T_cam_imu")
    if camera.get("T_imu_cam") is not None:
        return invert_transform(_transform(camera["T_imu_cam"], "T_imu_cam"))
    return None


def _transform(numbers: Any, name: str) -> FloatArray:
    """Four rows, or sixteen numbers in a row as MSCKF-VIO has them."""
    return check_transform(np.reshape(np.asarray(numbers, dtype=np.float64), (4, 4)), name)


def _euroc(content: Mapping[str, Any], size: Size) -> Calibration:
    """One camera's ``sensor.yaml``: its pose in the body's frame is ``T_BS``."""
    camera = _raw(
        _matrix_of(*content["intrinsics"]),
        content.get("distortion_coefficients", ()),
        content.get("distortion_model", ""),
        tuple(content.get("resolution", size)),
    )
    T_body_camera = _transform(content["T_BS"]["data"], "T_BS")
    return Calibration((camera,), None, invert_transform(T_body_camera), is_rectified=False)


def _ros(content: Mapping[str, Any], size: Size) -> Calibration:
    data = {key: value["data"] for key, value in content.items() if isinstance(value, dict)}
    projection = data.get("projection_matrix", data.get("P", np.zeros(12)))
    distortion = np.array(data.get("distortion_coefficients", ()), dtype=np.float64)
    camera = CameraCalibration(
        int(content.get("image_width", size[0])),
        int(content.get("image_height", size[1])),
        _MODELS[str(content.get("distortion_model", "")).lower()],
        distortion,
        np.reshape(data["camera_matrix"], (3, 3)),
        np.reshape(data.get("rectification_matrix", np.eye(3)), (3, 3)),
        np.reshape(projection, (3, 4)),
    )
    return Calibration((camera,))


def _opencv(path: Path, size: Size) -> Calibration:
    """OpenCV's file storage, with the names that its samples and most people give."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)

    def find(*names: str) -> NDArray[np.float64] | None:
        for name in names:
            node = storage.getNode(name)
            if not node.empty() and node.isMap():
                return np.asarray(node.mat(), dtype=np.float64)
        return None

    matrices = [
        find("M1", "K1", "cameraMatrix1", "camera_matrix_left", "left_camera_matrix", "LEFT.K"),
        find("M2", "K2", "cameraMatrix2", "camera_matrix_right", "right_camera_matrix", "RIGHT.K"),
    ]
    if matrices[0] is None:
        matrices = [find("camera_matrix", "cameraMatrix", "K", "M"), None]
    distortions = [
        find("D1", "distCoeffs1", "dist_coeffs_left", "LEFT.D", "distortion_coefficients", "D"),
        find("D2", "distCoeffs2", "dist_coeffs_right", "RIGHT.D"),
    ]
    rectified = [
        (find("R1", "LEFT.R"), find("P1", "LEFT.P")),
        (find("R2", "RIGHT.R"), find("P2", "RIGHT.P")),
    ]
    rotation, translation = find("R"), find("T", "translation")
    T = None
    if rotation is not None and translation is not None:
        T = make_transform(rotation, translation.ravel())
    cameras = []
    is_known = all(part is not None for pair in rectified for part in pair) and T is None
    for matrix, distortion, (R, P) in zip(matrices, distortions, rectified, strict=True):
        if matrix is not None:
            numbers = np.zeros(5) if distortion is None else distortion.ravel()
            model = "rational_polynomial" if len(numbers) > 5 else "plumb_bob"
            camera = CameraCalibration(*size, model, numbers, matrix)
            if is_known and R is not None and P is not None:
                camera = replace(camera, rectification=R, projection=P[:3])
            cameras.append(camera)
    if not cameras and T is None:
        raise CalibrationError("holds neither M1, D1 (or camera_matrix) nor R, T")
    return Calibration(tuple(cameras), T, is_rectified=False)


def _orb_slam(path: Path, text: str, size: Size) -> Calibration:
    """One camera, a pair by a baseline (none of a depth camera), or raw by T_c1_c2, 2 to 1."""
    found = dict(re.findall(r"^(\w+\.\w+)[ \t]*:[ \t]*\"?([^\s\"#]+)", text, re.MULTILINE))
    kind = found.get("Camera.type", "PinHole")
    is_fisheye = kind.lower() == "kannalabrandt8"
    if not is_fisheye and kind.lower() not in ("pinhole", "rectified"):
        raise CalibrationError(f"Camera.type '{kind}' is neither PinHole nor KannalaBrandt8")
    size = int(found.get("Camera.width", size[0])), int(found.get("Camera.height", size[1]))
    names = "k1 k2 k3 k4" if is_fisheye else "k1 k2 p1 p2 k3"

    def camera(name: str) -> CameraCalibration:
        matrix = _matrix_of(*(float(found[f"{name}.{part}"]) for part in ("fx", "fy", "cx", "cy")))
        numbers = [float(found.get(f"{name}.{part}", 0.0)) for part in names.split()]
        return _raw(matrix, numbers, "equidistant" if is_fisheye else "radtan", size)

    first = camera("Camera1" if "Camera1.fx" in found else "Camera")
    if "Camera2.fx" in found and "Stereo.T_c1_c2" in text:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        T = _transform(storage.getNode("Stereo.T_c1_c2").mat(), "Stereo.T_c1_c2")
        return Calibration((first, camera("Camera2")), invert_transform(T), is_rectified=False)
    matrix = first.intrinsics
    shift = float(found.get("Camera.bf", float(found.get("Stereo.b", 0.0)) * matrix[0, 0]))
    if shift > 0.0 and not is_fisheye and "DepthMapFactor" not in text:
        pair = _pinhole(matrix, size), _pinhole(matrix, size, -shift)
        return Calibration(pair, is_rectified=True)
    return Calibration((first,), is_rectified=False)


def _camodocal(path: Path, text: str) -> Calibration:
    """A camera of VINS, or the file that names two and has their poses on the body."""
    names = re.findall(r"^cam[01]_calib[ \t]*:[ \t]*\"?([^\s\"#]+)", text, re.MULTILINE)
    if not names:
        return Calibration((_camodocal_camera(text),), is_rectified=False)
    cameras = tuple(_camodocal_camera(_text_of(path.parent / name)) for name in names)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    poses = [storage.getNode(f"body_T_cam{number}").mat() for number in range(len(cameras))]
    if any(pose is None for pose in poses):  # VINS estimates them
        return Calibration(cameras, is_rectified=False)
    bodies = [invert_transform(_transform(pose, "body_T_cam")) for pose in poses]
    T = bodies[1] @ invert_transform(bodies[0]) if len(bodies) > 1 else None
    return Calibration(cameras, T, bodies[0], is_rectified=False)


def _camodocal_camera(text: str) -> CameraCalibration:
    found = dict(re.findall(r"^[ \t]*(\w+)[ \t]*:[ \t]*\"?([^\s\"#]+)", text, re.MULTILINE))
    kind = found["model_type"]
    if kind not in _CAMODOCAL:
        raise CalibrationError(f"model_type '{kind}' is none of {', '.join(_CAMODOCAL)}")
    model, focal, distortion = _CAMODOCAL[kind]
    matrix = _matrix_of(*(float(found[name]) for name in focal.split()))
    numbers = [float(found[name]) for name in distortion.split()]
    return _raw(matrix, numbers, model, (int(found["image_width"]), int(found["image_height"])))


def _kitti(text: str, size: Size, path: Path) -> Calibration:
    """P0 to P3: the color cameras, 2 and 3, where the images are beside in image_2 or image_02."""
    found = re.findall(r"^P(?:_rect_0)?([0-3]):(.*)$", text, re.MULTILINE)
    rows = [numbers for _, numbers in sorted(found)] or text.strip().splitlines()
    projections = [np.reshape([*map(float, row.split())], (3, 4)) for row in rows]
    is_color = any((path.parent / name).is_dir() for name in ("image_2", "image_02"))
    has_gray = any((path.parent / name).is_dir() for name in ("image_0", "image_00"))
    first = 2 if is_color and not has_gray and len(projections) > 3 else 0
    chosen = projections[first : first + 2]
    origin = chosen[0][0, 3]
    cameras = tuple(_pinhole(P[:, :3], size, P[0, 3] - origin) for P in chosen)
    # poses are those of camera 0
    offset = np.linalg.solve(chosen[0][:, :3], chosen[0][:, 3])
    T_first_body = make_transform(np.eye(3), offset)
    return Calibration(cameras, None, T_first_body, is_rectified=True)


def _middlebury(text: str, size: Size) -> Calibration:
    """``cam0=[f 0 cx; 0 f cy; 0 0 1]``, ``cam1``, ``baseline`` in mm."""
    values = dict(re.findall(r"^\s*(\w+)\s*=\s*(.+?)\s*$", text, re.MULTILINE))
    matrices = [
        np.reshape([float(n) for n in re.findall(r"[-+.\deE]+", values[name])], (3, 3))
        for name in ("cam0", "cam1")
    ]
    shift = -matrices[1][0, 0] * 1e-3 * float(values["baseline"])
    left, right = _pinhole(matrices[0], size), _pinhole(matrices[1], size, shift)
    return Calibration((left, right), is_rectified=True)


_YAML_READERS: dict[str, Callable[[Mapping[str, Any], Size], Calibration]] = {
    "cam0": _kalibr,
    "T_BS": _euroc,
    "camera_matrix": _ros,
}
"""Readers of YAML files by a key that only theirs have."""
