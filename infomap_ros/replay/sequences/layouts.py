"""Folders of images in the layouts that people have, as sequences that can be mapped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from infomap_ros.errors import BagError, CalibrationError, InvalidInputError
from infomap_ros.geometry import (
    CameraCalibration,
    PinholeCamera,
    check_transform,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.replay.sequences.calibration_files import Calibration, read_calibration
from infomap_ros.replay.sequences.frame_files import (
    ColorCamera,
    Stamped,
    images_in,
    nearest_rigid,
    paired,
    read_inertial,
    read_poses,
    register_depth,
    stamped_by_file,
    stamped_by_name,
)
from infomap_ros.replay.sequences.sequence import ImageSequence, Pixels, Stream, read_image

_KITTI_PAIRS = (
    *(("image_0", "image_1"), ("image_2", "image_3"), ("image_00", "image_01")),
    *(("image_02", "image_03"), ("image_l", "image_r")),
)
_PAIRS = (
    ("left", "right"),
    *_KITTI_PAIRS,
    *(("infra1", "infra2"), ("cam0", "cam1"), ("mav0/cam0", "mav0/cam1"), ("camera0", "camera1")),
)
_DEPTHS = tuple(("depth", color) for color in ("rgb", "color", "image", "images", "."))
_PAIR_NAMES = (("*left*", "*right*"), ("*_l.*", "*_r.*"), ("*L.*", "*R.*"), ("im0.*", "im1.*"))
_DEPTH_NAMES = tuple(("*depth*", color) for color in ("*color*", "*rgb*"))

_CALIBRATIONS = (
    *(("camchain*.yaml",), ("*camchain*.yaml",), ("calib.txt",), ("calib_cam_to_cam.txt",)),
    *(("left.yaml", "right.yaml"), ("left_camera_info.yaml", "right_camera_info.yaml")),
    *(("cam0/sensor.yaml", "cam1/sensor.yaml"), ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml")),
    *(("intrinsics.yml", "extrinsics.yml"), ("stereo*.y*ml",), ("*calib*.y*ml",)),
    *(("camera-intrinsics.txt",), ("camera_info.yaml",), ("intrinsics.txt",)),
)
"""Names of calibration files that are looked for, two of a pair of cameras."""

_UNTIED = "the calibration does not say where it is on the cameras (T_cam_imu, T_BS)"
_OPTICAL_DOWN = (0.0, 1.0, 0.0)
"""What points down in poses that begin with an optical frame."""

_KINECT = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
"""What the makers of the TUM benchmark recommend for its registered depth images."""


@dataclass(frozen=True)
class SequenceOptions:
    """What is told of a folder of images, beside what is found in it.

    Attributes:
        calibration: files: one, or the left and the right camera's; looked for where empty.
        left: pattern of the left images, below the folder; looked for where empty.
        right: pattern of the right ones.
        depth: pattern of depth images.
        color: pattern of the color images beside them.
        stamps: table of times; the names of the images where None.
        rate: at which numbered frames were taken [Hz].
        poses: table of poses; looked for where None.
        depth_unit: of the numbers in depth images [m]; the layout's own where 0.
        is_rectified: whether the images are; what the calibration says where None.
        down: direction of gravity in the frame of the poses; the layout's own where empty.
    """

    calibration: Sequence[Path] = ()
    left: str = ""
    right: str = ""
    depth: str = ""
    color: str = ""
    stamps: Path | None = None
    rate: float = 10.0
    poses: Path | None = None
    depth_unit: float = 0.0
    is_rectified: bool | None = None
    down: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.rate > 0.0:
            raise InvalidInputError("--rate", f"{self.rate:g} Hz, expected more than 0")
        if self.depth_unit < 0.0:
            raise InvalidInputError("--depth-unit", f"{self.depth_unit:g} m, expected 0 or more")


def images(folder: Path, options: SequenceOptions) -> ImageSequence:
    """Images of two cameras, or of a depth camera, in folders or by names of their own.

    Raises:
        BagError: they are not there, or do not fit each other; says what the folder holds.
        CalibrationError: there is no calibration that fits.
    """
    stereo = _files(folder, options.left, options.right, _PAIRS, _PAIR_NAMES)
    depth = None
    if stereo is None or options.depth:
        depth = _files(folder, options.depth, options.color, _DEPTHS, _DEPTH_NAMES)
        if depth is None and options.depth:
            depth = (_matching(folder, options.depth), [])
        elif depth is None and (alone := images_in(folder / "depth")):
            depth = (alone, [])
    options = _with_poses(folder, options, ("poses.txt", "groundtruth.txt"))
    if depth is not None:
        return _depth_sequence("images", folder, *_stamped(*depth, options), options)
    if stereo is None:
        raise BagError(
            f"no pairs of images (left and right) and no depth images in {folder}: it holds "
            f"{listing(folder)}. infomap convert takes them by --left and --right, or --depth "
            "and --color"
        )
    return _stereo_sequence("images", folder, *_stamped(*stereo, options), options)


def euroc(folder: Path, options: SequenceOptions) -> ImageSequence:
    """EuRoC and TUM-VI: ``[mav0/]cam0``, ``cam1``, named by time; ``imu0``, and poses, of the body.

    Raises:
        BagError: it is laid out in another way, or not complete.
        CalibrationError: there is no calibration that fits.
    """
    root = folder / "mav0" if (folder / "mav0").is_dir() else folder
    found = _files(root, "", "", (("cam0", "cam1"),), ())
    if found is None:
        raise BagError(f"no cam0 and cam1 with images in {folder}: it holds {listing(folder)}")
    tables = ("state_groundtruth_estimate0/data.csv", "mocap0/data.csv", "gt*.csv", "*gt*/*.csv")
    options = _with_poses(root, options, tables)
    names = ("imu0/data.csv", "imu*/data.csv", "imu*.csv", "imu*.txt")
    inertial = next((path for name in names for path in sorted(root.glob(name))), None)
    return _stereo_sequence("euroc", root, *_stamped(*found, options), options, inertial)


def kitti(folder: Path, options: SequenceOptions) -> ImageSequence:
    """KITTI odometry: ``image_0``, ``image_1`` (or 2, 3), ``calib.txt``, ``times.txt``, poses.

    Raises:
        BagError: it is laid out in another way, or not complete.
        CalibrationError: there is no calibration that fits.
    """
    found = _files(folder, "", "", _KITTI_PAIRS, ())
    if found is None:
        raise BagError(f"no image_0 and image_1 in {folder}: it holds {listing(folder)}")
    number = folder.resolve().name
    options = _with_poses(folder, options, ("poses.txt", f"../../poses/{number}.txt"))
    times = folder / "times.txt"
    if options.stamps is None and times.is_file():
        options = replace(options, stamps=times)
    options = replace(options, down=options.down or _OPTICAL_DOWN)
    return _stereo_sequence("kitti", folder, *_stamped(*found, options), options)


def tum(folder: Path, options: SequenceOptions) -> ImageSequence:
    """TUM RGB-D: ``rgb.txt`` and ``depth.txt`` with times and names, ``groundtruth.txt``.

    Raises:
        BagError: it is laid out in another way, or not complete.
        CalibrationError: there is no calibration that fits.
    """
    tables = folder / "depth.txt", folder / "rgb.txt"
    if not all(table.is_file() for table in tables):
        raise BagError(f"no rgb.txt and depth.txt in {folder}: it holds {listing(folder)}")
    depth, color = (stamped_by_file(images_in(folder, f"{t.stem}/*"), t) for t in tables)
    options = _with_poses(folder, options, ("groundtruth.txt",))
    options = replace(options, depth_unit=options.depth_unit or 1.0 / 5000.0)
    return _depth_sequence("tum", folder, *paired(depth, color), options, _KINECT)


def rgbd(folder: Path, options: SequenceOptions) -> ImageSequence:
    """Frames ``frame-N.depth.png``, ``frame-N.color.*`` and their ``frame-N.pose.txt``.

    As 7-Scenes, Sun3D and others have them: 4x4 camera-to-world matrices; frames whose pose is
    not one (lost tracking) are left out.

    Raises:
        BagError: it is laid out in another way, or not complete.
        CalibrationError: there is no calibration that fits.
    """
    root = folder / "frames" if (folder / "frames").is_dir() else folder
    depth = stamped_by_name(images_in(root, "frame-*.depth.*"), options.rate)
    if not depth:
        raise BagError(f"no frame-*.depth.png in {folder}: it holds {listing(folder)}")
    colors = {p.name.split(".")[0]: p for p in images_in(root, "frame-*.color.*")}
    kept, poses = [], []
    for stamp, path in depth:
        name = path.name.split(".")[0]
        if name not in colors:
            raise BagError(f"{root / name}.color.* is missing")
        pose = _matrix_in(root / f"{name}.pose.txt")
        if pose is not None:
            kept.append((stamp, path))
            poses.append((stamp, pose))
    beside = [(stamp, colors[path.name.split(".")[0]]) for stamp, path in kept]
    options = replace(options, down=options.down or _OPTICAL_DOWN)
    return _depth_sequence("rgbd", folder, kept, beside, options, None, poses)


LAYOUTS: dict[str, Callable[[Path, SequenceOptions], ImageSequence]] = {
    "euroc": euroc,
    "kitti": kitti,
    "tum": tum,
    "rgbd": rgbd,
    "images": images,
}
"""Layouts by name, the more particular ones first."""


def find_sequence(folder: Path, options: SequenceOptions) -> ImageSequence:
    """The sequence in a folder, in the first layout that it has.

    Raises:
        BagError: it has none; says what it holds.
        CalibrationError: there is no calibration that fits.
    """
    marks: dict[str, bool] = {
        "euroc": any((folder / name).is_dir() for name in ("mav0", "cam0")),
        "kitti": any((folder / pair[0]).is_dir() for pair in _KITTI_PAIRS),
        "tum": (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file(),
        "rgbd": any(_below(folder, "frame-*.pose.txt")),
    }
    name = next((name for name, is_there in marks.items() if is_there), "images")
    return LAYOUTS[name](folder, options)


def listing(folder: Path) -> str:
    """What a folder holds, in a line: folders, and files by their endings."""
    entries = sorted(folder.iterdir()) if folder.is_dir() else []
    parts = []
    for sub in [entry for entry in entries if entry.is_dir()][:8]:
        count = sum(1 for _ in sub.iterdir())
        parts.append(f"{sub.name}/ ({count} entries)")
    endings = Counter(entry.suffix or entry.name for entry in entries if entry.is_file())
    parts += [f"{count} {ending}" for ending, count in endings.most_common(8)]
    return ", ".join(parts) or "nothing"


def _below(folder: Path, pattern: str) -> Iterator[Path]:
    yield from folder.glob(pattern)
    yield from folder.glob(f"frames/{pattern}")


def _matching(folder: Path, pattern: str) -> list[Path]:
    """Images that a pattern of the user finds; a folder stands for all in it.

    Raises:
        BagError: there are none.
    """
    found = images_in(folder, f"{pattern}/*") if (folder / pattern).is_dir() else []
    found = found or images_in(folder, pattern)
    if not found:
        raise BagError(f"no image {pattern} in {folder}: it holds {listing(folder)}")
    return found


def _files(
    folder: Path,
    first: str,
    second: str,
    folders: Sequence[tuple[str, str]],
    names: Sequence[tuple[str, str]],
) -> tuple[list[Path], list[Path]] | None:
    """Images of two cameras: by the user's patterns, by folders, or by names; None without."""
    if first and second:
        return _matching(folder, first), _matching(folder, second)
    for pair in folders:
        for inner in ("", "data", "image_raw"):
            found = [images_in(folder / name / inner) for name in pair]
            if all(found):
                return found[0], found[1]
    for pair in names:
        found = [images_in(folder, pattern) for pattern in pair]
        if all(found):
            return found[0], found[1]
    return None


