"""Node ``fiducial_localization``: images in; the camera's pose in the map with its covariance out.

There is one pose for every pair of images whose camera is located, with the pair's stamp. Where it
is not located there is none: the node says that it is lost, or still searching for the target, and
why, on /diagnostics and in its log.

Callbacks only receive and pair; a pair waits until odometry and joints are known at its stamp, and
goes to the worker thread, which locates the camera and publishes. Where odometry does not come in
time the pair is used without it.

When the clock jumps back (a bag that loops), everything is forgotten and the map begins anew, at
the target where there is one.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.motion_prior import KinematicMotion, RobotPosture
from infomap_ros.localization.sparse_stereo import SparseStereoConfig
from infomap_ros.localization.target_config import TargetConfig, make_detector
from infomap_ros.nodes.base import MonitoredNode
from infomap_ros.nodes.camera_follower import CameraFollower, CameraFollowerConfig
from infomap_ros.nodes.image_inputs import CLOCK_JUMP, ImageInputs, Images, Infos
from infomap_ros.nodes.localization_news import FiducialLocalizationConfig, LocalizationNews
from infomap_ros.nodes.localization_warm_up import warm_up
from infomap_ros.nodes.memory import MemoryConfig, reserve_heap
from infomap_ros.nodes.orders import offer_order
from infomap_ros.nodes.posture_listener import PostureListener
from infomap_ros.nodes.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.run import run_node
from infomap_ros.nodes.view_sources import ViewSource
from infomap_ros.stereo import DepthCameraConfig, StereoConfig

_Pair = tuple[Images, Infos]


class FiducialLocalizationNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (FiducialLocalizationConfig, ""),
        (RobotTrackerConfig, ""),
        (LocalizerConfig, ""),
        (TargetConfig, "target."),
        (DeadReckoningConfig, "motion_noise."),
        (StereoConfig, "stereo."),
        (SparseStereoConfig, "sparse."),
        (DepthCameraConfig, "depth_camera."),
        (PoseBufferConfig, "poses."),
        (WaitingQueueConfig, "waiting."),
        (MemoryConfig, ""),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("fiducial_localization", **node_arguments)
        reserve_heap(self.config(MemoryConfig))
        config = self._config = self.config(FiducialLocalizationConfig)
        self._source, self._follower = self._make_source(), self._make_follower()
        warm_up()
        self.get_logger().info("kernels ready")
        self._news = LocalizationNews(self, self._follower)
        self._newest, self._has_begun = 0, False
        self._without_motion: list[tuple[int, _Pair]] = []
        self._waiting: WaitingQueue[_Pair] = WaitingQueue(
            self._odometry_at, self.config(WaitingQueueConfig), self._on_no_odometry
        )
        self._worker = self.start_worker(config.queue_size)
        self._postures = None
        if config.motion != "none":
            required = config.motion == "odometry"
            self._postures = PostureListener(self, self._hand_over, required=required)
        topics = self._source.image_topics, self._source.info_topics
        waiting = config.pairing_tolerance, config.queue_size
        self._inputs = ImageInputs(self, *topics, self._on_images, *waiting)
        offer_order(self, "~/reset", self._worker, self._reset)

    def _make_source(self) -> ViewSource:
        if self._config.source == "depth":
            return ViewSource.of_depth(self.config(DepthCameraConfig))
        stereo, sparse = self.config(StereoConfig), self.config(SparseStereoConfig)
        return ViewSource.of_stereo(stereo, sparse, rectify=self._config.rectify)

    def _make_follower(self) -> CameraFollower:
        motion = KinematicMotion(self.config(DeadReckoningConfig))
        detector = make_detector(self.config(TargetConfig))
        localizer, tilt = self.config(LocalizerConfig), self._config.start_tilt
        return CameraFollower(CameraFollowerConfig(localizer, motion, detector, tilt))

    def _on_images(self, images: Images, infos: Infos) -> None:
        stamp = images[0].stamp
        if stamp < self._newest - CLOCK_JUMP:
            self.get_logger().warning("time went backwards: the map begins anew")
            self._waiting.drop_all("time went backwards")
            self._worker.submit_always(self._follower.reset)
            self._newest, self._has_begun = 0, False
        self._newest = max(self._newest, stamp)
        if self._postures is not None:
            self._postures.look_from(images[0].frame_id)
        self._waiting.push(stamp, (images, infos))
        self._hand_over()

    def _odometry_at(self, stamp: int) -> PoseRecord:
        """Whether the robot's posture is known at a time [ns]; see `WaitingQueue`."""
        posture = self._posture_at(stamp)
        return PoseRecord(stamp, "", posture.T_odom_camera if posture else np.eye(4))

    def _posture_at(self, stamp: int) -> RobotPosture | None:
        """The robot's posture at a time [ns], None where nobody tells it.

        Raises:
            PoseUnavailableError: it is not known for that time.
        """
        if self._postures is None or not self._wants_odometry:
            return None
        return self._postures.posture(stamp)

    @property
    def _wants_odometry(self) -> bool:
        """Whether the map has to begin with odometry."""
        if self._postures is None or self._config.motion == "odometry":
            return self._postures is not None
        return self._postures.is_offered

    def _on_no_odometry(self, pair: _Pair, reason: str) -> None:
        """Go on without odometry, but do not begin without it where it is wanted."""
        if reason == "time went backwards":
            self.drop(reason)
        elif self._wants_odometry and not self._has_begun:
            self.drop("no odometry or joints at the stamp", reason)
        else:
            self._without_motion.append((pair[0][0].stamp, pair))

    def _hand_over(self) -> None:
        """Give the worker the pairs that need not wait any longer, in the order of time."""
        ready = [(pose.stamp, pair) for pair, pose in self._waiting.take()]
        without, self._without_motion = self._without_motion, []
        for stamp, pair in sorted([*ready, *without], key=lambda entry: entry[0]):
            posture = None if (stamp, pair) in without else self._posture_at(stamp)
            self._has_begun = True
            frame = self._postures.odom_frame if self._postures is not None else ""
            self._worker.submit(partial(self._work, pair, posture, frame))

    def _work(self, pair: _Pair, posture: RobotPosture | None, odom_frame: str) -> None:
        topic = self._source.image_topics[0]
        self.guard(topic, partial(self._locate, pair, posture, odom_frame))

    def _locate(self, pair: _Pair, posture: RobotPosture | None, odom_frame: str) -> None:
        """One pair: look, locate, publish."""
        framed = self._source.view(*pair)
        result = self._follower.follow(framed.view, posture)
        self._news.tell(result, framed.frame_id, posture, odom_frame)

    def _reset(self) -> str:
        self._follower.reset()
        return "the next images begin the map anew"


def main() -> int:
    """Run the node."""
    return run_node(FiducialLocalizationNode)


if __name__ == "__main__":
    raise SystemExit(main())
