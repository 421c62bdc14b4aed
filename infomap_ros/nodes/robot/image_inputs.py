"""Images of one moment with their calibrations, out of topics.

A topic whose name, after remapping, ends as image_transport names its compressed forms carries
sensor_msgs/CompressedImage, any other one sensor_msgs/Image.

What stereo_range and fiducial_localization look with: a pair of cameras, or a depth camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from infomap_ros.geometry import ImageRecord
from infomap_ros.messages import decode_camera_info, decode_compressed_image, decode_image
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.pipeline.image_synchronizer import ImageSet, ImageSynchronizer
from infomap_ros.pipeline.perception import ImageSources

COMPRESSED, COMPRESSED_DEPTH = "compressed", "compressedDepth"
"""The last parts of topics of compressed images, as image_transport names them."""


def is_compressed(topic: str) -> bool:
    """Whether the images of a topic, by its full name, are compressed."""
    return topic.rpartition("/")[2] in (COMPRESSED, COMPRESSED_DEPTH)


class ImageInputs:
    """Listens to one image topic or two, and to their camera infos; see `ImageSynchronizer`.

    Args:
        node: that listens.
        topics: of images and camera infos.
        on_images: gets the images of each moment with the camera infos.
        tolerance: largest difference between the stamps of a pair [s].
        capacity: images that wait for the camera infos at most.
        witness: stamp to which another stream has come [ns], None where nothing is known.
    """

    def __init__(
        self,
        node: MonitoredNode,
        topics: ImageSources,
        on_images: Callable[[ImageSet], None],
        tolerance: float,
        capacity: int,
        witness: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._on_images = on_images
        counts = len(topics.images), len(topics.infos)
        clocks = time.monotonic, witness
        self._images = ImageSynchronizer(*counts, tolerance, capacity, node.drop, *clocks)
        for camera, topic in enumerate(topics.infos):
            node.listen(CameraInfo, topic, partial(self._on_info, camera), qos.sensor_data())
        for camera, topic in enumerate(topics.images):
            compressed = is_compressed(node.resolve_topic_name(topic))
            decode = decode_compressed_image if compressed else decode_image
            receive = partial(self._on_image, camera, decode)
            kind = CompressedImage if compressed else Image
            node.listen(kind, topic, receive, qos.sensor_data())

    def ask_witness(self) -> None:
        """The witness has gone on."""
        for images in self._images.ask_witness():
            self._on_images(images)

    def _on_info(self, camera: int, message: CameraInfo) -> None:
        for images in self._images.add_info(camera, decode_camera_info(message)):
            self._on_images(images)

    def _on_image(
        self, camera: int, decode: Callable[[object], ImageRecord], message: object
    ) -> None:
        for images in self._images.add_image(camera, decode(message)):
            self._on_images(images)


def stereo_topics(*, rectify: bool) -> ImageSources:
    """Topics of a pair of cameras; `rectify` if the images are raw."""
    kind = "image_raw" if rectify else "image_rect"
    infos = ("left/camera_info", "right/camera_info")
    return ImageSources((f"left/{kind}", f"right/{kind}"), infos)


def depth_topics(*, color: bool) -> ImageSources:
    """Topics of a depth camera; with `color`, each depth image waits for its color image."""
    images = ("depth/image_rect", "rgb/image_rect") if color else ("depth/image_rect",)
    return ImageSources(images, ("depth/camera_info",))
