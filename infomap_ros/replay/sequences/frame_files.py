"""Image files of a folder with their stamps, and poses from tables.

Depth images taken over to the color camera beside the depth camera.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import BagError
from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.geometry.records import ImuRecord
from infomap_ros.geometry.transforms import FloatArray, transform_from_quaternion

FIRST_STAMP = 1_000_000_000
"""Stamp of frame 0 of a sequence that has no times [ns]."""

IMAGE_ENDINGS = frozenset(
    (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".tif", ".tiff", ".bmp", ".webp", ".exr")
)
PAIRING = 0.02
"""Images of two cameras belong together when their stamps differ by less [s]."""

Stamped = list[tuple[int, Path]]
"""Image files with their stamps [ns], in order."""

# From this number on, a time without a point is in so many parts of a second.
_UNITS = ((1e17, 1), (1e14, 1_000), (1e11, 1_000_000), (1e8, 1_000_000_000))


def images_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Image files that a pattern finds in a folder, in the order of the numbers in their names."""
    found = [path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_ENDINGS]
    return sorted(found, key=lambda path: [(len(n), n) for n in re.findall(r"\d+", path.stem)])


def as_nanoseconds(text: str) -> int:
    """A time as nanoseconds; whether it is in s, ms, µs or ns is told by its size."""
    whole, point, part = text.partition(".")
    value = int(whole)
    if not point:
        for least, unit in _UNITS:
            if value >= least:
                return value * unit
    return value * 1_000_000_000 + int((part + "000000000")[:9])


def stamped_by_name(files: Sequence[Path], rate: float) -> Stamped:
    """Stamps from names: a time, or the number of the frame at `rate` [Hz].

    Raises:
        BagError: names have no number, or two have the same.
    """
    numbers = [re.findall(r"\d+(?:\.\d+)?", path.stem) for path in files]
    if len(files) == 1:
        return [(FIRST_STAMP, files[0])]
    if missing := [path.name for path, found in zip(files, numbers, strict=True) if not found]:
        raise BagError(f"{missing[0]} has no number in its name: give the times by --stamps")
    last = [found[-1] for found in numbers]
    if all("." in text or float(text) >= _UNITS[-1][0] for text in last):
        stamps = [as_nanoseconds(text) for text in last]
    else:
        stamps = [FIRST_STAMP + round(1e9 * float(text) / rate) for text in last]
    if len(set(stamps)) < len(stamps):
        raise BagError(
            f"the names in {files[0].parent} give several images one time: give times by --stamps"
        )
    return sorted(zip(stamps, files, strict=True))


def stamped_by_file(files: Sequence[Path], table: Path) -> Stamped:
    """Stamps from a table: a time a line in the order of the files, or a time and a file's name.

    Raises:
        BagError: the table cannot be read, or does not fit the files.
    """
    rows = read_rows(table)
    names = {path.name: path for path in files} | {path.stem: path for path in files}
    try:
        if all(len(row) == 1 for row in rows):
            if len(rows) != len(files):
                raise BagError(f"{table} has {len(rows)} times for {len(files)} images")
            stamps = [_from_start(row[0]) for row in rows]
            return list(zip(stamps, files, strict=True))
        listed = [(as_nanoseconds(row[0]), names.get(Path(row[1]).name)) for row in rows]
    except ValueError as error:
        raise BagError(f"{table} has a line that is no time: {error}") from error
    found = [(stamp, path) for stamp, path in listed if path is not None]
    if not found:
        raise BagError(f"{table} names none of the images in {files[0].parent}")
    return found


def _from_start(text: str) -> int:
    """A time as nanoseconds; one that counts from the start of the sequence is moved from zero."""
    value = float(text)
    return FIRST_STAMP + round(1e9 * value) if value < 1e8 else as_nanoseconds(text)


def read_rows(table: Path) -> list[list[str]]:
    """Cells of a table with spaces or commas between them; lines that begin with # are left out.

    Raises:
        BagError: the file cannot be read or has no line.
    """
    try:
        lines = table.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{table} cannot be read: {error}") from error
    kept = [line for line in lines if line.strip() and not line.lstrip().startswith(("#", "%"))]
    rows = [[cell for cell in re.split(r"[\s,;]+", line.strip()) if cell] for line in kept]
    if rows and not re.match(r"^[-+.\d]", rows[0][0]):
        rows = rows[1:]  # names of the columns
    if not rows:
        raise BagError(f"{table} holds no line of numbers")
    return rows


def paired(first: Stamped, second: Stamped) -> tuple[Stamped, Stamped]:
    """Those of both that belong together: nearest in time, and no more than `PAIRING` apart.

    Raises:
        BagError: none do.
    """
    if not first or not second:
        return [], []
    stamps = np.array([stamp for stamp, _ in second])
    left, right = [], []
    for stamp, path in first:
        place = int(np.argmin(np.abs(stamps - stamp)))
        if abs(int(stamps[place]) - stamp) <= 1e9 * PAIRING:
            left.append((stamp, path))
            right.append((stamp, second[place][1]))
    if not left:
        raise BagError(
            f"no image in {first[0][1].parent} is within {PAIRING} s of one in "
            f"{second[0][1].parent}: the first are at {first[0][0]} and {second[0][0]} ns"
        )
    return left, right


