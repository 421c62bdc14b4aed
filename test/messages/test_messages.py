"""Records survive the way into a message and back, and real layouts are read right."""

from __future__ import annotations

import array
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from infomap_ros import messages as ms
from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PinholeCamera,
    PointCloudRecord,
    PoseRecord,
    StereoRig,
    TextRecord,
    TransformRecord,
    make_transform,
)
from infomap_ros.messages.clouds import _copy_points, _expand, _unpack_colors

STAMP = 1_700_000_000_123_456_789
TYPES = ms.RosbagsMessageTypes()


def header() -> Any:
    return ms.make_header(TYPES, STAMP, "camera")


def image_message(pixels: np.ndarray, kind: str, **changes: Any) -> SimpleNamespace:
    """A message as rclpy gives it: bytes in an array.array."""
    data = array.array("B")
    data.frombytes(pixels.tobytes())
    fields = {
        "header": header(),
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "encoding": kind,
        "is_bigendian": 0,
        "step": pixels.nbytes // pixels.shape[0],
        "data": data,
    }
    return SimpleNamespace(**(fields | changes))


@pytest.mark.parametrize(
    ("encoding", "dtype", "channels"),
    [
        ("mono8", np.uint8, 1),
        ("bgr8", np.uint8, 3),
        ("rgb8", np.uint8, 3),
        ("bgra8", np.uint8, 4),
        ("rgba8", np.uint8, 4),
        ("mono16", np.uint16, 1),
        ("16UC1", np.uint16, 1),
        ("32FC1", np.float32, 1),
        ("64FC3", np.float64, 3),
    ],
)
def test_image_round_trip(encoding, dtype, channels, rng):
    shape = (5, 7) if channels == 1 else (5, 7, channels)
    pixels = (rng.random(shape) * 200).astype(dtype)
    message = ms.encode(TYPES, ImageRecord(STAMP, "camera", pixels, encoding))
    (record,) = ms.decode(ms.IMAGE, message)
    assert (record.stamp, record.frame_id, record.encoding) == (STAMP, "camera", encoding)
    assert record.pixels.dtype == dtype
    np.testing.assert_array_equal(record.pixels, pixels)


def test_image_from_array_array_equals_the_one_from_numpy(rng):
    pixels = rng.integers(0, 255, (4, 6, 3), dtype=np.uint8)
    np.testing.assert_array_equal(ms.decode_image(image_message(pixels, "rgb8")).pixels, pixels)
    message = image_message(pixels, "rgb8", data=pixels.tobytes())
    np.testing.assert_array_equal(ms.decode_image(message).pixels, pixels)


def test_image_step_beyond_the_row_is_padding(rng):
    padded = rng.integers(0, 255, (4, 11), dtype=np.uint8)
    record = ms.decode_image(image_message(padded, "mono8", width=8))
    np.testing.assert_array_equal(record.pixels, padded[:, :8])


def test_image_padding_of_wide_pixels(rng):
    padded = rng.random((4, 9)).astype(np.float32)
    record = ms.decode_image(image_message(padded, "32FC1", width=6))
    np.testing.assert_array_equal(record.pixels, padded[:, :6])