def _stamped(
    first: list[Path], second: list[Path], options: SequenceOptions
) -> tuple[Stamped, Stamped]:
    """Both cameras' images with their stamps, as they belong together."""

    def stamped(files: list[Path]) -> Stamped:
        if options.stamps is not None:
            return stamped_by_file(files, options.stamps)
        return stamped_by_name(files, options.rate)

    return paired(stamped(first), stamped(second)) if second else (stamped(first), [])


def _with_poses(folder: Path, options: SequenceOptions, names: Sequence[str]) -> SequenceOptions:
    """With the table of poses that lies in the folder, where none is given."""
    if options.poses is not None:
        return options
    found = next((path for name in names for path in sorted(folder.glob(name))), None)
    return replace(options, poses=found)


def _calibration(
    folder: Path, options: SequenceOptions, first: Stamped, known: PinholeCamera | None = None
) -> tuple[Calibration, str]:
    """The calibration, and where it is from."""
    size = _size_of(first)
    files = list(options.calibration)
    if not files:
        for names in _CALIBRATIONS:
            found = [sorted(folder.glob(name))[:1] for name in names]
            if all(found):
                files = [paths[0] for paths in found]
                break
    if files:
        return read_calibration(files, size), ", ".join(str(path) for path in files)
    if known is not None and (known.width, known.height) == size:
        said = f"no calibration in {folder}: {known.fx:g} px of focal length are assumed"
        return Calibration((_plain(known),), is_rectified=True), said
    raise CalibrationError(
        f"no calibration in {folder} (it holds {listing(folder)}): give one by --calibration, "
        "of Kalibr, EuRoC, ROS, OpenCV, KITTI or Middlebury"
    )


