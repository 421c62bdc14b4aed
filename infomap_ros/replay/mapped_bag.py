"""A bag or a folder of images as a map, or as a trajectory, in one call.

A recording that somebody has: a bag, or a folder of images.
"""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import BagError
from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.replay.bags.reader import BagReader, Recording
from infomap_ros.replay.localize_run import LocalizeOptions, LocalizeRun, Trajectory
from infomap_ros.replay.map_files import PAGE_FILE, write_map_files
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.sequences import SequenceOptions, SequenceReader, find_sequence

__all__ = ["Recording", "open_recording"]

_BAG_FILES = ("*.mcap", "*.db3", "metadata.yaml", "*.mcap.zstd", "*.db3.zstd")


def open_recording(path: Path | str, calibration: Sequence[Path] = ()) -> Recording:
    """Open a bag, or a folder of images in one of the layouts of `infomap_ros.replay.sequences`.

    Args:
        path: rosbag2 folder or file, ROS 1 bag, or folder of images.
        calibration: files with the calibration of the images; looked for in the folder where
            none is given. Not for bags, which hold their own.

    Raises:
        BagError: there is nothing, or it cannot be read; says what is there.
    """
    path = Path(path)
    is_folder = path.is_dir() and not any(list(path.glob(name)) for name in _BAG_FILES)
    if is_folder:
        return SequenceReader(path, find_sequence(path, SequenceOptions(calibration=calibration)))
    if calibration:
        raise BagError(f"{path} is a bag: the calibration is in its camera infos")
    return BagReader(path)


@dataclass(frozen=True, eq=False)
class MappedBag:
    """What mapping a bag gave.

    Attributes:
        name: of the bag.
        map: the voxel map.
        camera_path: positions of the camera, shape (N, 3) [m, map].
        summary: figures of the run, by name.
    """

    name: str
    map: VoxelMap
    camera_path: FloatArray
    summary: dict[str, int | float | str]

    def __repr__(self) -> str:
        return f"MappedBag({self.name!r}, {self.summary['frames']} frames, {self.map!r})"

    def surface(self) -> tuple[FloatArray, FloatArray]:
        """Points of the surface, shape (K, 3) [m], and their covariances, shape (K, 3, 3) [m^2]."""
        _, means, covariances = self.map.gaussians()
        return means, covariances

    def probability(self, points: Sequence[Sequence[float]] | FloatArray) -> NDArray[np.float64]:
        """How likely places are occupied, shape (N,); 0.5 where nothing is known.

        Args:
            points: shape (N, 3) [m, map].
        """
        return np.asarray(self.map.probability(np.asarray(points, dtype=np.float64)))

    def draw(self, path: str | Path) -> None:
        """Write a picture of the map from above and from the side, with the camera's path.

        Raises:
            OSError: the file cannot be written.
        """
        draw_map_views(self.map, path, self.name, self.camera_path)

    def show(self) -> Path:
        """Open the map in 3-D in a browser; returns the page."""
        page = Path(mkdtemp(prefix="infomap_ros-")) / PAGE_FILE
        write_map_report(
            page, self.map, self.name, figures=self.summary, camera_path=self.camera_path
        )
        webbrowser.open(page.as_uri())
        return page


def map_bag(
    path: str | Path,
    *,
    voxel_size: float | None = None,
    max_range: float | None = None,
    calibration: str | Path | Sequence[str | Path] = (),
    options: MapOptions | None = None,
    out: str | Path | None = None,
) -> MappedBag:
    """Map a bag or a folder of images, as ``infomap map`` does.

    Args:
        path: rosbag2 folder or file, ROS 1 bag, or folder of images.
        voxel_size: edge of a voxel [m]; where neither size is given, those of the options, or
            larger ones where the scene is large (``input.fit_scene``).
        max_range: farthest mapped point [m].
        calibration: of a folder of images; one file, or the left and the right camera's.
        options: all settings; the defaults where not given.
        out: folder for the files that the command writes; nothing is written where not given.

    Raises:
        BagError: it lacks what mapping needs, or no frame could be mapped; says why.
        CalibrationError: there is no calibration that fits the images.
        ConfigError: a value is out of its range.
    """
    options = options or MapOptions()
    sizes = {"voxel_size": voxel_size, "max_range": max_range}
    given: dict[str, Any] = {name: value for name, value in sizes.items() if value is not None}
    if given:
        chosen = replace(options.input, fit_scene=False)
        options = replace(options, map=replace(options.map, **given), input=chosen)
    with open_recording(path, _files(calibration)) as recording:
        run = MapRun(recording, options)
        run.run()
        summary = run.summary() if out is None else write_map_files(run, Path(out))
    return MappedBag(run.name, run.map, np.reshape(run.camera_path, (-1, 3)), summary)


def localize_bag(
    path: str | Path,
    *,
    calibration: str | Path | Sequence[str | Path] = (),
    options: LocalizeOptions | None = None,
) -> Trajectory:
    """Estimate the camera's trajectory in a bag or a folder of images, as ``infomap localize``.

    Args:
        path: rosbag2 folder or file, ROS 1 bag, or folder of images.
        calibration: of a folder of images; one file, or the left and the right camera's.
        options: all settings; the defaults where not given.

    Returns:
        Stamps, poses and covariances, corrected by all that was learned later.

    Raises:
        BagError: it lacks what localization needs, or the camera was never located; says why.
        CalibrationError: there is no calibration that fits the images.
    """
    with open_recording(path, _files(calibration)) as recording:
        run = LocalizeRun(recording, options)
        run.run()
    return run.log.corrected_trajectory


def _files(calibration: str | Path | Sequence[str | Path]) -> list[Path]:
    one = isinstance(calibration, str | Path)
    return [Path(calibration)] if one else [Path(path) for path in calibration]  # type: ignore