@pytest.mark.parametrize("encoding", ["mono16", "32FC1"])
def test_big_endian_image(encoding, rng):
    dtype = {"mono16": ">u2", "32FC1": ">f4"}[encoding]
    pixels = (rng.random((3, 5)) * 1000).astype(dtype)
    record = ms.decode_image(image_message(pixels, encoding, is_bigendian=1))
    assert record.pixels.dtype.isnative
    np.testing.assert_array_equal(record.pixels, pixels.astype(record.pixels.dtype))


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaic_gives_the_color_back(pattern):
    color = {"b": 40, "g": 120, "r": 220}
    mosaic = np.empty((12, 16), np.uint8)
    for index, letter in enumerate(pattern):
        mosaic[index // 2 :: 2, index % 2 :: 2] = color[letter]
    record = ms.decode_image(image_message(mosaic, f"bayer_{pattern}8"))
    assert record.encoding == "bgr8"
    np.testing.assert_array_equal(record.pixels[6, 8], [40, 120, 220])


def test_yuv422_gray_stays_gray():
    packed = np.full((4, 8, 2), 128, np.uint8)
    record = ms.decode_image(image_message(packed, "yuv422_yuy2"))
    assert record.encoding == "bgr8"
    assert np.ptp(record.pixels) <= 1


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"encoding": "rgb9"}, "rgb9"),
        ({"step": 3}, "step"),
        ({"data": b"short"}, "data"),
        ({"height": 0}, "no pixels"),
        ({"height": -1}, "height"),
        ({"data": None}, "data"),
        ({"header": None}, "header"),
        ({"encoding": "yuv422", "width": 3, "step": 6, "data": bytes(24)}, "even"),
    ],
)
def test_malformed_image_is_named(changes, named):
    message = image_message(np.zeros((4, 6), np.uint8), "mono8", **changes)
    with pytest.raises(MalformedMessageError, match=named):
        ms.decode_image(message)


@pytest.mark.parametrize(("extension", "encoding"), [(".png", "bgr8"), (".jpg", "bgr8")])
def test_compressed_image(extension, encoding):
    pixels = np.full((16, 24, 3), (10, 100, 200), np.uint8)
    data = cv2.imencode(extension, pixels)[1].tobytes()
    message = SimpleNamespace(header=header(), format=extension[1:], data=data)
    record = ms.decode_compressed_image(message)
    assert record.encoding == encoding
    np.testing.assert_allclose(record.pixels, pixels, atol=3)


def test_compressed_depth_png_is_millimeters():
    depth = np.arange(48, dtype=np.uint16).reshape(6, 8) * 100
    data = bytes(12) + cv2.imencode(".png", depth)[1].tobytes()
    message = SimpleNamespace(header=header(), format="16UC1; compressedDepth png", data=data)
    record = ms.decode_compressed_image(message)
    assert record.encoding == "16UC1"
    np.testing.assert_array_equal(record.pixels, depth)


@pytest.mark.parametrize("data", [b"", b"not an image", cv2.imencode(".png", np.eye(9))[1][:20]])
def test_broken_compressed_image(data):
    message = SimpleNamespace(header=header(), format="png", data=data)
    with pytest.raises(MalformedMessageError):
        ms.decode_compressed_image(message)


def calibration(**changes: Any) -> CameraCalibration:
    values: dict[str, Any] = {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "distortion": np.array([0.1, -0.2, 0.0, 0.01, 0.0]),
        "intrinsics": np.array([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]]),
        "projection": np.array([[490.0, 0, 321, -49], [0, 490, 241, 0], [0, 0, 1, 0]]),
    }
    return CameraCalibration(**(values | changes))


def test_camera_info_round_trip():
    message = ms.encode(TYPES, CameraInfoRecord(STAMP, "camera", calibration()))
    (record,) = ms.decode(ms.CAMERA_INFO, message)
    assert record.calibration == calibration()
    assert record.stamp == STAMP


def test_camera_info_region_and_binning_fit_the_image():
    message = ms.encode(TYPES, CameraInfoRecord(STAMP, "camera", calibration()))
    message.roi.x_offset, message.roi.y_offset = 100, 40
    message.roi.width, message.roi.height = 400, 300
    message.binning_x = message.binning_y = 2
    result = ms.decode_camera_info(message).calibration
    camera = result.rectified_camera()
    assert (camera.width, camera.height) == (200, 150)
    # a pixel of the full image, moved by the offset and halved
    full = PinholeCamera(640, 480, 490, 490, 321, 241).project([0.1, 0.2, 2.0])
    np.testing.assert_allclose(camera.project([0.1, 0.2, 2.0]), (full - [100, 40]) / 2)
    assert result.projection[0, 3] / camera.fx == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("k", np.full(9, np.nan)),
        ("p", np.zeros(11)),
        ("d", np.array([np.inf])),
        ("width", -3),
        ("distortion_model", 7),
    ],
)
def test_malformed_camera_info(field, value):
    message = ms.encode(TYPES, CameraInfoRecord(STAMP, "camera", calibration()))
    setattr(message, field, value)
    with pytest.raises(MalformedMessageError, match=field):
        ms.decode_camera_info(message)


