"""What fiducial_localization locates the camera by: images, odometry, joints, out of topics."""

from __future__ import annotations

from collections.abc import Callable

from infomap_ros.geometry.waiting_queue import WaitingQueueConfig
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.locating.localization_config import FiducialLocalizationConfig
from infomap_ros.nodes.robot.image_inputs import ImageInputs
from infomap_ros.nodes.robot.posture_listener import PostureListener
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.perception import ImageSources
from infomap_ros.pipeline.scan_synchronizer import CLOCK_JUMPED
from infomap_ros.pipeline.view_synchronizer import PosturedView, ViewSynchronizer


class ViewInputs:
    """Listens to images and to the robot's motion; see `ViewSynchronizer`.

    Args:
        node: has the configuration of the queue, and counts what is dropped.
        topics: of the images.
        on_view: gets each view, of which no image has been looked at yet.
        on_clock_jump: told when the images' clock has jumped back.
    """

    def __init__(
        self,
        node: MonitoredNode,
        topics: ImageSources,
        on_view: Callable[[PosturedView[ImageSet]], None],
        on_clock_jump: Callable[[], None],
    ) -> None:
        self._node, self._on_view, self._on_clock_jump = node, on_view, on_clock_jump
        config = node.config(FiducialLocalizationConfig)
        is_required = config.motion == "odometry"
        self._motion = None
        if config.motion != "none":
            self._motion = PostureListener(node, self._on_motion, required=is_required)
        self._views: ViewSynchronizer[ImageSet] = ViewSynchronizer(
            self._motion,
            is_required=is_required,
            waiting=node.config(WaitingQueueConfig),
            on_drop=self._on_drop,
        )
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

    def _on_images(self, images: ImageSet) -> None:
        if self._motion is not None:
            self._motion.look_from(images.frame_id)
        if self._views.add(images):
            self._node.get_logger().warning(CLOCK_JUMPED)
            self._on_clock_jump()
        self._take()

    def _take(self) -> None:
        for view in self._views.take():
            self._on_view(view)

    def _on_drop(self, reason: str, sentence: str) -> None:
        if reason == CLOCK_JUMPED:
            self._node.drop(reason)
        else:
            self._node.drop("no odometry or joints at the stamp", sentence)