def read_poses(table: Path, frames: Sequence[int]) -> tuple[list[tuple[int, FloatArray]], bool]:
    """Poses from a table, and whether they are of the body that carries the camera.

    TUM: ``t x y z qx qy qz qw``, of the camera. EuRoC: ``t, x, y, z, qw, qx, qy, qz, ...`` with
    commas, of the body. KITTI: 3x4 matrices row by row, a line for each frame, of camera 0.

    Args:
        table: the file.
        frames: stamps of the frames [ns].

    Raises:
        BagError: the file cannot be read or is of another form.
    """
    rows = read_rows(table)
    try:
        values = [[float(cell) for cell in row] for row in rows]
        columns = len(values[0])
        if columns == 12:
            if len(values) < len(frames):
                raise BagError(f"{table} has {len(values)} poses for {len(frames)} frames")
            bottom = [0.0, 0.0, 0.0, 1.0]
            matrices = [np.reshape(row + bottom, (4, 4)) for row in values]
            return [(s, nearest_rigid(m)) for s, m in zip(frames, matrices, strict=False)], True
        if columns < 8:
            raise BagError(f"{table} has {columns} columns, expected 8 (TUM, EuRoC) or 12 (KITTI)")
        is_body = "," in table.read_text(encoding="utf-8")
        order = (5, 6, 7, 4) if is_body else (4, 5, 6, 7)
        return [
            (_from_start(cells[0]), transform_from_quaternion([row[i] for i in order], row[1:4]))
            for cells, row in zip(rows, values, strict=True)
        ], is_body
    except (ValueError, IndexError) as error:
        raise BagError(f"{table} is no table of poses: {error}") from error


def read_inertial(table: Path, frame_id: str) -> list[ImuRecord]:
    """Samples of an inertial sensor as EuRoC and TUM-VI have them, in order of time.

    A line each: time, angular velocity [rad/s], acceleration [m/s^2].

    Raises:
        BagError: the file cannot be read or is of another form.
    """
    try:
        samples = [
            ImuRecord(_from_start(row[0]), frame_id, values[:3], values[3:])
            for row in read_rows(table)
            if np.isfinite(values := np.array(row[1:7], dtype=float).reshape(6)).all()
        ]
    except (ValueError, IndexError) as error:
        raise BagError(f"{table} is no table of an inertial sensor: {error}") from error
    return sorted(samples, key=lambda sample: sample.stamp)


def nearest_rigid(matrix: FloatArray) -> FloatArray:
    """The transform with its rotation, rounded in the file, made exact, shape (4, 4)."""
    pose = np.array(matrix, dtype=np.float64)
    if np.isfinite(pose).all() and pose.shape == (4, 4):
        left, _, right = np.linalg.svd(pose[:3, :3])
        nearest = left @ right
        if np.allclose(nearest, pose[:3, :3], atol=1e-3):
            pose[:3, :3] = nearest
    return pose


@dataclass(frozen=True, eq=False)
class ColorCamera:
    """The color camera of a depth camera, parallel to it.

    Attributes:
        camera: its undistorted image.
        offset: of a point's coordinates, from the depth camera's to this one's, (x, y, z) [m].
    """

    camera: PinholeCamera
    offset: tuple[float, float, float]

    @property
    def T_color_depth(self) -> FloatArray:
        """Takes points in the depth camera's frame to this one's, shape (4, 4)."""
        return make_transform(np.eye(3), self.offset)


def register_depth(
    depth: NDArray[np.uint16], camera: PinholeCamera, color: ColorCamera
) -> NDArray[np.uint16]:
    """The depth image that the color camera would have seen.

    Args:
        depth: shape (H, W) [mm], 0 where not measured.
        camera: of the depth image.
        color: where it is to be seen from.

    Returns:
        Shape of the color image [mm]; of several points in one pixel the nearest.
    """
    v, u = np.nonzero(depth)
    z = 1e-3 * depth[v, u].astype(np.float64)
    rays = np.column_stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))]
    )
    points = transform_points(color.T_color_depth, rays * z[:, None])
    pixels = np.rint(color.camera.project(points))
    size = [color.camera.width, color.camera.height]
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    columns, rows = pixels[inside].astype(np.int64).T
    seen = np.rint(1e3 * points[inside, 2]).astype(np.uint16)
    result = np.full(size[::-1], np.iinfo(np.uint16).max, np.uint16)
    np.minimum.at(result, (rows, columns), seen)
    result[result == np.iinfo(np.uint16).max] = 0
    return result