def test_region_outside_the_sensor_is_malformed():
    message = ms.encode(TYPES, CameraInfoRecord(STAMP, "camera", calibration()))
    message.roi.width, message.roi.height, message.roi.x_offset = 600, 400, 100
    with pytest.raises(MalformedMessageError, match="region of interest"):
        ms.decode_camera_info(message)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return make_transform(rotation * np.linalg.det(rotation), rng.normal(size=3))


def covariance(rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(6, 6))
    return root @ root.T


def test_pose_round_trip(rng):
    pose = PoseRecord(STAMP, "map", random_pose(rng), covariance(rng))
    (record,) = ms.decode(ms.POSE_WITH_COVARIANCE, ms.encode(TYPES, pose))
    np.testing.assert_allclose(record.transform, pose.transform, atol=1e-12)
    np.testing.assert_allclose(record.covariance, pose.covariance)
    assert record.frame_id == "map"


def test_covariance_of_zeros_is_unknown(rng):
    message = ms.encode(TYPES, PoseRecord(STAMP, "map", random_pose(rng)))
    assert not np.asarray(message.pose.covariance).any()
    assert ms.decode_pose_with_covariance(message).covariance is None


def test_odometry_round_trip(rng):
    odometry = OdometryRecord(
        STAMP, "odom", random_pose(rng), covariance(rng), "base_link", np.arange(6.0), None
    )
    (record,) = ms.decode(ms.ODOMETRY, ms.encode(TYPES, odometry))
    np.testing.assert_allclose(record.transform, odometry.transform, atol=1e-12)
    np.testing.assert_array_equal(record.twist, np.arange(6.0))
    assert record.child_frame_id == "base_link"
    assert record.twist_covariance is None


@pytest.mark.parametrize(
    ("matrix", "named"),
    [
        (-np.eye(6), "negative"),
        (np.triu(np.ones((6, 6))), "symmetric"),
        (np.full((6, 6), np.nan), "NaN"),
    ],
)
def test_impossible_pose_covariance(matrix, named, rng):
    message = ms.encode(TYPES, PoseRecord(STAMP, "map", random_pose(rng)))
    message.pose.covariance = matrix.reshape(-1)
    with pytest.raises(MalformedMessageError, match=named):
        ms.decode_pose_with_covariance(message)


def test_quaternion_that_is_not_of_unit_length_is_malformed(rng):
    message = ms.encode(TYPES, PoseRecord(STAMP, "map", random_pose(rng)))
    message.pose.pose.orientation.w += 3.0
    with pytest.raises(MalformedMessageError, match="quaternion"):
        ms.decode_pose_with_covariance(message)


def test_joint_state_round_trip():
    joints = JointStateRecord(STAMP, "", ("a", "b"), np.array([1.0, 2.0]), np.array([0.1, 0.2]))
    (record,) = ms.decode(ms.JOINT_STATE, ms.encode(TYPES, joints))
    assert record.names == ("a", "b")
    np.testing.assert_array_equal(record.positions, [1, 2])
    np.testing.assert_array_equal(record.velocities, [0.1, 0.2])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", ["a"]),
        ("name", ["a", "a"]),
        ("position", np.array([1.0])),
        ("velocity", np.array([1.0])),
    ],
)
def test_joint_state_that_contradicts_itself(field, value):
    joints = JointStateRecord(STAMP, "", ("a", "b"), np.array([1.0, 2.0]))
    message = ms.encode(TYPES, joints)
    setattr(message, field, value)
    with pytest.raises(MalformedMessageError):
        ms.decode_joint_state(message)


