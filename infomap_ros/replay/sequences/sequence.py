"""A sequence of images in files, read as a bag is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import BagError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PoseRecord,
    Record,
)
from infomap_ros.geometry.records import ImuRecord, TransformRecord
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import CAMERA_INFO, IMAGE, IMU, POSE_WITH_COVARIANCE, TF
from infomap_ros.replay.bags.reader import BagRecord
from infomap_ros.replay.bags.source import EVER, Channel
from infomap_ros.replay.sequences.frame_files import Stamped

POSE_TOPIC, IMU_TOPIC, TF_STATIC_TOPIC = "/camera_pose", "/imu", "/tf_static"

Pixels = NDArray[np.generic]


@dataclass(frozen=True, eq=False)
class Stream:
    """The images of one camera.

    Attributes:
        name: namespace of its topics: ``left``, ``right``, ``depth``, ``rgb``.
        frame_id: of its optical frame.
        calibration: of the camera.
        is_rectified: whether the images are rectified.
        files: with their stamps [ns].
        change: done to the pixels of each image.
    """

    name: str
    frame_id: str
    calibration: CameraCalibration
    is_rectified: bool
    files: Stamped
    change: Callable[[Pixels], Pixels] = field(default=lambda pixels: pixels)

    @property
    def info_topic(self) -> str:
        """Topic of its camera infos."""
        return f"/{self.name}/camera_info"

    @property
    def image_topic(self) -> str:
        """Topic of its images."""
        return f"/{self.name}/image_{'rect' if self.is_rectified else 'raw'}"

    def records(self, place: int) -> Iterator[tuple[str, Callable[[], Record]]]:
        """Topic of each record of a frame, and what makes it."""
        stamp, path = self.files[place]
        yield self.info_topic, lambda: CameraInfoRecord(stamp, self.frame_id, self.calibration)
        yield self.image_topic, lambda: self._image(stamp, path)

    def _image(self, stamp: int, path: Path) -> ImageRecord:
        pixels = self.change(read_image(path))
        size = pixels.shape[1], pixels.shape[0]
        expected = self.calibration.width, self.calibration.height
        if size != expected:
            raise BagError(
                f"{path} has {size[0]}x{size[1]} px, its calibration {expected[0]}x{expected[1]}"
            )
        if self.name == "depth":
            encoding = "16UC1" if pixels.dtype == np.uint16 else "32FC1"
            return ImageRecord(stamp, self.frame_id, pixels, encoding)
        return image_record(stamp, self.frame_id, pixels)


@dataclass(frozen=True, eq=False)
class ImageSequence:
    """Images of one or two cameras, and where the first one was.

    Attributes:
        layout: how the folder is laid out.
        streams: as many images in each.
        poses: stamps [ns] and T_map_camera of the (rectified) first camera, shape (4, 4); empty
            where nobody knows.
        remarks: what was assumed, in sentences.
        inertial: samples of a sensor that is fixed to the cameras, in order of time.
        T_camera_inertial: where that is on the (rectified) first camera, shape (4, 4).
    """

    layout: str
    streams: tuple[Stream, ...]
    poses: Sequence[tuple[int, FloatArray]] = ()
    remarks: tuple[str, ...] = ()
    inertial: Sequence[ImuRecord] = ()
    T_camera_inertial: FloatArray | None = None

    def events(self) -> Iterator[tuple[str, int, Callable[[], Record]]]:
        """Topic, stamp and maker of every record, in order of time."""
        first, T = self.streams[0], self.T_camera_inertial
        if self.inertial and T is not None:
            begin = self.inertial[0]
            edge = TransformRecord(begin.stamp, first.frame_id, begin.frame_id, T, True)
            yield TF_STATIC_TOPIC, edge.stamp, lambda: edge
        kinds = self.poses, first.files, [(sample.stamp, sample) for sample in self.inertial]
        order = [
            (stamp, kind, place)
            for kind, entries in enumerate(kinds)
            for place, (stamp, _) in enumerate(entries)
        ]
        for stamp, kind, place in sorted(order):
            if kind == 1:
                for stream in self.streams:
                    for topic, make in stream.records(place):
                        yield topic, stamp, make
            else:
                topic = IMU_TOPIC if kind else POSE_TOPIC
                yield topic, stamp, partial(self._other_record, kind, place)

    def _other_record(self, kind: int, place: int) -> Record:
        """A sample of the inertial sensor, or a pose."""
        if kind:
            return self.inertial[place]
        stamp, pose = self.poses[place]
        return PoseRecord(stamp, "map", pose)


class SequenceReader:
    """Reads a sequence of images as a `Recording`: nothing is copied.

    Args:
        path: of the folder.
        sequence: what was found in it.
    """

    def __init__(self, path: Path, sequence: ImageSequence) -> None:
        self.path, self.sequence = path, sequence
        self.problems = list(sequence.remarks)
        self.skipped: Counter[str] = Counter()
        stamps = [stamp for stamp, _ in sequence.streams[0].files]
        frames, self.start, self.end = len(stamps), min(stamps), max(stamps)
        counted = [(POSE_TOPIC, POSE_WITH_COVARIANCE, len(sequence.poses))]
        counted += [(IMU_TOPIC, IMU, len(sequence.inertial))]
        counted += [(TF_STATIC_TOPIC, TF, int(len(sequence.inertial) > 0))]
        for stream in sequence.streams:
            counted.append((stream.info_topic, CAMERA_INFO, frames))
            counted.append((stream.image_topic, IMAGE, frames))
        self.topics = {name: Channel(name, kind, n) for name, kind, n in counted if n}

    def records(
        self, topics: Collection[str] | None = None, between: range = EVER
    ) -> Iterator[BagRecord]:
        """Records in order of time.

        Raises:
            BagError: no image can be used: none can be read, or all have another size than their
                calibration. One among others that can is counted in `skipped`.
        """
        wanted = self.topics if topics is None else topics
        whole, failure = 0, None
        for topic, stamp, make in self.sequence.events():
            if topic not in wanted or stamp not in between:
                continue
            try:
                record = make()
            except BagError as error:
                failure = failure or error
                self.skipped[f"{topic}: {error}"] += 1
                continue
            whole += isinstance(record, ImageRecord)
            yield BagRecord(topic, stamp, record)
        if failure is not None and not whole:
            raise failure

    def __enter__(self) -> SequenceReader:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""


def read_image(path: Path) -> Pixels:
    """Read an image file as it is; three channels are in the order B, G, R.

    Raises:
        BagError: there is no such file or it is not an image.
    """
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise BagError(f"{path} is not there or not an image")
    return pixels[..., :3] if pixels.ndim == 3 and pixels.shape[2] == 4 else pixels


def image_record(stamp: int, frame_id: str, pixels: Pixels) -> ImageRecord:
    """An image with the encoding that its type and channels have in files."""
    wide = pixels.dtype == np.uint16
    encoding = {2: "mono16" if wide else "mono8", 3: "bgr16" if wide else "bgr8"}[pixels.ndim]
    return ImageRecord(stamp, frame_id, np.ascontiguousarray(pixels), encoding)