def _size_of(images: Stamped) -> tuple[int, int]:
    """Width and height of the first image that can be read [px].

    Raises:
        BagError: none can.
    """
    failure = BagError("there is no image")
    for _, path in images:
        try:
            height, width = read_image(path).shape[:2]
            return width, height
        except BagError as error:
            failure = error
    raise failure


def _plain(camera: PinholeCamera) -> CameraCalibration:
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])
    return CameraCalibration(
        camera.width, camera.height, "plumb_bob", np.zeros(5), camera.matrix, np.eye(3), projection
    )


def _stereo_sequence(
    layout: str,
    folder: Path,
    left: Stamped,
    right: Stamped,
    options: SequenceOptions,
    inertial: Path | None = None,
) -> ImageSequence:
    read, names = _calibration(folder, options, left)
    calibration = read.as_pair(names)
    rectified = options.is_rectified
    if rectified is None:
        rectified = calibration.is_rectified
    if rectified is None:  # a ROS calibration is of the raw images
        rectified = not any(np.any(camera.distortion) for camera in calibration.cameras)
    sides = zip(("left", "right"), calibration.cameras, (left, right), strict=False)
    streams = tuple(
        Stream(name, f"{name}_optical_frame", camera, rectified, files)
        for name, camera, files in sides
    )
    turn = make_transform(calibration.cameras[0].rectification, [0.0, 0.0, 0.0])
    poses = _poses(options, left, calibration, turn)
    if inertial is None:
        return ImageSequence(layout, streams, poses)
    if calibration.T_first_body is None:
        return ImageSequence(layout, streams, poses, (f"{inertial} is not used: {_UNTIED}",))
    try:
        samples = read_inertial(inertial, "imu")
    except BagError as error:
        return ImageSequence(layout, streams, poses, (f"not used: {error}",))
    return ImageSequence(layout, streams, poses, (), samples, turn @ calibration.T_first_body)


