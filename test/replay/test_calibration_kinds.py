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
    k = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
    projections = {"LEFT": 0.0, "RIGHT": -48.0}
    text = "%YAML:1.0\nCamera.fx: 400.0\n"
    for side, shift in projections.items():
        p = np.column_stack([k, (shift, 0.0, 0.0)])
        parts = {"K": k, "D": np.zeros((1, 5)), "R": np.eye(3), "P": p}
        text += "".join(matrix(f"{side}.{name}", part) for name, part in parts.items())
    right = read(tmp_path / "EuRoC.yaml", text).as_pair("EuRoC.yaml").cameras[1]
    assert right.projection[0, 3] == pytest.approx(-48.0)


def matrix(name: str, values: np.ndarray) -> str:
    """As OpenCV's file storage writes it."""
    rows, columns = values.shape
    data = ", ".join(map(str, values.ravel()))
    return (
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
        f"   data: [{data}]\n"
    )


def settings(camera: str, **numbers: object) -> str:
    parts = {"fx": 400.0, "fy": 400.0, "cx": 320.0, "cy": 240.0} | numbers
    return "".join(f"{camera}.{name}: {value}\n" for name, value in parts.items())


@pytest.mark.parametrize(
    ("kind", "model"), [("PinHole", "plumb_bob"), ("KannalaBrandt8", "equidistant")]
)
def test_raw_pair_of_orb_slam_with_matrices_beside(tmp_path: Path, kind: str, model: str) -> None:
    """A matrix of the IMU makes it no file of OpenCV; T_c1_c2 is the second camera's pose."""
    T_left_right = make_transform(np.eye(3), [0.12, 0.0, 0.0])
    text = f'%YAML:1.0\nCamera.type: "{kind}"\nCamera.width: 640\nCamera.height: 480\n'
    text += settings("Camera1", k1=0.01) + settings("Camera2", k1=0.02)
    text += matrix("Stereo.T_c1_c2", T_left_right) + matrix("IMU.T_b_c1", np.eye(4))
    found = read(tmp_path / "EuRoC.yaml", text)
    assert [camera.distortion_model for camera in found.cameras] == [model, model]
    assert [camera.distortion[0] for camera in found.cameras] == [0.01, 0.02]
    right = found.as_pair("EuRoC.yaml").cameras[1].projection
    assert -right[0, 3] / right[0, 0] == pytest.approx(0.12)


def test_baseline_of_a_depth_camera_of_orb_slam_is_none(tmp_path: Path) -> None:
    """Where a depth image has a scale, bf only says how far is far: one camera, its distortion."""
    text = "%YAML:1.0\n" + settings("Camera", k1=0.26, bf=40.0) + "DepthMapFactor: 5000.0\n"
    (color,) = read(tmp_path / "TUM1.yaml", text).cameras
    assert color.distortion[0] == pytest.approx(0.26)


def test_transform_in_one_row(tmp_path: Path) -> None:
    """MSCKF-VIO has Kalibr's chain with 16 numbers a matrix."""
    poses = [invert_transform(pose).ravel().tolist() for pose in (T_BODY_LEFT, T_BODY_RIGHT)]
    chain = {f"cam{n}": camera(T_cam_imu=pose) for n, pose in enumerate(poses)}
    found = read(tmp_path / "camchain.yaml", yaml.safe_dump(chain))
    np.testing.assert_allclose(found.T_second_first[:3, 3], (-0.12, 0.0, 0.0), atol=1e-9)


def camodocal(kind: str, **numbers: float) -> str:
    values = "".join(f"   {name}: {value}\n" for name, value in numbers.items())
    size = "image_width: 640\nimage_height: 480\n"
    return f"%YAML:1.0\n---\nmodel_type: {kind}\n{size}projection_parameters:\n{values}"


@pytest.mark.parametrize(
    ("text", "model"),
    [
        (camodocal("PINHOLE", k1=0.1, k2=0, p1=0, p2=0, fx=400, fy=400, cx=320, cy=240), "plumb"),
        (
            camodocal("KANNALA_BRANDT", k2=0.1, k3=0, k4=0, k5=0, mu=400, mv=400, u0=320, v0=240),
            "equidistant",
        ),
    ],
)
def test_pair_of_vins(tmp_path: Path, text: str, model: str) -> None:
    """One file names both cameras' and has their poses on the body."""
    for name in ("left.yaml", "right.yaml"):
        (tmp_path / name).write_text(text)
    rig = 'cam0_calib: "left.yaml"\ncam1_calib: "right.yaml"\n'
    alone = read(tmp_path / "estimated.yaml", f"%YAML:1.0\n{rig}")
    assert len(alone.cameras) == 2 and alone.T_second_first is None
    rig += matrix("body_T_cam0", T_BODY_LEFT) + matrix("body_T_cam1", T_BODY_RIGHT)
    found = read(tmp_path / "stereo.yaml", f"%YAML:1.0\n{rig}")
    assert found.cameras[1].distortion_model.startswith(model)
    assert found.cameras[1].distortion[0] == pytest.approx(0.1)
    np.testing.assert_allclose(found.T_first_body, invert_transform(T_BODY_LEFT), atol=1e-9)
    right = found.as_pair("stereo.yaml").cameras[1].projection
    assert -right[0, 3] / right[0, 0] == pytest.approx(0.12)


def test_model_of_vins_that_is_no_pinhole_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="'MEI' is none of PINHOLE, KANNALA"):
        read(tmp_path / "cam0.yaml", camodocal("MEI", xi=1.0))


def test_tabs_are_spaces_and_what_is_missing_is_named(tmp_path: Path) -> None:
    """OpenCV and yaml-cpp, which write and read these files, take tabs within lists."""
    data = "data: [400., 0., 320.,\n\t\t0., 400., 240.,\n\t0., 0., 1.]"
    text = f"camera_matrix:\n  rows: 3\n  cols: 3\n  {data}\ndistortion_model: plumb_bob\n"
    assert read(tmp_path / "tabs.yaml", text).cameras[0].intrinsics[1, 2] == 240.0
    with pytest.raises(CalibrationError, match="it has no 'intrinsics'"):
        read(tmp_path / "other.yaml", "cam0: {cam_fx: 400.0}")


@pytest.mark.parametrize("text", ["[" * 2000, "cam0: {intrinsics: [1.0e+400, 1, 1, 1]}"])
def test_file_that_is_made_to_break_readers_is_an_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(CalibrationError):
        read(tmp_path / "a.yaml", text).as_pair("a.yaml")


def test_device_is_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").symlink_to("/dev/zero")
    with pytest.raises(CalibrationError, match="is no file"):
        read_calibration([tmp_path / "a.yaml"], SIZE)
