"""Images and camera calibrations out of messages."""

from __future__ import annotations

import re
import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CalibrationError, MalformedMessageError
from infomap_ros.geometry.camera import CameraCalibration
from infomap_ros.geometry.records import CameraInfoRecord, ImageRecord
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.fields import MessageFields

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

_NAMED_ENCODINGS = {
    "mono8": ("u1", 1),
    "bgr8": ("u1", 3),
    "rgb8": ("u1", 3),
    "bgra8": ("u1", 4),
    "rgba8": ("u1", 4),
    "mono16": ("u2", 1),
    "bgr16": ("u2", 3),
    "rgb16": ("u2", 3),
    "bgra16": ("u2", 4),
    "rgba16": ("u2", 4),
    "yuv422": ("u1", 2),
    "yuv422_yuy2": ("u1", 2),
}
_NUMERIC_ENCODING = re.compile(r"(8U|8S|16U|16S|32S|32F|64F)C([1-4])")
_NUMERIC_TYPES = {
    "8U": "u1",
    "8S": "i1",
    "16U": "u2",
    "16S": "i2",
    "32S": "i4",
    "32F": "f4",
    "64F": "f8",
}
# ROS names a mosaic by its first two rows, OpenCV by the 2x2 block that starts one pixel later.
_BAYER = {
    "rggb": cv2.COLOR_BayerBG2BGR,
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}
_BAYER_ENCODING = re.compile(r"bayer_(rggb|bggr|gbrg|grbg)(8|16)")
_YUV = {"yuv422": cv2.COLOR_YUV2BGR_UYVY, "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2}


def pixel_layout(encoding: str) -> tuple[str, int] | None:
    """Numpy type code and number of channels of an encoding; None where it is not known."""
    if encoding in _NAMED_ENCODINGS:
        return _NAMED_ENCODINGS[encoding]
    if match := _NUMERIC_ENCODING.fullmatch(encoding):
        return _NUMERIC_TYPES[match[1]], int(match[2])
    if match := _BAYER_ENCODING.fullmatch(encoding):
        return f"u{int(match[2]) // 8}", 1
    return None


def decode_image(message: object) -> ImageRecord:
    """Read a ``sensor_msgs/Image``.

    Bayer mosaics and YUV 4:2:2 become ``bgr8`` (``bgr16``); every other encoding is kept. Pixels
    are in the machine's byte order. They share memory with the message where that is possible.

    Raises:
        MalformedMessageError: unknown encoding, no pixels, `step` too small for a row, or an
            amount of data that is not ``step * height``.
    """
    fields = MessageFields(message, IMAGE)
    stamp, frame_id = fields.header()
    encoding = fields.name("encoding")
    pixels = _pixels(fields, encoding)
    if match := _BAYER_ENCODING.fullmatch(encoding):
        _check_mosaic(fields, pixels)
        pixels, encoding = cv2.cvtColor(pixels, _BAYER[match[1]]), f"bgr{match[2]}"
    elif encoding in _YUV:
        if pixels.shape[1] % 2:
            fields.fail(f"encoding {encoding} needs an even width, not {pixels.shape[1]}")
        pixels, encoding = cv2.cvtColor(pixels, _YUV[encoding]), "bgr8"
    return ImageRecord(stamp, frame_id, pixels, encoding)


def _check_mosaic(fields: MessageFields, pixels: NDArray[np.generic]) -> None:
    if min(pixels.shape) < 4:
        fields.fail(f"a mosaic of {pixels.shape[1]}x{pixels.shape[0]} px is too small")


def _pixels(fields: MessageFields, encoding: str) -> NDArray[np.generic]:
    layout = pixel_layout(encoding)
    if layout is None:
        fields.fail(f"encoding '{encoding}' is not known")
    code, channels = layout
    height, width = fields.integer("height"), fields.integer("width")
    step, data = fields.integer("step"), fields.data()
    row_bytes = width * channels * np.dtype(code).itemsize
    if height == 0 or width == 0:
        fields.fail(f"image of {width}x{height} px has no pixels")
    if step < row_bytes:
        fields.fail(f"step {step} is less than the {row_bytes} bytes of a row")
    if len(data) != step * height:
        fields.fail(f"data has {len(data)} bytes, step * height is {step * height}")
    rows = data.reshape(height, step)[:, :row_bytes]
    if step != row_bytes:
        rows = np.ascontiguousarray(rows)
    order = ">" if fields.integer("is_bigendian", high=255) else "<"
    pixels = rows.view(f"{order}{code}")
    native = {"little": "<", "big": ">"}[sys.byteorder]
    if pixels.dtype.itemsize > 1 and order != native:
        pixels = pixels.astype(code)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def decode_compressed_image(message: object) -> ImageRecord:
    """Read a ``sensor_msgs/CompressedImage`` (JPEG, PNG and what else OpenCV decodes).

    A depth image as image_transport compresses it (``16UC1; compressedDepth png``) is read too;
    its other forms are refused by name.

    Raises:
        MalformedMessageError: the data are not a whole image, or the format is not supported.
    """
    fields = MessageFields(message, COMPRESSED_IMAGE)
    stamp, frame_id = fields.header()
    form, data = fields.name("format"), fields.data()
    if "compressedDepth" in form:
        if not form.startswith(("16UC1", "mono16")) or "rvl" in form:
            fields.fail(f"format '{form}' is not supported")
        data = data[12:]  # the transport's own header: format and two quantization parameters
    try:
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except cv2.error as error:
        raise MalformedMessageError(COMPRESSED_IMAGE, "data cannot be decoded") from error
    if pixels is None:
        fields.fail(f"{len(data)} bytes of format '{form}' are not an image that can be decoded")
    return ImageRecord(stamp, frame_id, pixels, _decoded_encoding(fields, form, pixels))


def _decoded_encoding(fields: MessageFields, form: str, pixels: NDArray[np.generic]) -> str:
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    encodings = {
        ("uint8", 1): "mono8",
        ("uint8", 3): "bgr8",
        ("uint8", 4): "bgra8",
        ("uint16", 1): "16UC1" if form.startswith("16UC1") else "mono16",
        ("uint16", 3): "bgr16",
        ("uint16", 4): "bgra16",
    }
    encoding = encodings.get((pixels.dtype.name, channels))
    if encoding is None:
        fields.fail(f"a compressed image of {channels} x {pixels.dtype} is not supported")
    return encoding


def decode_camera_info(message: object) -> CameraInfoRecord:
    """Read a ``sensor_msgs/CameraInfo``, of ROS 1 or 2.

    Region of interest and binning are applied, so that the calibration fits the image it came
    with.

    Raises:
        MalformedMessageError: a matrix has a wrong length or holds NaN or infinity, or the region
            of interest leaves the sensor.
    """
    fields = MessageFields(message, CAMERA_INFO)
    stamp, frame_id = fields.header()
    size = fields.integer("width"), fields.integer("height")
    k = fields.numbers("k", "K", size=9).reshape(3, 3)
    p = fields.numbers("p", "P", size=12).reshape(3, 4)
    (width, height), window = _window(fields, size)
    try:
        calibration = CameraCalibration(
            width=width,
            height=height,
            distortion_model=fields.name("distortion_model"),
            distortion=fields.numbers("d", "D"),
            intrinsics=window @ k if k[0, 0] else k,
            rectification=fields.numbers("r", "R", size=9).reshape(3, 3),
            projection=window @ p if p[0, 0] else p,
        )
    except CalibrationError as error:
        raise MalformedMessageError(CAMERA_INFO, str(error)) from error
    return CameraInfoRecord(stamp, frame_id, calibration)


def _window(fields: MessageFields, size: tuple[int, int]) -> tuple[tuple[int, int], FloatArray]:
    """Image size after region of interest and binning, and the map (3, 3) of its pixels."""
    roi = fields.child("roi")
    offset = [roi.integer("x_offset"), roi.integer("y_offset")]
    extent = [roi.integer("width"), roi.integer("height")]
    if not any(extent):  # all zero stands for the whole sensor
        offset, extent = [0, 0], list(size)
    if offset[0] + extent[0] > size[0] or offset[1] + extent[1] > size[1]:
        fields.fail(f"region of interest leaves the {size[0]}x{size[1]} px of the sensor")
    binning = [max(1, fields.integer(name)) for name in ("binning_x", "binning_y")]
    window = np.eye(3)
    for axis in range(2):
        window[axis, axis] = 1.0 / binning[axis]
        window[axis, 2] = -offset[axis] / binning[axis]
    return (extent[0] // binning[0], extent[1] // binning[1]), window
