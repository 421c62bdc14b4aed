"""What a bag offers for mapping: range images, poses, the robot's body."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from itertools import islice

import numpy as np

from infomap_ros.errors import BagError, FrameError, PoseUnavailableError, RobotModelError
from infomap_ros.exploration.reports.report_page.charts import rounded_up
from infomap_ros.geometry import (
    OdometryRecord,
    PoseBufferConfig,
    PoseRecord,
    Record,
    TransformRecord,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import parameter, parameters_of
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.pipeline.perception import Perception
from infomap_ros.pipeline.range_estimator import (
    DepthRangeEstimator,
    RangeEstimator,
    RangeMeasurement,
    StereoRangeEstimator,
)
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses
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
from infomap_ros.replay.bags.topics import Topics, find_pose_topic
from infomap_ros.replay.localize_run import (
    CameraOptions,
    LocalizeInputConfig,
    LocalizeInputs,
    LocalizeOptions,
    MotionInputConfig,
    find_localize_inputs,
    records_of,
)
from infomap_ros.stereo import StereoConfig


class CameraPoses:
    """Poses of the camera's optical frame in the map frame.

    A pose topic tells the pose of one frame: that which its message names (odometry), else
    `pose_frame`, else the camera itself. From there to the camera the edges of tf lead, which
    come from a robot's joints and are taken as exact. Where tf alone tells the pose, its
    covariance is unknown.

    Attributes:
        camera_frame: the camera's optical frame.
        map_frame: the frame in which poses are told; empty before the first.
    """

    places_frames = False

    def __init__(
        self,
        camera_frame: str,
        config: PoseBufferConfig | None = None,
        *,
        by_tf: bool = False,
        map_frame: str = "",
        pose_frame: str = "",
        static: Iterable[TransformRecord] = (),
    ) -> None:
        """Start with the fixed edges.

        Args:
            camera_frame: the camera's optical frame.
            config: of the poses that are kept.
            by_tf: True where no pose topic is used.
            map_frame: frame of the map; that of the first pose where empty, with tf alone
                ``map`` if there is one, else the topmost frame.
            pose_frame: frame of which the pose topic tells the pose, where its messages do not.
            static: edges of tf_static.
        """
        self.camera_frame, self.map_frame = camera_frame, map_frame
        self._by_tf, self._pose_frame = by_tf, pose_frame
        self._posed = ""  # frame of which the pose topic tells the pose
        self._base = ""  # frame in which it does
        self._tree = TransformTree(config)
        for edge in static:
            self._tree.add_transform(edge)

    def add(self, record: Record) -> None:
        """Take a pose, odometry or transform; other records are ignored.

        Raises:
            FrameError: the frames contradict those before.
        """
        if isinstance(record, TransformRecord):
            self._add_transform(record)
        elif isinstance(record, PoseRecord) and not self._by_tf:
            child = record.child_frame_id if isinstance(record, OdometryRecord) else ""
            self._posed = child or self._pose_frame or self.camera_frame
            self._base = record.frame_id
            self.map_frame = self.map_frame or record.frame_id
            self._tree.add_pose(record, self._posed)

    def _add_transform(self, edge: TransformRecord) -> None:
        if edge.child_frame_id == self._posed:
            return  # the pose topic tells more of the same edge
        if edge.is_static or self._by_tf or edge.child_frame_id == self._base:
            self._tree.add_transform(edge)
            return
        exact = PoseRecord(edge.stamp, edge.frame_id, edge.transform, np.zeros((6, 6)))
        self._tree.add_pose(exact, edge.child_frame_id)

    def at(self, stamp: int, frame: str = "") -> PoseRecord:
        """Pose of the camera at a time.

        Args:
            stamp: [ns].
            frame: of the clouds, which is that of the camera.

        Raises:
            PoseUnavailableError: it is not known at that time.
        """
        map_frame = self.map_frame or self._top_frame()
        if not map_frame:
            raise PoseUnavailableError("no pose has arrived", "no pose", may_arrive=True)
        try:
            return self._tree.at(map_frame, self.camera_frame, stamp)
        except FrameError as error:
            reason = f"frame {self.camera_frame} has no place in {map_frame}"
            raise PoseUnavailableError(str(error), reason, may_arrive=True) from error

    def others_have_jumped(self, stamp: int) -> None:
        """The images' clock has jumped back; each edge notices that by its own stamps."""

    def _top_frame(self) -> str:
        if not self._by_tf:
            return ""
        top = self._tree.root_of(self.camera_frame)
        return "" if top == self.camera_frame else top


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
    map_frame: str = parameter("", "Frame of the map; empty for that of the poses.")
    pose_frame: str = parameter(
        "", "Frame whose pose the pose topic has; empty for what it says or the camera."
    )
    remove_body: bool = parameter(
        True, "Drop points on the robot's own body, where the bag has its description."
    )
    fit_scene: bool = parameter(
        True,
        "In a scene of which the first images show most beyond max_range, as in a street, map "
        "farther and with larger voxels; not where map.max_range, map.voxel_size or "
        "stereo.max_depth was set.",
    )


