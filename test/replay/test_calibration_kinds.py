"""Calibration files as OpenVINS, ORB-SLAM and Kalibr write them; the others: test_sequences.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.replay.sequences.calibration_files import read_calibration

SIZE = (640, 480)
T_BODY_LEFT = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.1, 0.06, 0.2])
T_BODY_RIGHT = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.1, -0.06, 0.2])


def camera(**more: object) -> dict[str, object]:
    return {
        "camera_model": "pinhole", "intrinsics": [400.0, 400.0, 320.0, 240.0],
        "distortion_model": "radtan", "distortion_coeffs": [0.0] * 4, "resolution": [640, 480],
    } | more  # fmt: skip


def read(path: Path, text: str):
    path.write_text(text)
    return read_calibration([path], SIZE)


@pytest.mark.parametrize("key", ["T_imu_cam", "T_cam_imu"])
def test_chain_that_tells_both_cameras_on_the_body(tmp_path: Path, key: str) -> None:
    """OpenVINS writes the cameras' poses in the frame of the IMU, or their inverses."""
    poses = [T_BODY_LEFT, T_BODY_RIGHT]
    told = poses if key == "T_imu_cam" else [invert_transform(pose) for pose in poses]
    chain = {f"cam{n}": camera(**{key: pose.tolist()}) for n, pose in enumerate(told)}
    found = read(tmp_path / "camchain.yaml", yaml.safe_dump(chain))
    np.testing.assert_allclose(found.T_second_first[:3, 3], (-0.12, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.T_first_body, invert_transform(T_BODY_LEFT), atol=1e-9)
    right = found.as_pair("camchain.yaml").cameras[1].projection
    assert -right[0, 3] / right[0, 0] == pytest.approx(0.12)


@pytest.mark.parametrize("model", ["omni", "eucm", "ds"])
def test_model_that_is_no_pinhole_is_named(tmp_path: Path, model: str) -> None:
    text = yaml.safe_dump({"cam0": camera(camera_model=model, intrinsics=[1.0] * 5)})
    with pytest.raises(CalibrationError, match=f"'{model}' is not supported, pinhole is"):
        read(tmp_path / "camchain.yaml", text)


def test_rectified_pair_of_orb_slam(tmp_path: Path) -> None:
    text = """%YAML:1.0
# Camera
Camera.type: "PinHole"
Camera.fx: 400.0
Camera.fy: 400.0
Camera.cx: 320.0
Camera.cy: 240.0
Camera.width: 640
Camera.height: 480
Camera.bf: 48.0
ThDepth: 35
"""
    left, right = read(tmp_path / "KITTI.yaml", text).as_pair("KITTI.yaml").cameras
    assert left.projection[0, 3] == 0.0
    assert -right.projection[0, 3] / right.projection[0, 0] == pytest.approx(0.12)


def test_maps_of_orb_slam_hold_their_rectification(tmp_path: Path) -> None:
    def matrix(name: str, values: np.ndarray) -> str:
        rows, columns = values.shape
        data = ", ".join(map(str, values.ravel()))
        return (
            f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
            f"   data: [{data}]\n"
        )

    k = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
    projections = {"LEFT": 0.0, "RIGHT": -48.0}
    text = "%YAML:1.0\nCamera.fx: 400.0\n"
    for side, shift in projections.items():
        p = np.column_stack([k, (shift, 0.0, 0.0)])
        parts = {"K": k, "D": np.zeros((1, 5)), "R": np.eye(3), "P": p}
        text += "".join(matrix(f"{side}.{name}", part) for name, part in parts.items())
    right = read(tmp_path / "EuRoC.yaml", text).as_pair("EuRoC.yaml").cameras[1]
    assert right.projection[0, 3] == pytest.approx(-48.0)


@pytest.mark.parametrize("text", ["[" * 2000, "cam0: {intrinsics: [1.0e+400, 1, 1, 1]}"])
def test_file_that_is_made_to_break_readers_is_an_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(CalibrationError):
        read(tmp_path / "a.yaml", text).as_pair("a.yaml")


def test_device_is_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").symlink_to("/dev/zero")
    with pytest.raises(CalibrationError, match="is no file"):
        read_calibration([tmp_path / "a.yaml"], SIZE)
