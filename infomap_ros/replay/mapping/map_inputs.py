"""What a bag offers for mapping: range images, poses, the robot's body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice

from infomap_ros.errors import BagError, RobotModelError
from infomap_ros.geometry import PoseBufferConfig, WaitingQueueConfig
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import parameter, parameters_of
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.correction.reintegration import ReintegrationConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion.robot.description_config import DescriptionConfig
from infomap_ros.pipeline.camera_poses import CameraPoses
from infomap_ros.pipeline.perception import Perception
from infomap_ros.pipeline.range_estimator import (
    DepthRangeEstimator,
    RangeEstimator,
    StereoRangeEstimator,
)
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses
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
from infomap_ros.replay.bags.topics import Topics, find_pose_topic
from infomap_ros.replay.localizing.localize_inputs import (
    LocalizeInputConfig,
    LocalizeInputs,
    LocalizeOptions,
    MotionInputConfig,
    find_localize_inputs,
)
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
        "Where poses come from: the bag, or localization by its images; auto takes the bag's where "
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
            ``right_info``, ``depth``, ``info``, ``pose``, ``joints``; for localization also
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
    scans: ScanStoreConfig = field(default_factory=ScanStoreConfig)
    corrections: ReintegrationConfig = field(default_factory=ReintegrationConfig)
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
        perception: turns images into range clouds, or into views where they locate the camera.
        pose_topic: what tells the pose; empty where that is localization.
        poses: of the camera.
        located: what localization uses; None where the bag tells the poses.
        camera_frame: optical frame of the camera.
        body: of the robot.
        body_note: why no body is removed, empty where one is.
        topics: all topics that are to be read.
        frames: number of images that should become scans.
    """

    perception: Perception
    pose_topic: str
    poses: CameraPoses | LocatedPoses
    located: LocalizeInputs | None
    camera_frame: str
    body: RobotBody
    body_note: str
    topics: tuple[str, ...]
    frames: int

    @property
    def map_frame(self) -> str:
        """Frame of the map."""
        return self.poses.map_frame


def find_inputs(bag: Recording, options: MapOptions) -> MapInputs:
    """Look through a bag for what mapping needs.

    Raises:
        BagError: it has no range images or nothing that tells a pose.
        RobotModelError: the robot description that is given cannot be used.
    """
    types = types_of(bag)
    perception, located = _find_range(bag, options), None
    pose_topic = _pose_topic(types, options)
    if not pose_topic:
        located = find_localize_inputs(bag, localize_options(options), is_dense=True)
        perception = located.perception
    joint_topics = joint_topics_of(types, options.topics.get("joints", ""))
    told = [pose_topic, *moving_tf_topics(tf_topics_of(types))] if pose_topic else []
    seen = perception.sources.names if located is None else located.topics
    image_topic = perception.sources.images[0]
    camera_frame = frame_of(bag, image_topic)
    body, note = _find_body(bag, types, options, bool(joint_topics))
    bag.problems += [] if body.robot is None else body.robot.left_out
    return MapInputs(
        perception,
        pose_topic,
        _find_poses(bag, options, camera_frame, pose_topic),
        located,
        camera_frame,
        body,
        note,
        topics=tuple(dict.fromkeys([*seen, *told, *joint_topics])),
        frames=bag.topics[image_topic].count,
    )


def _pose_topic(types: Topics, options: MapOptions) -> str:
    """The topic that tells the pose; empty where localization does."""
    if options.input.poses == "localize":
        return ""
    try:
        return find_pose_topic(types, options.topics.get("pose"))
    except BagError:
        if options.input.poses == "bag" or options.topics.get("pose"):
            raise
        return ""


def _find_poses(
    bag: Recording, options: MapOptions, camera_frame: str, pose_topic: str
) -> CameraPoses | LocatedPoses:
    if not pose_topic:
        return LocatedPoses("map", options.poses)
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


def _find_range(bag: Recording, options: MapOptions) -> Perception:
    def make_estimator(kind: str, raw: bool) -> RangeEstimator:
        if kind == "stereo":
            return StereoRangeEstimator(options.stereo, rectify=raw)
        return DepthRangeEstimator(options.depth)

    return find_images(bag, options.input, options.topics, make_estimator)


def _tf_map_frame(bag: Recording, tf_topics: list[str]) -> str:
    """``map`` where the beginning of the recording has it."""
    edges = (entry.record for entry in islice(bag.records(tf_topics), _LOOKED_AT))
    return "map" if any(edge.frame_id == "map" for edge in edges) else ""


def _find_body(
    bag: Recording, types: Topics, options: MapOptions, has_joints: bool
) -> tuple[RobotBody, str]:
    """The robot's body, and why there is none to be removed."""
    if not options.input.remove_body:
        return RobotBody(), "not wanted"
    description = options.robot or description_in(bag, types)
    if not description:
        return RobotBody(), "no robot description"
    try:
        robot = options.description.read(description)
    except RobotModelError as error:
        if options.robot:  # it was asked for
            raise
        bag.problems.append(f"the robot's body is not removed from the scans: {error}")
        return RobotBody(), str(error)
    if robot.joints and not has_joints and not options.robot:
        return RobotBody(), "no joint states"
    return RobotBody(robot), ""


def localize_options(options: MapOptions) -> LocalizeOptions:
    """The settings of localizing the camera of a bag that is to be mapped."""
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