@dataclass(frozen=True)
class MapOptions(CameraOptions):
    """All settings of mapping a bag."""

    input: MapInputConfig = field(default_factory=MapInputConfig)
    map: VoxelMapConfig = field(default_factory=VoxelMapConfig)
    assumed: AssumedPoseConfig = field(default_factory=AssumedPoseConfig)
    body: BodyFilterConfig = field(default_factory=BodyFilterConfig)
    scans: ScanStoreConfig = field(default_factory=ScanStoreConfig)
    motion: MotionInputConfig = field(default_factory=MotionInputConfig)


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


_FIRST, _READ = 3, 100  # frames by which the scene is judged, and records read for them at most
_FARTHEST = 500.0  # [m] to which they are searched
_KNOWN = 0.05  # largest deviation of what is mapped, as a share of its distance
_FINEST = 300.0  # voxels along the range of the map, at most
_ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def fitted_to_scene(bag: Recording, options: MapOptions) -> MapOptions:
    """The options with the sizes that a large scene needs; as they are where some were set.

    The map reaches as far as ranges are known to `_KNOWN`. A voxel is two standard deviations of
    what is near, at least a `_FINEST` of that range: rays take time and room by voxels.
    """
    usual, usual_depth = VoxelMapConfig(), StereoConfig().max_depth
    sizes = (options.map.max_range, options.map.voxel_size, options.stereo.max_depth)
    if not options.input.fit_scene or sizes != (usual.max_range, usual.voxel_size, usual_depth):
        return options
    distances, sigmas = _first_distances(bag, options)
    known = distances[sigmas <= _KNOWN * distances]
    is_large = len(known) > 0 and np.median(distances) > usual.max_range
    reach = _rounded(float(np.quantile(known, 0.95))) if is_large else 0.0
    if reach <= usual.max_range:
        return options
    size = _rounded(max(2.0 * float(np.quantile(sigmas, 0.25)), reach / _FINEST))
    return replace(
        options,
        map=replace(options.map, max_range=reach, voxel_size=max(size, usual.voxel_size)),
        stereo=replace(options.stereo, max_depth=reach * usual_depth / usual.max_range),
    )


def _rounded(length: float) -> float:
    return round(rounded_up(length, 0.05, _ROUND), 9)


def _first_distances(bag: Recording, options: MapOptions) -> FloatArray:
    """Distances and standard deviations of what the first frames show [m], shape (2, N)."""
    far = replace(options, stereo=replace(options.stereo, max_depth=_FARTHEST))
    perception, skipped = _find_range(bag, far), bag.skipped.copy()
    records = islice(records_of(bag, perception.sources.names), _READ)
    scans = (seen for seen in perception.see(records) if isinstance(seen, RangeMeasurement))
    clouds = [scan.cloud for scan in islice(scans, _FIRST)]
    bag.skipped.clear()  # the run reads these records again, and counts what is bad among them
    bag.skipped.update(skipped)
    distances = [np.linalg.norm(cloud.points, axis=1) for cloud in clouds]
    variances = [np.trace(cloud.covariances, axis1=1, axis2=2) for cloud in clouds]
    return np.array([np.concatenate([[], *distances]), np.sqrt(np.concatenate([[], *variances]))])


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
    pose_topics = [pose_topic, *moving_tf_topics(tf_topics_of(types))] if pose_topic else []
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
        topics=tuple(dict.fromkeys([*seen, *pose_topics, *joint_topics])),
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
        **{shared.name: getattr(options, shared.name) for shared in fields(CameraOptions)},
        input=LocalizeInputConfig(
            source=given.source,
            rectify=given.rectify,
            pairing_tolerance=given.pairing_tolerance,
            **motion,
        ),
    )