def test_joint_without_a_sensor_is_left_out_of_a_joint_state():
    """Drivers tell NaN for what they do not measure."""
    joints = JointStateRecord(STAMP, "", ("a", "b"), np.array([1.0, 2.0]), np.array([0.1, 0.2]))
    for field, names, has_velocities in (
        ("position", ("a",), True),
        ("velocity", ("a", "b"), False),
    ):
        message = ms.encode(TYPES, joints)
        setattr(message, field, np.array([1.0, np.nan]))
        record = ms.decode_joint_state(message)
        assert record.names == names
        np.testing.assert_array_equal(record.positions, [1.0, 2.0][: len(names)])
        assert (record.velocities is not None) is has_velocities


def test_transforms_round_trip(rng):
    edges = [
        TransformRecord(STAMP, "map", "odom", random_pose(rng)),
        TransformRecord(STAMP + 5, "odom", "base_link", random_pose(rng)),
    ]
    records = ms.decode(ms.TF, ms.encode_transforms(TYPES, edges), is_static=True)
    assert [(r.frame_id, r.child_frame_id, r.stamp) for r in records] == [
        ("map", "odom", STAMP),
        ("odom", "base_link", STAMP + 5),
    ]
    assert all(record.is_static for record in records)
    np.testing.assert_allclose(records[1].transform, edges[1].transform, atol=1e-12)


def test_transform_to_itself_is_malformed():
    message = ms.encode(TYPES, TransformRecord(STAMP, "map", "map", np.eye(4)))
    with pytest.raises(MalformedMessageError, match="parent"):
        ms.decode_transforms(message)


def test_text_takes_the_stamp_of_its_arrival():
    (record,) = ms.decode(ms.STRING, ms.encode(TYPES, TextRecord(0, "", "<robot/>")), stamp=42)
    assert (record.stamp, record.text) == (42, "<robot/>")


def test_type_that_is_not_read_is_named():
    with pytest.raises(MalformedMessageError, match="sensor_msgs/msg/Imu"):
        ms.decode("sensor_msgs/msg/Imu", SimpleNamespace())


def test_stamp_beyond_a_second_is_malformed():
    message = image_message(np.zeros((2, 2), np.uint8), "mono8")
    message.header.stamp.nanosec = 1_000_000_000
    with pytest.raises(MalformedMessageError, match="nanosec"):
        ms.decode_image(message)


def test_pixels_that_do_not_fit_the_encoding_are_refused():
    with pytest.raises(InvalidInputError, match="rgb8"):
        ms.encode_image(TYPES, ImageRecord(0, "", np.zeros((3, 3), np.uint8), "rgb8"))


def test_disparity_message_gives_depth_by_its_own_formula():
    left = PinholeCamera(4, 3, 100.0, 100.0, 2.0, 1.5)
    right = PinholeCamera(4, 3, 100.0, 100.0, 5.0, 1.5)
    rig = StereoRig(left, right, 0.2)
    disparity = np.full((3, 4), 7.0, np.float32)
    message = ms.encode_disparity(TYPES, STAMP, "left", disparity, rig, (0.0, 64.0))
    values = ms.decode_image(message.image).pixels
    depth = message.f * message.t / values
    np.testing.assert_allclose(depth, rig.depth_from_disparity(disparity))


def test_occupancy_grid_rows_run_along_y():
    cells = np.arange(6, dtype=np.int8).reshape(2, 3)
    message = ms.encode_occupancy_grid(TYPES, STAMP, "map", cells, 0.1, (-1.0, 2.0))
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.data.tolist() == [0, 1, 2, 3, 4, 5]
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.0, 2.0)


def test_clock():
    clock = ms.encode_clock(TYPES, STAMP).clock
    assert clock.sec * 10**9 + clock.nanosec == STAMP


