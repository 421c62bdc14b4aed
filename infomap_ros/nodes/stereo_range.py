"""Node ``stereo_range``: images in; depth, disparity and points with covariances out.

Callbacks only receive and pair; the worker thread measures and publishes. Its queue is short:
where images come faster than they can be measured, the oldest waiting ones give way and are
counted, so that what comes out is never older than the queue is long.

When the clock jumps back (a bag that loops), images pair only with images from the same side of
the jump; nothing else is remembered between images.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from sensor_msgs.msg import Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from infomap_ros.geometry import ImageRecord
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.messages import encode_disparity, encode_image, encode_range_cloud
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConfig
from infomap_ros.nodes.common.memory import MemoryConfig, reserve_heap, use_shared_memory
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.run import prepare_kernels, run_node
from infomap_ros.nodes.robot.image_inputs import ImageInputs, depth_topics, stereo_topics
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.range_estimator import (
    DepthRangeEstimator,
    RangeEstimator,
    RangeMeasurement,
    StereoRangeEstimator,
)
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


class RangeOutputs:
    """The publishers of depth, disparity and points2.

    Args:
        node: that publishes.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._types = RclpyMessageTypes()
        self._depth = node.advertise(Image, "depth", qos.stream(depth=5))
        self._disparity = node.advertise(DisparityImage, "disparity", qos.stream(depth=5))
        self._points = node.advertise(PointCloud2, "points2", qos.stream(depth=5))

    @property
    def wanted(self) -> bool:
        """Whether anybody subscribes to any of them."""
        publishers = (self._depth, self._disparity, self._points)
        return any(publisher.get_subscription_count() for publisher in publishers)

    def publish(self, measurement: RangeMeasurement) -> None:
        """Publish a measurement; the points first, as others wait for them."""
        types, cloud = self._types, measurement.cloud
        stamp, frame = measurement.stamp, measurement.frame_id
        if self._points.get_subscription_count():
            self._points.publish(encode_range_cloud(types, stamp, frame, cloud.packed))
        if self._depth.get_subscription_count():
            record = ImageRecord(stamp, frame, cloud.range_image, "32FC1")
            self._depth.publish(encode_image(types, record))
        if measurement.rig is None or cloud.disparity is None:
            return
        if self._disparity.get_subscription_count():
            rig, search = measurement.rig, measurement.search
            self._disparity.publish(
                encode_disparity(types, stamp, frame, cloud.disparity, rig, search)
            )


@dataclass(frozen=True)
class StereoRangeNodeConfig:
    """What stereo_range listens to.

    Raises:
        ConfigError: a value is out of its range.
    """

    source: str = parameter(
        "stereo", "A pair of cameras, or a depth camera.", choices=("stereo", "depth")
    )
    rectify: bool = parameter(
        False, "Listen to image_raw and rectify, instead of listening to image_rect."
    )
    color: bool = parameter(
        False, "With source depth: take the colors of the points from rgb/image_rect."
    )
    pairing_tolerance: float = parameter(
        0.0,
        "Largest difference between the stamps of a pair; 0 for cameras that share a trigger.",
        unit="s",
        low=0.0,
        high=1.0,
    )
    queue_size: int = setting(
        4, "Pairs that wait to be measured at most; for one more, all give way.", low=1, high=100
    )

    def __post_init__(self) -> None:
        check_config(self)


class StereoRangeNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (StereoRangeNodeConfig, ""),
        (StereoConfig, ""),
        (DepthCameraConfig, "depth_camera."),
        (MemoryConfig, ""),
        (LockstepConfig, ""),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("stereo_range", **node_arguments)
        use_shared_memory()  # at once: later the memory of other processes would be found too
        reserve_heap(self.config(MemoryConfig))
        config = self.config(StereoRangeNodeConfig)
        self._estimator = self._make_estimator(config)
        prepare_kernels(self, self._estimator.warm_up, seconds=6.0)
        self._outputs = RangeOutputs(self)
        self._worker = self.start_worker(config.queue_size)
        if config.source == "depth":
            self._topics = depth_topics(color=config.color)
        else:
            self._topics = stereo_topics(rectify=config.rectify)
        waiting = config.pairing_tolerance, config.queue_size
        self._inputs = ImageInputs(self, self._topics, self._hand_over, *waiting)

    def _make_estimator(self, config: StereoRangeNodeConfig) -> RangeEstimator:
        if config.source == "depth":
            return DepthRangeEstimator(self.config(DepthCameraConfig))
        return StereoRangeEstimator(self.config(StereoConfig), rectify=config.rectify)

    def _hand_over(self, images: ImageSet) -> None:
        """Give images to the worker, where anybody wants what comes out."""
        if self._outputs.wanted:
            self._worker.submit(partial(self._measure, images))

    def _measure(self, images: ImageSet) -> None:
        if self.guard(self._topics.images[0], partial(self._measure_and_publish, images)):
            self.health.produced()

    def _measure_and_publish(self, images: ImageSet) -> None:
        self._outputs.publish(self._estimator.measure(images))


def main() -> int:
    """Run the node."""
    return run_node(StereoRangeNode)


if __name__ == "__main__":
    raise SystemExit(main())
