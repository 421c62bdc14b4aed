"""What a bag offers for mapping: range images, poses, the robot's body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice

from infomap_ros.errors import BagError
from infomap_ros.geometry import PoseBufferConfig, WaitingQueueConfig
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import parameter, parameters_of
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion.robot.description_config import DescriptionConfig
from infomap_ros.replay.bags.bag_contents import (
    description_in,
    frame_of,
    joint_topics_of,
    moving_tf_topics,
    static_transforms,
    tf_topics_of,
    types_of,
)
from infomap_ros.replay.bags.camera_poses import CameraPoses
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.topics import Topics, find_pose_topic
from infomap_ros.replay.localizing.localize_inputs import (
    LocalizeInputConfig,
    LocalizeOptions,
    MotionInputConfig,
)
from infomap_ros.replay.localizing.trajectory_poses import TrajectoryPoses
from infomap_ros.replay.measuring.range_meters import (
    DepthMeter,
    Measurement,
    RangeMeter,
    StereoMeter,
)
from infomap_ros.replay.measuring.range_sources import RangeSource
from infomap_ros.replay.measuring.robot_body import RobotBody
from infomap_ros.replay.measuring.source_choice import ImageInputConfig, find_source
from infomap_ros.stereo import DepthCameraConfig, StereoConfig

_LOOKED_AT = 2000  # transforms from which the map frame is chosen


@dataclass(frozen=True)
class MapInputConfig(ImageInputConfig):
    """Which of a bag's data make the map.

    Raises:
        ConfigError: a value is not among its choices or out of its range.
    """

    poses: str = parameter(
        "auto",
        "Where poses come from: the bag, or localisation by its images; auto takes the bag's where "
        "it has some.",
        choices=("auto", "bag", "localize"),
    )
    map_frame: str = parameter("", "Frame of the map; empty for that in which poses are told.")
    pose_frame: str = parameter(
        "", "Frame of which the pose topic tells the pose; empty for what it says or the camera."
    )
    remove_body: bool = parameter(
        True, "Drop points on the robot's own body, where the bag has its description."
    )


@dataclass(frozen=True)
class MapOptions:
    """All settings of mapping a bag.

    Attributes:
        topics: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``pose``, ``joints``; for localisation also
            ``color`` and ``odometry``.
        robot: path or text of a URDF; the bag's robot description where empty.
    """

    input: MapInputConfig = field(default_factory=MapInputConfig)
    map: VoxelMapConfig = field(default_factory=VoxelMapConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    depth: DepthCameraConfig = field(default_factory=DepthCameraConfig)
    poses: PoseBufferConfig = field(default_factory=PoseBufferConfig)
    assumed: AssumedPoseConfig = field(default_factory=AssumedPoseConfig)
    waiting: WaitingQueueConfig = field(default_factory=WaitingQueueConfig)
    body: BodyFilterConfig = field(default_factory=BodyFilterConfig)
    description: DescriptionConfig = field(default_factory=DescriptionConfig)
    motion: MotionInputConfig = field(default_factory=MotionInputConfig)
    odometry: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    sparse: SparseStereoConfig = field(default_factory=SparseStereoConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    topics: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""


@dataclass(frozen=True)
class MapInputs:
    """What was found.

    Attributes:
        source: turns images into range clouds.
        pose_topic: what tells the pose; empty where that is localisation.
        poses: of the camera; with localisation they have to be found first.
        body: of the robot.
        topics: all topics that are to be read.
        frames: number of images that should become scans.
    """

    source: RangeSource[Measurement]
    pose_topic: str
    poses: CameraPoses | TrajectoryPoses
    body: RobotBody
    topics: tuple[str, ...]
    frames: int


def find_inputs(bag: BagReader, options: MapOptions) -> MapInputs:
    """Look through a bag for what mapping needs.

    Raises:
        BagError: it has no range images or nothing that tells a pose.
        RobotModelError: the robot description cannot be used.
    """
    types = types_of(bag)
    source = _find_source(types, options)
    pose_topic = _pose_topic(types, options)
    tf_topics = tf_topics_of(types)
    joint_topics = joint_topics_of(types, options.topics.get("joints", ""))
    moving = moving_tf_topics(tf_topics)
    told = [pose_topic, *moving] if pose_topic else []
    topics = dict.fromkeys([*source.topics, *told, *joint_topics])
    return MapInputs(
        source=source,
        pose_topic=pose_topic,
        poses=_find_poses(bag, options, frame_of(bag, source.image_topic), pose_topic),
        body=_find_body(bag, types, options, bool(joint_topics)),
        topics=tuple(topics),
        frames=bag.topics[source.image_topic].count,
    )


def _pose_topic(types: Topics, options: MapOptions) -> str:
    """The topic that tells the pose; empty where localisation does."""
    if options.input.poses == "localize":
        return ""
    try:
        return find_pose_topic(types, options.topics.get("pose"))
    except BagError:
        if options.input.poses == "bag" or options.topics.get("pose"):
            raise
        return ""


def _find_poses(
    bag: BagReader, options: MapOptions, camera_frame: str, pose_topic: str
) -> CameraPoses | TrajectoryPoses:
    if not pose_topic:
        return TrajectoryPoses(camera_frame)
    tf_topics = tf_topics_of(types_of(bag))
    by_tf = pose_topic in tf_topics
    return CameraPoses(
        camera_frame,
        options.poses,
        by_tf=by_tf,
        map_frame=options.input.map_frame or (_tf_map_frame(bag, tf_topics) if by_tf else ""),
        pose_frame=options.input.pose_frame,
        static=static_transforms(bag, tf_topics),
    )


def _find_source(types: Topics, options: MapOptions) -> RangeSource[Measurement]:
    def make_meter(kind: str, raw: bool) -> RangeMeter:
        if kind == "stereo":
            return StereoMeter(options.stereo, rectify=raw)
        return DepthMeter(options.depth)

    return find_source(types, options.input, options.topics, make_meter)


def _tf_map_frame(bag: BagReader, tf_topics: list[str]) -> str:
    """``map`` where the beginning of the recording has it."""
    edges = (entry.record for entry in islice(bag.records(tf_topics), _LOOKED_AT))
    return "map" if any(edge.frame_id == "map" for edge in edges) else ""


def _find_body(bag: BagReader, types: Topics, options: MapOptions, has_joints: bool) -> RobotBody:
    if not options.input.remove_body:
        body = RobotBody(None)
        body.note = "not wanted"
        return body
    if options.robot:
        return RobotBody.from_description(options.robot, options.body, options.description)
    description = description_in(bag, types)
    if not description:
        return RobotBody(None)
    body = RobotBody.from_description(description, options.body, options.description)
    if body.needs_joints and not has_joints:
        body = RobotBody(None)
        body.note = "no joint states"
    return body


def localize_options(options: MapOptions) -> LocalizeOptions:
    """The settings of localising the camera of a bag that is to be mapped."""
    given = options.input
    motion = {name: getattr(options.motion, name) for name in parameters_of(MotionInputConfig)}
    return LocalizeOptions(
        input=LocalizeInputConfig(
            source=given.source,
            rectify=given.rectify,
            pairing_tolerance=given.pairing_tolerance,
            **motion,
        ),
        localizer=options.localizer,
        target=options.target,
        odometry=options.odometry,
        stereo=options.stereo,
        sparse=options.sparse,
        depth=options.depth,
        poses=options.poses,
        waiting=options.waiting,
        description=options.description,
        topics=options.topics,
        robot=options.robot,
    )