def _depth_sequence(
    layout: str,
    folder: Path,
    depth: Stamped,
    color: Stamped,
    options: SequenceOptions,
    known: PinholeCamera | None = None,
    poses: Sequence[tuple[int, FloatArray]] | None = None,
) -> ImageSequence:
    """Depth images; where the calibration is of two cameras, they are registered to the color."""
    calibration, found = _calibration(folder, options, depth, known)
    remarks = (found,) if found.startswith("no calibration") else ()
    unit = options.depth_unit or 1e-3
    camera, T_color_depth = calibration.cameras[0], calibration.T_second_first
    change = lambda pixels: _in_meters(pixels, unit)  # noqa: E731
    shift = np.eye(4)
    if len(calibration.cameras) > 1 and T_color_depth is not None and color:
        seen_by = ColorCamera(_pinhole(calibration.cameras[1]), tuple(T_color_depth[:3, 3]))
        source, camera = _pinhole(camera), _plain(seen_by.camera)
        change = lambda pixels: register_depth(_counts(pixels), source, seen_by)  # noqa: E731
        shift = T_color_depth
    if not camera.projection.any():
        camera = _plain(_pinhole(camera))
    frame = "camera_optical_frame"
    streams = [Stream("depth", frame, camera, True, depth, change)]
    if color:
        streams.append(Stream("rgb", frame, camera, True, color))
    if poses is None:
        path = _poses(options, depth, calibration, np.eye(4))
    else:
        T_map_world = levelled(options.down)
        path = [(stamp, T_map_world @ pose @ invert_transform(shift)) for stamp, pose in poses]
    return ImageSequence(layout, tuple(streams), path, remarks)


