"""Point clouds out of messages and into them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.records import PointCloudRecord
from infomap_ros.messages.fields import MessageFields, MessageTypes, make_header
from infomap_ros.stereo.range_cloud import CORRELATION_FIELD, CORRELATION_OFFSET, PACKED_FIELDS

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
POINT_FIELD = "sensor_msgs/msg/PointField"

COVARIANCE_NAMES = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_UPPER_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_FLOAT32, _UINT8 = 7, 2
_ALL_GOOD, _NONE_MEASURED = -1, -2
_TYPE_CODES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True)
class _Cells:
    """The point data, how it is laid out, and its fields (name: offset and type code)."""

    message: MessageFields
    data: NDArray[np.uint8]
    shape: tuple[int, int]
    strides: tuple[int, int]
    order: str
    layout: dict[str, tuple[int, str]]

    def column(self, name: str) -> NDArray[Any]:
        """One field of all points, shape (height, width)."""
        offset, code = self.layout[name]
        dtype = np.dtype(self.order + code)
        return np.ndarray(self.shape, dtype, self.data, offset, self.strides)

    def block(self, names: tuple[str, ...]) -> NDArray[np.float32] | None:
        """Neighboring float32 fields at once, shape (height, width, n); None if they are not."""
        first = self.layout[names[0]][0]
        wanted = [(first + 4 * index, "f4") for index in range(len(names))]
        if [self.layout[name] for name in names] != wanted:
            return None
        shape, strides = (*self.shape, len(names)), (*self.strides, 4)
        return np.ndarray(shape, self.order + "f4", self.data, first, strides)

    def floats(self, names: tuple[str, ...]) -> NDArray[np.float32]:
        """Fields as float32, shape (height, width, n); not to be written to."""
        block = self.block(names)
        if block is not None:
            return block.astype(np.float32, copy=False)
        with np.errstate(
            over="ignore"
        ):  # a float64 beyond float32 becomes infinite: no measurement
            columns = [self.column(name).astype(np.float32) for name in names]
        return np.stack(columns, axis=-1)


def decode_point_cloud(message: object) -> PointCloudRecord:
    """Read a ``sensor_msgs/PointCloud2`` of any layout.

    Points with a coordinate that is not finite become NaN in all three. A cloud of height 1 gives
    points (N, 3), any other (H, W, 3). Colors come from ``rgb`` or ``rgba``, or from ``r``, ``g``
    and ``b``; covariances from ``cov_xx`` to ``cov_zz``, where all zero stands for unknown. The
    correlation of errors comes from the first point's ``error_correlation``, a share, or hundredths
    where it is of an integer type.

    Raises:
        MalformedMessageError: x, y or z is missing, a field is unknown or leaves its point, steps
            and data contradict each other, or the covariance of a point is not one.
    """
    fields = MessageFields(message, POINT_CLOUD)
    stamp, frame_id = fields.header()
    cells = _cells(fields)
    if len(cells.data) == 0:
        return PointCloudRecord(stamp, frame_id, np.zeros((0, 3), np.float32))
    points = np.empty((*cells.shape, 3), np.float32)
    _copy_points(cells.floats(("x", "y", "z")), points)
    covariances, colors = _covariances(cells, points), _colors(cells)
    if points.shape[0] == 1:
        points = points[0]
        covariances = None if covariances is None else covariances[0]
        colors = None if colors is None else colors[0]
    correlation = _error_correlation(cells)
    return PointCloudRecord(stamp, frame_id, points, covariances, colors, correlation)


def _error_correlation(cells: _Cells) -> float | None:
    if CORRELATION_FIELD not in cells.layout:
        return None
    value = cells.column(CORRELATION_FIELD)[0, 0]
    share = float(value) if value.dtype.kind == "f" else round_correlation(int(value) / 100)
    if not 0.0 <= share <= 1.0:
        cells.message.fail(f"{CORRELATION_FIELD} is {share}, expected 0 to 1")
    return share


def round_correlation(share: float) -> float:
    """A correlation as the clouds of range sensors carry it: in hundredths."""
    return round(100.0 * share) / 100


def _cells(fields: MessageFields) -> _Cells:
    height, width = fields.integer("height"), fields.integer("width")
    point_step, row_step = fields.integer("point_step"), fields.integer("row_step")
    data = fields.data()
    if height * width == 0:
        height, width, row_step = 1, 0, 0
    if row_step < width * point_step:
        fields.fail(f"row_step {row_step} is less than width * point_step {width * point_step}")
    if len(data) != row_step * height:
        fields.fail(f"data has {len(data)} bytes, row_step * height is {row_step * height}")
    layout = _layout(fields, point_step)
    order = ">" if fields.integer("is_bigendian", high=1) else "<"
    return _Cells(fields, data, (height, width), (row_step, point_step), order, layout)


def _layout(fields: MessageFields, point_step: int) -> dict[str, tuple[int, str]]:
    layout: dict[str, tuple[int, str]] = {}
    for part in fields.children("fields"):
        name, offset = part.name("name"), part.integer("offset")
        code = _TYPE_CODES.get(part.integer("datatype", high=255))
        count = max(1, part.integer("count"))
        if code is None:
            fields.fail(f"field '{name}' has an unknown datatype")
        if offset + count * np.dtype(code).itemsize > point_step:
            fields.fail(
                f"field '{name}' at offset {offset} leaves the {point_step} bytes of a point"
            )
        if name in layout:
            fields.fail(f"field '{name}' is there twice")
        layout[name] = (offset, code)
    missing = [name for name in ("x", "y", "z") if name not in layout]
    if missing:
        fields.fail(f"has no field {', '.join(missing)}")
    return layout


def _colors(cells: _Cells) -> NDArray[np.uint8] | None:
    packed = next((name for name in ("rgb", "rgba") if name in cells.layout), None)
    if packed is not None:
        if cells.layout[packed][1] not in ("f4", "u4", "i4"):
            cells.message.fail(f"field '{packed}' must have four bytes")
        value = cells.column(packed).view(cells.order + "u4").astype(np.uint32, copy=False)
        colors = np.empty((*cells.shape, 3), np.uint8)
        _unpack_colors(value, colors)
        return colors
    if all(cells.layout.get(name, (0, ""))[1] == "u1" for name in "rgb"):
        return np.stack([cells.column(name) for name in "rgb"], axis=-1)
    return None


def _covariances(cells: _Cells, points: NDArray[np.float32]) -> NDArray[np.float32] | None:
    present = [name for name in COVARIANCE_NAMES if name in cells.layout]
    if not present:
        return None
    if len(present) < len(COVARIANCE_NAMES):
        cells.message.fail(f"has {', '.join(present)} but not all six covariance fields")
    upper = cells.floats(COVARIANCE_NAMES)
    covariances = np.empty((*cells.shape, 3, 3), dtype=np.float32)
    bad = _expand(points, upper, covariances)
    if bad != _ALL_GOOD and not upper.any():
        return None
    if bad >= 0:
        values = upper.reshape(-1, 6)[bad].tolist()
        cells.message.fail(f"covariance {values} of point {bad} is not positive")
    return covariances


@kernel
def _copy_points(source: Any, points: Any) -> None:
    """Copy points, all three coordinates NaN where one is not finite."""
    for v in range(points.shape[0]):
        for u in range(points.shape[1]):
            x, y, z = source[v, u, 0], source[v, u, 1], source[v, u, 2]
            if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
                x = y = z = np.float32(np.nan)
            points[v, u, 0], points[v, u, 1], points[v, u, 2] = x, y, z


@kernel
def _unpack_colors(packed: Any, colors: Any) -> None:
    """Red, green and blue of 0x00RRGGBB."""
    for v in range(colors.shape[0]):
        for u in range(colors.shape[1]):
            value = packed[v, u]
            colors[v, u, 0] = (value >> np.uint32(16)) & np.uint32(255)
            colors[v, u, 1] = (value >> np.uint32(8)) & np.uint32(255)
            colors[v, u, 2] = value & np.uint32(255)


@kernel
def _expand(points: Any, upper: Any, covariances: Any) -> Any:
    """Write 3x3 matrices from upper triangles; number of the first point without one.

    Points that were not measured get NaN. A matrix passes when its principal minors are not
    negative beyond the rounding of float32, and its variances are positive.

    Returns:
        _ALL_GOOD if all that were measured have one, _NONE_MEASURED where none was.
    """
    width, result = points.shape[1], _NONE_MEASURED
    for v in range(points.shape[0]):
        for u in range(width):
            if np.isnan(points[v, u, 0]):
                for i in range(9):
                    covariances[v, u, i // 3, i % 3] = np.nan
                continue
            xx, xy, xz = upper[v, u, 0], upper[v, u, 1], upper[v, u, 2]
            yy, yz, zz = upper[v, u, 3], upper[v, u, 4], upper[v, u, 5]
            if not _is_covariance(xx, xy, xz, yy, yz, zz):
                return v * width + u
            result = _ALL_GOOD
            c = covariances[v, u]
            c[0, 0], c[0, 1], c[0, 2] = xx, xy, xz
            c[1, 0], c[1, 1], c[1, 2] = xy, yy, yz
            c[2, 0], c[2, 1], c[2, 2] = xz, yz, zz
    return result


@kernel
def _is_covariance(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
    """Whether the numbers of an upper triangle, row by row, are those of a covariance."""
    xx, xy, xz = np.float64(a), np.float64(b), np.float64(c)
    yy, yz, zz = np.float64(d), np.float64(e), np.float64(f)
    if not (xx > 0.0 and yy > 0.0 and zz > 0.0 and xx + yy + zz < np.inf):
        return False
    slack = 1.0 + 1e-5
    planar = xy * xy <= slack * xx * yy and xz * xz <= slack * xx * zz
    yz_minor = yy * zz - yz * yz
    determinant = xx * yz_minor - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    return planar and yz_minor >= -1e-5 * yy * zz and determinant >= -1e-5 * xx * yy * zz


def encode_point_cloud(types: MessageTypes, record: PointCloudRecord) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` of float32 fields.

    Fields x y z, then rgb (packed) where there are colors, then cov_xx cov_xy cov_xz cov_yy
    cov_yz cov_zz where there are covariances, then error_correlation where it is known.

    Raises:
        InvalidInputError: points, covariances and colors do not fit each other.
    """
    points = np.asarray(record.points)
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise InvalidInputError("points", f"shape {points.shape}, expected (H, W, 3) or (N, 3)")
    names: tuple[str, ...] = ("x", "y", "z")
    names += ("rgb",) if record.colors is not None else ()
    names += COVARIANCE_NAMES if record.covariances is not None else ()
    first_covariance = len(names) - 6
    names += (CORRELATION_FIELD,) if record.error_correlation is not None else ()
    data = np.empty((*points.shape[:-1], len(names)), dtype="<f4")
    data[..., :3] = points
    if record.colors is not None:
        _check_shape("colors", record.colors, points.shape)
        data[..., 3].view("<u4")[...] = _packed(record.colors)
    if record.covariances is not None:
        _check_shape("covariances", record.covariances, (*points.shape, 3))
        for column, (i, j) in enumerate(_UPPER_TRIANGLE, start=first_covariance):
            data[..., column] = record.covariances[..., i, j]
    if record.error_correlation is not None:
        data[..., -1] = record.error_correlation
    return encode_cloud_fields(types, record.stamp, record.frame_id, names, data)


