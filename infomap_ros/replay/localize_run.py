"""A recorded bag becomes a trajectory.

What a bag offers for localization: views, and what the robot knows of its motion.

What localization in a bag has found so far.

Where the camera was at every view, as known then and as known in the end.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain, takewhile

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import BagError
from infomap_ros.geometry import PoseBufferConfig, Record, WaitingQueueConfig, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.config import KeptPoses
from infomap_ros.localization.filter.motion_prior import KinematicMotion
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.messages import IMU, ODOMETRY
from infomap_ros.motion.robot.robot_model import DescriptionConfig, RobotModel
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, CameraLocalizerConfig
from infomap_ros.pipeline.inertial import InertialSensor
from infomap_ros.pipeline.perception import (
    DepthViewEstimator,
    FramedView,
    Perception,
    StereoViewEstimator,
    ViewEstimator,
)
from infomap_ros.pipeline.pipeline import Localization, Located, Pipeline
from infomap_ros.pipeline.robot_motion import RobotMotion
from infomap_ros.pipeline.view_synchronizer import ViewSynchronizer
from infomap_ros.replay.bags.background import in_background
from infomap_ros.replay.bags.image_choice import (
    ImageInputConfig,
    description_in,
    find_images,
    frame_of,
    joint_topics_of,
    moving_tf_topics,
    static_transforms,
    tf_topics_of,
    types_of,
)
from infomap_ros.replay.bags.reader import Recording
from infomap_ros.replay.bags.topics import Topics, check_present
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses with their covariances.

    Attributes:
        stamps: shape (N,), int64 [ns], ascending.
        transforms: ``T_map_camera``, shape (N, 4, 4).
        covariances: in the map frame, shape (N, 6, 6).
    """

    stamps: NDArray[np.int64]
    transforms: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.stamps)


class TrajectoryRecorder:
    """Collects poses, and hangs each on the keyframe that is nearest before it.

    Keyframes are corrected later, by a known place or the target; what hangs on one follows it. A
    keyframe that is given up hangs on another one from then on.
    """

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._transforms: list[FloatArray] = []
        self._covariances: list[FloatArray] = []
        self._anchors: list[int] = []
        self._offsets: list[FloatArray] = []  # T_keyframe_camera
        self._given_up: dict[int, tuple[int, FloatArray]] = {}  # other keyframe, T_other_this
        self._kept: dict[int, FloatArray] = {}

    def add(self, stamp: int, pose: FloatArray, covariance: FloatArray, kept: KeptPoses) -> None:
        """Add a pose.

        Args:
            stamp: of the pose [ns].
            pose: ``T_map_camera``, shape (4, 4).
            covariance: in the map frame, shape (6, 6).
            kept: keyframes as they are known now; at least one.
        """
        now = dict(zip(kept.stamps.tolist(), kept.transforms, strict=True))
        for gone in self._kept.keys() - now.keys():
            other = min(self._kept.keys() & now.keys(), key=lambda one: abs(one - gone))
            offset = invert_transform(self._kept[other]) @ self._kept[gone]
            self._given_up[gone] = (other, offset)
        self._kept = now
        anchor = max(one for one in now if one <= stamp)
        self._stamps.append(stamp)
        self._transforms.append(pose)
        self._covariances.append(covariance)
        self._anchors.append(anchor)
        self._offsets.append(invert_transform(now[anchor]) @ pose)

    def known_then(self) -> Trajectory:
        """Each pose as it was known at its stamp."""
        return self._trajectory(self._transforms)

    def known_now(self) -> Trajectory:
        """Each pose after all corrections; the covariances are those of its stamp."""
        pairs = zip(self._anchors, self._offsets, strict=True)
        return self._trajectory([self._place(anchor) @ offset for anchor, offset in pairs])

    def _place(self, keyframe: int) -> FloatArray:
        if keyframe in self._kept:
            return self._kept[keyframe]
        other, offset = self._given_up[keyframe]
        return self._place(other) @ offset

    def _trajectory(self, transforms: list[FloatArray]) -> Trajectory:
        return Trajectory(
            np.array(self._stamps, dtype=np.int64),
            np.array(transforms).reshape(-1, 4, 4),
            np.array(self._covariances).reshape(-1, 6, 6),
        )


