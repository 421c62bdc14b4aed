"""What a bag offers for mapping: range images, poses, the robot's body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice

from infomap_ros.errors import BagError
from infomap_ros.geometry import PoseBufferConfig, TransformRecord, WaitingQueueConfig
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.body import BodyFilterConfig
from infomap_ros.motion.description_config import DescriptionConfig
from infomap_ros.replay.camera_poses import CameraPoses
from infomap_ros.replay.messages import JOINT_STATE, STRING, TF
from infomap_ros.replay.range_meters import DepthMeter, Measurement, StereoMeter
from infomap_ros.replay.range_sources import DepthSource, RangeSource, StereoSource
from infomap_ros.replay.reader import BagReader
from infomap_ros.replay.robot_body import RobotBody, description_among
from infomap_ros.replay.topics import (
    Topics,
    check_present,
    find_depth_topics,
    find_pose_topic,
    find_stereo_topics,
)
from infomap_ros.stereo import DepthCameraConfig, StereoConfig

_TF_TYPES = (TF, "tf/msg/tfMessage")
_LOOKED_AT = 2000  # transforms from which the map frame is chosen


@dataclass(frozen=True)
class MapInputConfig:
    """Which of a bag's data make the map.

    Raises:
        ConfigError: a value is not among its choices or out of its range.
    """

    source: str = parameter(
        "auto",
        "Where range comes from; auto takes a stereo pair if there is one, else a depth camera.",
        choices=("auto", "stereo", "depth"),
    )
    rectify: str = parameter(
        "auto",
        "Whether the stereo images are raw; auto asks the name of their topic for 'rect'.",
        choices=("auto", "yes", "no"),
    )
    pairing_tolerance: float = parameter(
        0.005, "Largest difference of the stamps of a pair.", unit="s", low=0.0, high=1.0
    )
    map_frame: str = parameter("", "Frame of the map; empty for that in which poses are told.")
    pose_frame: str = parameter(
        "", "Frame of which the pose topic tells the pose; empty for what it says or the camera."
    )
    remove_body: bool = parameter(
        True, "Drop points on the robot's own body, where the bag has its description."
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class MapOptions:
    """All settings of mapping a bag.

    Attributes:
        topics: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``pose``, ``joints``.
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
    topics: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""


@dataclass(frozen=True)
class MapInputs:
    """What was found.

    Attributes:
        source: turns images into range clouds.
        pose_topic: what tells the pose.
        poses: of the camera.
        body: of the robot.
        topics: all topics that are to be read.
        frames: number of images that should become scans.
    """

    source: RangeSource[Measurement]
    pose_topic: str
    poses: CameraPoses
    body: RobotBody
    topics: tuple[str, ...]
    frames: int


def find_inputs(bag: BagReader, options: MapOptions) -> MapInputs:
    """Look through a bag for what mapping needs.

    Raises:
        BagError: it has no range images or nothing that tells a pose.
        RobotModelError: the robot description cannot be used.
    """
    types = {topic: channel.type_name for topic, channel in bag.topics.items()}
    source = _find_source(types, options)
    pose_topic = find_pose_topic(types, options.topics.get("pose"))
    tf_topics = [name for name, kind in types.items() if kind in _TF_TYPES]
    by_tf = pose_topic in tf_topics
    poses = CameraPoses(
        _frame_of(bag, source.image_topic),
        options.poses,
        by_tf=by_tf,
        map_frame=options.input.map_frame or (_tf_map_frame(bag, tf_topics) if by_tf else ""),
        pose_frame=options.input.pose_frame,
        static=_static_transforms(bag, tf_topics),
    )
    joint_topics = _joint_topics(types, options)
    moving = [name for name in tf_topics if not name.endswith("tf_static")]
    topics = dict.fromkeys([*source.topics, pose_topic, *moving, *joint_topics])
    return MapInputs(
        source=source,
        pose_topic=pose_topic,
        poses=poses,
        body=_find_body(bag, types, options, bool(joint_topics)),
        topics=tuple(topics),
        frames=bag.topics[source.image_topic].count,
    )


def _frame_of(bag: BagReader, topic: str) -> str:
    first = next(bag.records([topic]), None)
    if first is None:
        raise BagError(f"topic {topic} has no message that can be read")
    return first.record.frame_id


def _find_source(types: Topics, options: MapOptions) -> RangeSource[Measurement]:
    wanted = options.input.source
    if wanted == "auto" and options.topics.get("depth"):
        wanted = "depth"
    failures = []
    if wanted in ("auto", "stereo"):
        try:
            return _stereo_source(types, options)
        except BagError as error:
            failures.append(str(error))
    if wanted in ("auto", "depth"):
        try:
            topics = find_depth_topics(types, _given(options, "depth"))
            return DepthSource(replace(topics, color=None), DepthMeter(options.depth))
        except BagError as error:
            failures.append(str(error))
    raise BagError("; ".join(failures))


def _stereo_source(types: Topics, options: MapOptions) -> StereoSource[Measurement]:
    topics = find_stereo_topics(types, _given(options, "stereo"))
    rectify = {"auto": not topics.is_rectified, "yes": True, "no": False}[options.input.rectify]
    meter = StereoMeter(options.stereo, rectify=rectify)
    return StereoSource(topics, meter, options.input.pairing_tolerance)


def _given(options: MapOptions, task: str) -> dict[str, str]:
    names = {
        "stereo": ("left_image", "right_image", "left_info", "right_info"),
        "depth": ("depth", "info"),
    }[task]
    return {name: options.topics[name] for name in names if options.topics.get(name)}


def _static_transforms(bag: BagReader, tf_topics: list[str]) -> list[TransformRecord]:
    static = [name for name in tf_topics if name.endswith("tf_static")]
    records = (entry.record for entry in bag.records(static)) if static else iter(())
    return [record for record in records if isinstance(record, TransformRecord)]


def _tf_map_frame(bag: BagReader, tf_topics: list[str]) -> str:
    """``map`` where the beginning of the recording has it."""
    edges = (entry.record for entry in islice(bag.records(tf_topics), _LOOKED_AT))
    return "map" if any(edge.frame_id == "map" for edge in edges) else ""


def _joint_topics(types: Topics, options: MapOptions) -> list[str]:
    given = options.topics.get("joints")
    if given:
        check_present(types, [given])
        return [given]
    return [name for name, kind in types.items() if kind == JOINT_STATE]


def _find_body(bag: BagReader, types: Topics, options: MapOptions, has_joints: bool) -> RobotBody:
    if not options.input.remove_body:
        body = RobotBody(None)
        body.note = "not wanted"
        return body
    if options.robot:
        return RobotBody.from_description(options.robot, options.body, options.description)
    topics = [n for n, kind in types.items() if kind == STRING and n.endswith("robot_description")]
    description = description_among(e.record for e in bag.records(topics)) if topics else ""
    if not description:
        return RobotBody(None)
    body = RobotBody.from_description(description, options.body, options.description)
    if body.needs_joints and not has_joints:
        body = RobotBody(None)
        body.note = "no joint states"
    return body