def encode_range_cloud(
    types: MessageTypes, stamp: int, frame_id: str, packed: NDArray[np.float32]
) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` of `RangeCloud.packed`, shape (H, W, 10).

    Its fields are `PACKED_FIELDS` and, in the byte that rgb leaves over, `CORRELATION_FIELD`.
    """
    message = encode_cloud_fields(types, stamp, frame_id, PACKED_FIELDS, packed)
    spare = {"name": CORRELATION_FIELD, "offset": CORRELATION_OFFSET, "datatype": _UINT8}
    message.fields = [*message.fields, types.make(POINT_FIELD, **spare, count=1)]
    return message


def encode_cloud_fields(
    types: MessageTypes, stamp: int, frame_id: str, names: tuple[str, ...], data: NDArray[Any]
) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` of any float32 fields.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: frame of x y z.
        names: n field names.
        data: shape (H, W, n) or (N, n), float32.
    """
    height, width = (1, len(data)) if data.ndim == 2 else data.shape[:2]
    step = 4 * len(names)
    content = np.ascontiguousarray(data, dtype="<f4")
    fields = [
        types.make(POINT_FIELD, name=name, offset=4 * index, datatype=_FLOAT32, count=1)
        for index, name in enumerate(names)
    ]
    return types.make(
        POINT_CLOUD,
        header=make_header(types, stamp, frame_id),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=step * width,
        data=content.reshape(-1).view(np.uint8),
        is_dense=bool(not np.isnan(content[..., 0]).any()),
    )


def _packed(colors: NDArray[np.uint8]) -> NDArray[np.uint32]:
    channels = colors.astype(np.uint32)
    packed = (channels[..., 0] << 16) | (channels[..., 1] << 8) | channels[..., 2]
    return packed.astype("<u4", copy=False)


def _check_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InvalidInputError(name, f"shape {array.shape}, expected {shape}")