class LocalizationLog:
    """Collects what became of each view.

    Attributes:
        localizations: one for each view, in order.
    """

    def __init__(self) -> None:
        self.localizations: list[LocalizedCamera] = []
        self._recorder = TrajectoryRecorder()

    def add(self, done: object) -> None:
        """Take in a view; anything else is ignored."""
        if not isinstance(done, Located):
            return
        result = done.result
        self.localizations.append(result)
        if result.T_map_camera is not None and result.covariance is not None:
            self._recorder.add(result.stamp, result.T_map_camera, result.covariance, done.kept)

    @property
    def trajectory(self) -> Trajectory:
        """The camera's poses as they were known at their stamps."""
        return self._recorder.known_then()

    @property
    def corrected_trajectory(self) -> Trajectory:
        """The camera's poses after all that was learnt later."""
        return self._recorder.known_now()

    def figures(self) -> dict[str, int | float | str]:
        """Counts of the views, length of the path and final standard deviations."""
        states = Counter(one.state for one in self.localizations)
        trajectory = self.trajectory
        steps = np.diff(trajectory.transforms[:, :3, 3], axis=0)
        last = trajectory.covariances[-1] if len(trajectory) else np.full((6, 6), np.nan)
        tracked = [one.tracked for one in self.localizations]
        return {
            "views": len(self.localizations),
            "poses": len(trajectory),
            "tracking": states["tracking"],
            "coasting": states["coasting"],
            "lost": states["lost"],
            "searching": states["searching"],
            "keyframes": sum(one.is_keyframe for one in self.localizations),
            "target_sightings": sum(one.target_seen for one in self.localizations),
            "mean_fiducials": round(float(np.mean(tracked)) if tracked else 0.0, 1),
            "path_length": round(float(np.linalg.norm(steps, axis=1).sum()), 4),
            "final_position_sigma": round(float(np.sqrt(np.trace(last[:3, :3]))), 6),
            "final_rotation_sigma": round(float(np.sqrt(np.trace(last[3:, 3:]))), 6),
        }