def cloud(rng: np.random.Generator, shape: tuple[int, ...]) -> PointCloudRecord:
    root = rng.normal(size=(*shape, 3, 3))
    matrices = (root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(3)).astype(np.float32)
    points = rng.normal(size=(*shape, 3)).astype(np.float32)
    points.reshape(-1, 3)[1] = np.nan
    matrices.reshape(-1, 3, 3)[1] = np.nan
    colors = rng.integers(0, 255, (*shape, 3), dtype=np.uint8)
    return PointCloudRecord(STAMP, "left", points, matrices, colors)


@pytest.mark.parametrize("shape", [(3, 5), (7,)])
def test_point_cloud_round_trip(shape, rng):
    original = cloud(rng, shape)
    message = ms.encode(TYPES, original)
    assert [f.name for f in message.fields[:4]] == ["x", "y", "z", "rgb"]
    assert message.point_step == 40
    (record,) = ms.decode(ms.POINT_CLOUD, message)
    np.testing.assert_array_equal(record.points, original.points)
    np.testing.assert_allclose(record.covariances, original.covariances, rtol=1e-6)
    np.testing.assert_array_equal(record.colors, original.colors)


def foreign_cloud(layout: list[tuple[str, str, int]], step: int, rows: int, row_step: int, values):
    """A cloud in any layout, written one field at a time by plain Python."""
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    data = bytearray(rows * row_step)
    count = len(values) // rows
    for index, row in enumerate(values):
        start = (index // count) * row_step + (index % count) * step
        for (_, code, offset), value in zip(layout, row, strict=True):
            raw = np.array(value, ">" + code).tobytes()
            data[start + offset : start + offset + len(raw)] = raw
    fields = [SimpleNamespace(name=n, offset=o, datatype=codes[c], count=1) for n, c, o in layout]
    return SimpleNamespace(
        header=header(), height=rows, width=count, fields=fields, is_bigendian=True,
        point_step=step, row_step=row_step, data=bytes(data), is_dense=True,
    )  # fmt: skip


def test_foreign_layout_with_padding_double_and_big_endian():
    layout = [("z", "f8", 8), ("x", "f8", 16), ("intensity", "u2", 2), ("y", "f4", 24)]
    values = [(3.0 + i, 1.0 + i, 9, 2.0 + i) for i in range(6)]
    record = ms.decode_point_cloud(foreign_cloud(layout, 30, 2, 101, values))
    assert record.points.shape == (2, 3, 3)
    expected = [[1.0 + i, 2.0 + i, 3.0 + i] for i in range(6)]
    np.testing.assert_array_equal(record.points.reshape(-1, 3), expected)


def test_color_in_three_fields():
    layout = [(n, "f4", 4 * i) for i, n in enumerate("xyz")]
    layout += [(n, "u1", 12 + i) for i, n in enumerate("rgb")]
    record = ms.decode_point_cloud(foreign_cloud(layout, 16, 1, 16, [(1, 2, 3, 10, 20, 30)]))
    np.testing.assert_array_equal(record.colors, [[10, 20, 30]])


def test_infinite_coordinate_is_no_measurement():
    layout = [(n, "f4", 4 * i) for i, n in enumerate("xyz")]
    record = ms.decode_point_cloud(foreign_cloud(layout, 12, 1, 24, [(1, 2, 3), (1, np.inf, 3)]))
    np.testing.assert_array_equal(record.points, [[1, 2, 3], [np.nan] * 3])


def test_empty_cloud_is_a_cloud_without_points():
    points = np.zeros((0, 3), np.float32)
    message = ms.encode(TYPES, PointCloudRecord(STAMP, "left", points))
    assert ms.decode_point_cloud(message).points.shape == (0, 3)


def test_covariances_of_zeros_are_unknown(rng):
    original = cloud(rng, (4,))
    zeros = np.zeros_like(original.covariances)
    message = ms.encode(TYPES, PointCloudRecord(STAMP, "left", original.points, zeros))
    assert ms.decode_point_cloud(message).covariances is None


@pytest.mark.parametrize("element", [(0, 0), (1, 2), (2, 2)])
def test_covariance_that_is_not_positive_is_named(element, rng):
    original = cloud(rng, (4,))
    matrices = original.covariances.copy()
    matrices[2][element] = matrices[2][element[::-1]] = -50.0
    message = ms.encode(TYPES, PointCloudRecord(STAMP, "left", original.points, matrices))
    with pytest.raises(MalformedMessageError, match="point 2"):
        ms.decode_point_cloud(message)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"point_step": 8}, "leaves"),
        ({"row_step": 11}, "row_step"),
        ({"data": bytes(11)}, "data"),
        ({"fields": []}, "x, y, z"),
        ({"width": 2**31}, "row_step"),
    ],
)
def test_malformed_cloud_is_named(changes, named):
    layout = [(n, "f4", 4 * i) for i, n in enumerate("xyz")]
    message = foreign_cloud(layout, 12, 1, 12, [(1, 2, 3)])
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(MalformedMessageError, match=named):
        ms.decode_point_cloud(message)


