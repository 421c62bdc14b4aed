"""What a bag offers for localization: views, and what the robot knows of its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from infomap_ros.errors import BagError
from infomap_ros.geometry import PoseBufferConfig, WaitingQueueConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.messages import ODOMETRY
from infomap_ros.motion.robot.robot_model import DescriptionConfig, RobotModel
from infomap_ros.pipeline.perception import Perception
from infomap_ros.pipeline.robot_motion import RobotMotion
from infomap_ros.pipeline.view_estimator import (
    DepthViewEstimator,
    StereoViewEstimator,
    ViewEstimator,
)
from infomap_ros.replay.bags.bag_contents import (
    description_in,
    frame_of,
    joint_topics_of,
    moving_tf_topics,
    static_transforms,
    tf_topics_of,
    types_of,
)
from infomap_ros.replay.bags.image_choice import ImageInputConfig, find_images
from infomap_ros.replay.bags.reader import Recording
from infomap_ros.replay.bags.topics import Topics, check_present
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True)
class MotionInputConfig:
    """What is known of the camera's motion.

    Raises:
        ConfigError: a value is not among its choices or out of its range.
    """

    motion: str = parameter(
        "auto",
        "What the camera's motion is expected from: odometry (with joints or tf), nothing but "
        "that it is not too fast, or odometry where there is some.",
        choices=("auto", "odometry", "none"),
    )
    start_tilt: float = parameter(
        0.0,
        "How far the camera looks down at the beginning, where neither odometry nor target say "
        "what is up.",
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
class LocalizeOptions:
    """All settings of localization in a bag.

    Attributes:
        topics: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``color``, ``odometry``, ``joints``.
        robot: path or text of a URDF; the bag's robot description where empty.
    """

    input: LocalizeInputConfig = field(default_factory=LocalizeInputConfig)
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    odometry: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    sparse: SparseStereoConfig = field(default_factory=SparseStereoConfig)
    depth: DepthCameraConfig = field(default_factory=DepthCameraConfig)
    poses: PoseBufferConfig = field(default_factory=PoseBufferConfig)
    waiting: WaitingQueueConfig = field(default_factory=WaitingQueueConfig)
    description: DescriptionConfig = field(default_factory=DescriptionConfig)
    topics: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""


@dataclass(frozen=True)
class LocalizeInputs:
    """What was found.

    Attributes:
        perception: turns images into views.
        camera_frame: optical frame of the camera.
        motion: of the robot; None where it is not used.
        odometry_topic: empty where it is not used.
        topics: all topics that are to be read.
        frames: number of images that should become views.
    """

    perception: Perception
    camera_frame: str
    motion: RobotMotion | None
    odometry_topic: str
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
    motion = None
    if odometry:
        robot = _find_robot(bag, types, options)
        static = static_transforms(bag, tf_topics)
        motion = RobotMotion(camera_frame, robot, static, options.poses)
    moving = moving_tf_topics(tf_topics)
    topics = dict.fromkeys(
        [*perception.sources.names, *([odometry] if odometry else []), *moving, *joints]
    )
    frames = bag.topics[image_topic].count
    return LocalizeInputs(perception, camera_frame, motion, odometry, tuple(topics), frames)


def _find_views(bag: Recording, options: LocalizeOptions, is_dense: bool) -> Perception:
    def make_estimator(kind: str, raw: bool) -> ViewEstimator:
        if kind == "stereo":
            return StereoViewEstimator(
                options.stereo, rectify=raw, sparse=options.sparse, is_dense=is_dense
            )
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


def _find_robot(bag: Recording, types: Topics, options: LocalizeOptions) -> RobotModel | None:
    description = options.robot or description_in(bag, types)
    return options.description.read(description) if description else None
