"""What stereo_range publishes of a measurement. Nothing is built that nobody subscribes to."""

from __future__ import annotations

from sensor_msgs.msg import Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from infomap_ros.geometry import ImageRecord
from infomap_ros.messages import encode_disparity, encode_image, encode_range_cloud
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.pipeline.range_estimator import RangeMeasurement


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