@dataclass(frozen=True)
class MotionInputConfig:
    """What is known of the camera's motion.

    Raises:
        ConfigError: a value is not among its choices or out of its range.
    """

    motion: str = parameter(
        "auto",
        "What the camera's motion is expected from: odometry (with joints or tf), nothing but "
        "that it is not too fast, or odometry where there is some, else an IMU on the camera.",
        choices=("auto", "odometry", "none"),
    )
    start_tilt: float = parameter(
        0.0,
        "How far the camera looks down at the beginning, where neither odometry, target nor IMU "
        "say what is up.",
        unit="rad",
        low=-1.6,
        high=1.6,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class LocalizeInputConfig(MotionInputConfig, ImageInputConfig):
    """Which of a bag's data tell where the camera was."""


@dataclass(frozen=True)
class CameraOptions:
    """Settings of whatever locates the camera of a bag.

    Attributes:
        topics: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``joints``; for localization also ``color`` and
            ``odometry`` and ``imu``, else ``pose``.
        robot: path or text of a URDF; the bag's robot description where empty.
    """

    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    odometry: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    depth: DepthCameraConfig = field(default_factory=DepthCameraConfig)
    poses: PoseBufferConfig = field(default_factory=PoseBufferConfig)
    waiting: WaitingQueueConfig = field(default_factory=WaitingQueueConfig)
    description: DescriptionConfig = field(default_factory=DescriptionConfig)
    topics: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""


@dataclass(frozen=True)
class LocalizeOptions(CameraOptions):
    """All settings of localization in a bag."""

    input: LocalizeInputConfig = field(default_factory=LocalizeInputConfig)


@dataclass(frozen=True)
class LocalizeInputs:
    """What was found.

    Attributes:
        perception: turns images into views.
        camera_frame: optical frame of the camera.
        motion: of the robot; None where it is not used.
        odometry_topic: empty where it is not used.
        inertial: sensor on the camera, which counts where there is no odometry.
        imu_topic: empty where it is not used.
        topics: all topics that are to be read.
        frames: number of images that should become views.
    """

    perception: Perception
    camera_frame: str
    motion: RobotMotion | None
    odometry_topic: str
    inertial: InertialSensor | None
    imu_topic: str
    topics: tuple[str, ...]
    frames: int


def find_localize_inputs(
    bag: Recording, options: LocalizeOptions, *, is_dense: bool = False
) -> LocalizeInputs:
    """Look through a bag for what localization needs; `is_dense` where range clouds are wanted too.

    Raises:
        BagError: it has no images with range, or lacks odometry that is asked for.
        RobotModelError: the robot description cannot be used.
    """
    types = types_of(bag)
    perception = _find_views(bag, options, is_dense)
    image_topic = perception.sources.images[0]
    camera_frame = frame_of(bag, image_topic)
    odometry = _find_odometry(types, options)
    tf_topics = tf_topics_of(types) if odometry else []
    joints = joint_topics_of(types, options.topics.get("joints", "")) if odometry else []
    motion, imu, inertial = None, "", None
    if odometry:
        robot = _find_robot(bag, types, options)
        static = static_transforms(bag, tf_topics)
        motion = RobotMotion(camera_frame, robot, static, options.poses)
    else:
        imu, inertial = _find_imu(bag, types, options, camera_frame)
    moving = moving_tf_topics(tf_topics)
    motions = [topic for topic in (odometry, imu) if topic]
    topics = dict.fromkeys([*perception.sources.names, *motions, *moving, *joints])
    frames = bag.topics[image_topic].count
    return LocalizeInputs(
        perception, camera_frame, motion, odometry, inertial, imu, tuple(topics), frames
    )


def _find_views(bag: Recording, options: LocalizeOptions, is_dense: bool) -> Perception:
    def make_estimator(kind: str, raw: bool) -> ViewEstimator:
        if kind == "stereo":
            return StereoViewEstimator(options.stereo, rectify=raw, is_dense=is_dense)
        return DepthViewEstimator(options.depth)

    return find_images(bag, options.input, options.topics, make_estimator, color=True)


def _find_odometry(types: Topics, options: LocalizeOptions) -> str:
    """Topic of odometry; empty where there is none or it is not wanted."""
    given = options.topics.get("odometry", "")
    if options.input.motion == "none":
        return ""
    if given:
        check_present(types, [given])
        return given
    found = [n for n, kind in types.items() if kind == ODOMETRY and "truth" not in n]
    if not found and options.input.motion == "odometry":
        raise BagError("no odometry in the bag, and input.motion asks for it")
    return min(found, key=len, default="")


def _find_imu(
    bag: Recording, types: Topics, options: LocalizeOptions, camera_frame: str
) -> tuple[str, InertialSensor | None]:
    """An inertial sensor that is fixed to the camera, and its topic; empty where there is none."""
    given = options.topics.get("imu", "")
    if given:
        check_present(types, [given])
    if options.input.motion == "none":
        return "", None
    sensor = InertialSensor(camera_frame, static_transforms(bag, tf_topics_of(types)))
    found = sorted((n for n, kind in types.items() if kind == IMU), key=len)
    for topic in [given] if given else found:
        sample = next(bag.records([topic]), None)
        if sample is not None and sensor.is_mounted(sample.record.frame_id):
            return topic, sensor
        why = "nothing on it can be read"
        if sample is not None:
            why = f"no fixed transform leads from {sample.record.frame_id} to {camera_frame}"
        bag.problems.append(f"{topic} is not used: {why}")
    return "", None


def _find_robot(bag: Recording, types: Topics, options: LocalizeOptions) -> RobotModel | None:
    description = options.robot or description_in(bag, types)
    return options.description.read(description) if description else None


Progress = Callable[[int, int], None]
"""Told how many of how many views are done."""


class LocalizeRun:
    """Follows the camera through a bag, view by view as its records come.

    Attributes:
        inputs: what the bag offers.
        log: what became of each view.
        dropped: views before the first odometry, where that is wanted, by reason.
        without_motion: views for which odometry was wanted and not known, by reason.
        seconds: how long `run` took [s].
        stopped: whether it was asked to end before the bag does.
    """

    def __init__(self, bag: Recording, options: LocalizeOptions | None = None) -> None:
        """Look through the bag.

        Raises:
            BagError: it lacks what localization needs.
            RobotModelError: its robot description cannot be used.
        """
        self._bag, settings = bag, options or LocalizeOptions()
        self.inputs: LocalizeInputs = find_localize_inputs(bag, settings)
        self.log = LocalizationLog()
        self.dropped: Counter[str] = Counter()
        self.without_motion: Counter[str] = Counter()
        self.seconds, self.stopped = 0.0, False
        localization = make_localization(self.inputs, settings, self.dropped, self.without_motion)
        self._pipeline = Pipeline(localization, None)

    @property
    def refused(self) -> Counter[str]:
        """Records that could not be used, by reason."""
        return self._pipeline.refused

    def stop(self) -> None:
        """Let `run` end after the record it is at, with the trajectory of what it has read."""
        self.stopped = True

    def run(self, progress: Progress | None = None) -> None:
        """Read the whole bag; one thread reads and rectifies, this one locates.

        Args:
            progress: told after every view.

        Raises:
            BagError: the camera was never located; says why.
        """
        start = time.perf_counter()
        seen = self.inputs.perception.see(records_of(self._bag, self.inputs.topics))
        with closing(in_background(seen)) as items:
            wanted = takewhile(lambda _: not self.stopped, items)
            work = chain.from_iterable(self._pipeline.process(item) for item in wanted)
            for done in chain(work, self._pipeline.finish()):
                self.log.add(done)
                if progress is not None:
                    progress(len(self.log.localizations), self.inputs.frames)
        self.seconds = time.perf_counter() - start
        if not len(self.log.trajectory):
            if self.stopped:
                raise BagError("interrupted before the camera was located")
            raise BagError(f"the camera was never located: {self._why_never()}")

    def _why_never(self) -> str:
        reasons = Counter(one.reason for one in self.log.localizations) + self.refused
        reasons += self.inputs.perception.dropped + self.dropped
        listed = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common(3))
        return listed or "the bag has no views"

    def summary(self) -> dict[str, int | float | str]:
        """Figures of the run, flat; ``dropped: <reason>`` counts images."""
        dropped = self.inputs.perception.dropped + self.dropped
        figures = self.log.figures() | {
            "image_topic": self.inputs.perception.sources.images[0],
            "odometry_topic": self.inputs.odometry_topic,
            "imu_topic": self.inputs.imu_topic,
            "camera_frame": self.inputs.camera_frame,
            "views_without_odometry": sum(self.without_motion.values()),
            "records_refused": sum(self.refused.values()),
            "interrupted": int(self.stopped),
            "images_dropped": sum(dropped.values()),
            "messages_skipped": sum(self._bag.skipped.values()),
            "bag_problems": len(self._bag.problems),
            "seconds": round(self.seconds, 3),
        }
        return figures | {f"dropped: {reason}": count for reason, count in dropped.items()}


def records_of(bag: Recording, topics: tuple[str, ...]) -> Iterator[tuple[str, Record]]:
    """Records of a bag with their topics, in order of time."""
    return ((entry.topic, entry.record) for entry in bag.records(topics))


def make_localization(
    inputs: LocalizeInputs,
    options: LocalizeOptions,
    dropped: Counter[str],
    without_motion: Counter[str],
) -> Localization:
    """What locates the camera of a bag.

    Args:
        inputs: what the bag offers.
        options: how it is used.
        dropped: counts views that are not located, by reason.
        without_motion: counts views that are located without odometry, by reason.
    """
    views: ViewSynchronizer[FramedView] = ViewSynchronizer(
        inputs.motion,
        inputs.inertial,
        waiting=options.waiting,
        on_drop=lambda reason, _: dropped.update([reason]),
        on_unknown_motion=lambda reason: without_motion.update([reason]),
    )
    motion, detector = KinematicMotion(options.odometry), make_detector(options.target)
    config = CameraLocalizerConfig(options.localizer, motion, detector, options.input.start_tilt)
    return Localization(views, inputs.motion, CameraLocalizer(config), inputs.inertial)
