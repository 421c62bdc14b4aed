"""Node ``fiducial_localization``: images in; the camera's pose in the map with its covariance out.

There is one pose for every pair of images whose camera is located, with the pair's stamp. Where it
is not located there is none: the node says that it is lost, or still searching for the target, and
why, on /diagnostics and in its log.

Callbacks only receive and pair; a pair waits until odometry and joints are known at its stamp
(`infomap_ros.pipeline.view_synchronizer`) and goes to the worker thread, which locates the camera
and publishes. Another thread writes what is known to a file, so that a node that is killed goes on
in the same map.

When the clock jumps back (a bag that loops), everything is forgotten and the map begins anew, at
the target where there is one. With `resume` the map is kept, and the camera has to be found in it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Imu

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.geometry.records import WaitingQueueConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.motion_prior import KinematicMotion, RobotPosture
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.localization.target.tag_detection import TagPairing, believed_tags
from infomap_ros.localization.target.team_alignment import TeamTagsConfig
from infomap_ros.messages import decode_imu
from infomap_ros.messages.fiducials import TAG_DETECTIONS, decode_tag_detections
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConfig
from infomap_ros.nodes.common.memory import MemoryConfig, reserve_heap
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.common.orders import offer_order
from infomap_ros.nodes.common.run import prepare_kernels, run_node
from infomap_ros.nodes.locating.base_topics import (
    INITIAL_POSE,
    MapFrameConfig,
    listen_to_initial_pose,
)
from infomap_ros.nodes.locating.localization_config import FiducialLocalizationConfig, warm_up
from infomap_ros.nodes.locating.localization_outputs import LocalizationReporter
from infomap_ros.nodes.locating.teammate_sight import TeammateSight
from infomap_ros.nodes.robot.image_inputs import ImageInputs, depth_topics, stereo_topics
from infomap_ros.nodes.robot.posture_listener import PostureListener
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.map_listener import MapListener, MapListenerConfig
from infomap_ros.nodes.team.map_moves import (
    MAP_ALIGNMENT,
    check_is_later,
    describe_move,
    listen_to_moves,
)
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, CameraLocalizerConfig
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.inertial import InertialSensor
from infomap_ros.pipeline.perception import (
    DepthViewEstimator,
    ImageSources,
    StereoViewEstimator,
    ViewEstimator,
)
from infomap_ros.pipeline.scan_synchronizer import CLOCK_JUMPED
from infomap_ros.pipeline.view_synchronizer import PosturedView, ViewSynchronizer
from infomap_ros.stereo import DepthCameraConfig, StereoConfig
from infomap_ros.team.config import TeamConfig

_STILL = 0.01  # largest difference of a coordinate [m], or of a cosine, of a camera that stands
Detections = NDArray[np.void] | None
"""Tags in a view, shape (T,) of `TAG`; None where no other node is asked."""


class ViewInputs:
    """Listens to images and to the robot's motion; see `ViewSynchronizer`.

    Args:
        node: has the configuration of the queue, and counts what is dropped.
        topics: of the images.
        on_view: gets each view, of which no image has been looked at yet, and the tags in it.
        on_clock_jump: called when the images' clock has jumped back.
    """

    def __init__(
        self,
        node: MonitoredNode,
        topics: ImageSources,
        on_view: Callable[[PosturedView[ImageSet], Detections], None],
        on_clock_jump: Callable[[], None],
    ) -> None:
        self._node, self._on_view, self._on_clock_jump = node, on_view, on_clock_jump
        config = node.config(FiducialLocalizationConfig)
        is_required = config.motion == "odometry"
        self._motion, self._inertial = None, InertialSensor()
        if config.motion != "none":
            self._motion = PostureListener(
                node, self._on_motion, required=is_required, on_edge=self._inertial.add
            )
        if config.motion == "auto":
            node.listen(Imu, "imu", self._on_imu, qos.sensor_data(1000), required=False)
        self._views: ViewSynchronizer[ImageSet] = ViewSynchronizer(
            self._motion,
            self._inertial,
            is_required=is_required,
            waiting=node.config(WaitingQueueConfig),
            on_drop=self._on_drop,
        )
        waiting = node.config(WaitingQueueConfig)
        self._tags = TagPairing(waiting, config.pairing_tolerance, node.drop)
        self._uses_detections = config.use_detections
        if self._uses_detections:
            if find_spec("apriltag_msgs") is None:
                raise ConfigError("use_detections", True, "apriltag_msgs, which is not installed")
            kind = message_class(TAG_DETECTIONS)
            node.listen(kind, "detections", self._on_detections, qos.sensor_data())
        self._images = ImageInputs(
            node,
            topics,
            self._on_images,
            config.pairing_tolerance,
            config.queue_size,
            lambda: None if self._motion is None else self._motion.newest_stamp,
        )

    def _on_motion(self) -> None:
        self._images.ask_witness()
        self._take()

    def _on_imu(self, message: Imu) -> None:
        self._inertial.add(decode_imu(message))
        self._take()

    def _on_images(self, images: ImageSet) -> None:
        if self._motion is not None:
            self._motion.look_from(images.frame_id)
        self._inertial.look_from(images.frame_id)
        self._tags.frame_id = images.frame_id
        if self._views.add(images):
            self._node.get_logger().warning(CLOCK_JUMPED)
            self._tags.clear()
            self._on_clock_jump()
        self._take()

    def _on_detections(self, message: object) -> None:
        self._tags.add(decode_tag_detections(message))
        self._take()

    def _take(self) -> None:
        views = self._views.take()
        for view, tags in (
            self._tags.take(views) if self._uses_detections else zip(views, repeat(None))
        ):
            self._on_view(view, tags)

    def _on_drop(self, reason: str, sentence: str) -> None:
        if reason == CLOCK_JUMPED:
            self._node.drop(reason)
        else:
            self._node.drop("no odometry or joints at the stamp", sentence)


class FiducialLocalizationNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (FiducialLocalizationConfig, ""),
        (MapFrameConfig, ""),
        (TeamIdentityConfig, ""),
        (TeamConfig, "team_map."),
        (TeamRadioConfig, "team_map."),
        (MapListenerConfig, ""),
        (RobotTrackerConfig, ""),
        (LocalizerConfig, ""),
        (TargetConfig, "target."),
        (TeamTagsConfig, "team_tags."),
        (DeadReckoningConfig, "motion_noise."),
        (StereoConfig, ""),
        (DepthCameraConfig, "depth_camera."),
        (PoseBufferConfig, "poses."),
        (WaitingQueueConfig, "waiting."),
        (MemoryConfig, ""),
        (LockstepConfig, ""),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("fiducial_localization", **node_arguments)
        reserve_heap(self.config(MemoryConfig))
        config = self._config = self.config(FiducialLocalizationConfig)
        self._path = Path(config.state_file).absolute() if config.state_file else None
        is_depth = config.source == "depth"
        topics = depth_topics(color=True) if is_depth else stereo_topics(rectify=config.rectify)
        self._topics, self._estimator = topics, self._make_estimator()
        self._localizer = self._make_localizer()
        prepare_kernels(self, warm_up, seconds=80.0)
        self._reporter = LocalizationReporter(self, self._localizer)
        self._worker = self.start_worker(config.queue_size)
        stays = self.config(TargetConfig).kind != "none"
        self._teammates = TeammateSight(self, self._worker, self._move_map, stays=stays)
        self._map = MapListener(self, self._worker, required=False) if config.use_map else None
        self._moved = self._seen = 0  # stamps [ns]
        self._stood: FloatArray | None = None
        self._move: tuple[PoseRecord, int] | None = None
        if config.follow_alignment:
            frame = self.config(RobotTrackerConfig).map_frame
            who = self.config(TeamIdentityConfig)
            identity = who.read_key(), who.robot_id
            listen_to_moves(self, frame, self._worker, self._on_alignment, MAP_ALIGNMENT, *identity)
        listen_to_initial_pose(self, self._on_initial_pose)
        self._inputs = ViewInputs(self, topics, self._on_view, self._on_clock_jump)
        offer_order(self, "~/reset", self._worker, self._reset)
        if self._path is not None:
            self._writer = self.start_worker(1)
            self.repeat(config.save_period, self._save_when_idle)

    def _make_estimator(self) -> ViewEstimator:
        if self._config.source == "depth":
            return DepthViewEstimator(self.config(DepthCameraConfig))
        return StereoViewEstimator(self.config(StereoConfig), rectify=self._config.rectify)

    def _make_localizer(self) -> CameraLocalizer:
        motion = KinematicMotion(self.config(DeadReckoningConfig))
        detector = make_detector(self.config(TargetConfig))
        config, tilt = self.config(LocalizerConfig), self._config.start_tilt
        robot = self.config(TeamIdentityConfig).robot_id
        localizer = CameraLocalizer(CameraLocalizerConfig(config, motion, detector, tilt, robot))
        if self._path is not None and self._config.resume and self._path.exists():
            localizer.resume(SavedLocalization.load(self._path))
            self.get_logger().info(f"going on in the map of {self._path}")
        return localizer

    def _on_view(self, view: PosturedView[ImageSet], tags: Detections) -> None:
        self._worker.submit(partial(self._work, view, tags))

    def _on_clock_jump(self) -> None:
        self._worker.submit_always(self._begin_again)

    def _begin_again(self) -> None:
        self._moved = 0
        if self._config.resume:
            self._localizer.lose_track()
        else:
            self._localizer.reset()

    def _work(self, view: PosturedView[ImageSet], tags: Detections) -> None:
        self.guard(self._topics.images[0], partial(self._locate, view, tags))

    def _locate(self, view: PosturedView[ImageSet], tags: Detections) -> None:
        """One moment: look, locate, publish."""
        framed = self._estimator.measure(view.images)
        if tags is not None:
            framed.view.tags = believed_tags(tags, framed.view.image.shape, self.drop)
        others = self._teammates.bodies(view.stamp)
        voxel_map = None if self._map is None else self._map.known_map()
        known = view.posture, view.body, others, voxel_map, view.inertial
        result = self._localizer.locate(framed.view, *known)
        search, self._teammates.origin = self._teammates.search, self._localizer.origin
        self._reporter.report(result, framed.frame_id, view.posture, view.odom_frame, search)
        self._seen = result.stamp
        self._moved = self._moved or result.stamp  # what was found before the start is old
        self._teammates.look(framed.view, result)
        self._move_when_still(view.posture)

    def _move_when_still(self, posture: RobotPosture | None) -> None:
        """Move the map as was found, when the camera stands: no motion in it is under way then."""
        before, self._stood = self._stood, None if posture is None else posture.T_odom_camera
        now, move = self._stood, self._move
        if move is None or (now is not None and (before is None or not _is_still(before, now))):
            return
        self._move = None
        self.guard(MAP_ALIGNMENT, partial(self._move_at_once, *move))

    def _on_alignment(self, given: PoseRecord) -> None:
        """Somebody else says where the frame of the map belongs."""
        self._move_map(given, self._teammates.other_origin())

    def _move_map(self, given: PoseRecord, origin: int) -> None:
        """Put the map's frame where it belongs, as soon as the camera stands where it is by images.

        Raises:
            InvalidInputError: it cannot be moved, or was moved since that was found.
        """
        check_is_later(given, self._moved)
        if given.stamp:
            self._move = given, origin
        else:
            self._move_at_once(given, origin)

    def _move_at_once(self, given: PoseRecord, origin: int) -> None:
        """Put the map's frame where it belongs; what map_fusion has follows the keyframes.

        Raises:
            InvalidInputError: it cannot be moved, or was moved since that was found.
        """
        check_is_later(given, self._moved)
        covariance = np.zeros((6, 6)) if given.covariance is None else given.covariance
        self._localizer.move_map(given.transform, covariance, origin)
        self._teammates.origin = self._localizer.origin
        self._note_move(given.transform)
        if self._path is not None and origin:  # nobody may go on in the frame of before
            self._save_when_idle()

    def _note_move(self, T_new_old: FloatArray) -> None:
        self._moved = self._seen
        self._teammates.forget()
        sentence = f"the map has moved {describe_move(T_new_old)}"
        self.health.note("last move", sentence)
        self.get_logger().info(sentence)

    def _on_initial_pose(self, given: PoseRecord) -> None:
        place = partial(self._place_base, given)
        self._worker.submit_always(lambda: self.guard(INITIAL_POSE, place))

    def _place_base(self, given: PoseRecord) -> None:
        """Take from a user where the base is.

        Raises:
            InvalidInputError: that cannot be; see `CameraLocalizer.place_base`.
        """
        T_new_old = self._localizer.place_base(given)
        if T_new_old is None:
            self.get_logger().info(f"{INITIAL_POSE}: the camera is looked for there")
        else:
            self._note_move(T_new_old)

    def _reset(self) -> str:
        self._localizer.reset()
        return "the next images begin the map anew"

    def _save_when_idle(self) -> None:
        """Copy what is known, between two looks, and have it written."""

        def copy() -> None:
            if (saved := self._localizer.saved()) is not None:
                self._writer.submit(partial(self._save, saved))

        if not self._writer.waiting:
            self._worker.submit_always(copy)

    def _save(self, saved: SavedLocalization) -> None:
        if self._path is not None:
            self.guard("state_file", partial(saved.save, self._path))

    def destroy_node(self) -> None:
        """Stop the workers, save once more, and end."""
        self._worker.stop()
        if self._path is not None:
            self._writer.stop()
            if (saved := self._localizer.saved()) is not None:
                self._save(saved)
        super().destroy_node()


def _is_still(before: FloatArray, now: FloatArray) -> bool:
    """Whether two poses are the same but for noise, shapes (4, 4)."""
    return bool(np.abs(before - now).max() < _STILL)


def main() -> int:
    """Run the node."""
    return run_node(FiducialLocalizationNode)


if __name__ == "__main__":
    raise SystemExit(main())