def test_part_of_the_covariance_fields_is_malformed():
    layout = [(n, "f4", 4 * i) for i, n in enumerate(["x", "y", "z", "cov_xx"])]
    with pytest.raises(MalformedMessageError, match="all six"):
        ms.decode_point_cloud(foreign_cloud(layout, 16, 1, 16, [(1, 2, 3, 4)]))


def test_kernels_of_clouds_run_uncompiled(rng):
    original = cloud(rng, (6,))
    points = original.points.copy()
    points[3, 1] = np.inf
    copied = np.empty((2, 3, 3), np.float32)
    _copy_points.py_func(points.reshape(2, 3, 3), copied)
    np.testing.assert_array_equal(np.isnan(copied).all(axis=2), [[0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(copied.reshape(6, 3)[[0, 2, 4, 5]], points[[0, 2, 4, 5]])
    upper = np.stack(
        [
            original.covariances[..., i, j]
            for i, j in zip([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2], strict=True)
        ],
        axis=-1,
    )
    upper, expanded = upper.reshape(2, 3, 6), np.empty((2, 3, 3, 3), np.float32)
    assert _expand.py_func(copied, upper, expanded) == -1
    measured, found = [0, 2, 4, 5], expanded.reshape(6, 3, 3)
    np.testing.assert_array_equal(found[measured], original.covariances[measured])
    assert np.isnan(found[[1, 3]]).all()
    upper[1, 1, 3] = -1.0
    assert _expand.py_func(copied, upper, expanded) == 4
    assert _expand.py_func(np.full((1, 1, 3), np.nan), upper, expanded) == -2
    colors = np.empty((1, 1, 3), np.uint8)
    _unpack_colors.py_func(np.array([[0x00010203]], np.uint32), colors)
    assert colors.tolist() == [[[1, 2, 3]]]


_BOMB = """
import zlib
from types import SimpleNamespace
from infomap_ros.errors import MalformedMessageError
from infomap_ros.messages import decode_compressed_image
import cv2, numpy as np
data = bytearray(cv2.imencode(".{form}", np.zeros((8, 8), np.uint8))[1].tobytes())
header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id="camera")
message = SimpleNamespace(header=header, format="{form}", data=np.array(data))
decode_compressed_image(message)
at = data.index({marker})
data[at + {skip} : at + {skip} + 2 * {width}] = 2 * (20_000).to_bytes({width}, "big")
if "{form}" == "png":
    data[at + 17 : at + 21] = zlib.crc32(data[at : at + 17]).to_bytes(4, "big")
message.data = np.array(data)
try:
    decode_compressed_image(message)
except MalformedMessageError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("form", "marker", "skip", "width"), [("png", b"IHDR", 4, 4), ("jpg", b"\xff\xc0", 5, 2)]
)
def test_an_image_that_unfolds_to_gigabytes_is_refused_before_it_is_decoded(
    form, marker, skip, width
):
    """In a process of its own: OpenCV reads its limit once."""
    script = _BOMB.format(form=form, marker=marker, skip=skip, width=width)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert "data cannot be decoded" in done.stdout, done.stderr