def _pinhole(camera: CameraCalibration) -> PinholeCamera:
    k = camera.intrinsics
    return PinholeCamera(camera.width, camera.height, k[0, 0], k[1, 1], k[0, 2], k[1, 2])


def _in_meters(pixels: Pixels, unit: float) -> Pixels:
    """Depth as ROS has it: mm in 16 bits, or m in floats, NaN where there is none.

    Raises:
        BagError: it is no depth image.
    """
    if pixels.ndim != 2:
        raise BagError(f"a depth image has {pixels.shape[2]} channels, expected one")
    if pixels.dtype == np.uint16 and unit == 1e-3:
        return pixels
    if np.issubdtype(pixels.dtype, np.floating):
        return pixels.astype(np.float32)
    meters = pixels.astype(np.float32) * np.float32(unit)
    meters[pixels == 0] = np.nan
    return meters


def _counts(pixels: Pixels) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    return np.asarray(pixels, dtype=np.uint16)


def _poses(
    options: SequenceOptions, frames: Stamped, calibration: Calibration, turn: FloatArray
) -> list[tuple[int, FloatArray]]:
    """T_map_camera of the first camera, whose rectified frame `turn` leads to from the raw one."""
    if options.poses is None:
        return []
    poses, are_body = read_poses(options.poses, [stamp for stamp, _ in frames])
    T_camera_body = turn
    if are_body and calibration.T_first_body is not None:
        T_camera_body = turn @ calibration.T_first_body
    T_map_world, T_body_camera = levelled(options.down), invert_transform(T_camera_body)
    return [(stamp, T_map_world @ pose @ T_body_camera) for stamp, pose in poses]


def levelled(down: Sequence[float]) -> FloatArray:
    """Transform to a frame with z up whose x axis runs level along the old z axis, (4, 4).

    Args:
        down: direction of gravity in the old frame; nothing is turned where empty.
    """
    if not down:
        return np.eye(4)
    up = -np.asarray(down, dtype=np.float64) / np.linalg.norm(down)
    left = np.cross(up, [0.0, 0.0, 1.0])
    left /= np.linalg.norm(left)
    return make_transform([np.cross(left, up), left, up], [0.0, 0.0, 0.0])


def _matrix_in(path: Path) -> FloatArray | None:
    """The transform in a file, shape (4, 4); None where it is not one.

    Raises:
        BagError: the file is not there, or holds something else.
    """
    try:
        return check_transform(nearest_rigid(np.loadtxt(path)), path.name)
    except InvalidInputError:
        return None
    except (OSError, ValueError) as error:
        raise BagError(f"{path} cannot be read: {error}") from error
