"""Images of one moment with their calibrations, out of topics that come when they like."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import CameraInfo, Image

from infomap_ros.geometry import CameraInfoRecord, ImageRecord
from infomap_ros.messages import decode_camera_info, decode_image
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.clock_jumps import JumpingPairs

CLOCK_JUMP = 1_000_000_000
"""Images older than the newest by more than this have jumped back [ns]."""

Images = tuple[ImageRecord, ...]
Infos = tuple[CameraInfoRecord, ...]


class ImageInputs:
    """Listens to one image topic or pairs two, and waits for the camera infos.

    When the clock jumps back (a bag that loops), images pair only with images from the same side
    of the jump.

    Args:
        node: that listens.
        image_topics: one or two.
        info_topics: of their camera infos.
        on_images: gets the images of each moment with the camera infos.
        tolerance: largest difference between the stamps of a pair [s].
        capacity: images that wait for the camera infos at most.
    """

    def __init__(
        self,
        node: MonitoredNode,
        image_topics: tuple[str, ...],
        info_topics: tuple[str, ...],
        on_images: Callable[[Images, Infos], None],
        tolerance: float,
        capacity: int,
    ) -> None:
        self._node, self._on_images = node, on_images
        self._image_topics, self._info_topics = image_topics, info_topics
        self._pairs = JumpingPairs(round(tolerance * 1e9), CLOCK_JUMP, node.drop)
        self._infos: dict[str, CameraInfoRecord] = {}
        self._uncalibrated: deque[Images] = deque(maxlen=capacity)
        for topic in info_topics:
            node.listen(CameraInfo, topic, partial(self._on_info, topic), qos.sensor_data())
        for side, topic in enumerate(image_topics):
            node.listen(Image, topic, partial(self._on_image, side), qos.sensor_data())

    def _on_info(self, topic: str, message: CameraInfo) -> None:
        self._infos[topic] = decode_camera_info(message)
        if len(self._infos) == len(self._info_topics):
            while self._uncalibrated:
                self._hand_over(self._uncalibrated.popleft())

    def _on_image(self, side: int, message: Image) -> None:
        image = decode_image(message)
        if len(self._image_topics) == 1:
            self._hand_over((image,))
        elif (pair := self._pairs.add(side, image)) is not None:
            self._hand_over(pair)

    def _hand_over(self, images: Images) -> None:
        """Pass images on, once the cameras are known."""
        if len(self._infos) == len(self._info_topics):
            self._on_images(images, tuple(self._infos[topic] for topic in self._info_topics))
            return
        if len(self._uncalibrated) == self._uncalibrated.maxlen:
            self._node.drop("no camera info")
        self._uncalibrated.append(images)
