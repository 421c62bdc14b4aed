"""The fiducials that localization knows, from the topic fiducials."""

from __future__ import annotations

from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError
from infomap_ros.localization.filter.records import Fiducials
from infomap_ros.messages.fiducials import decode_fiducials
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

_TOPIC = "fiducials"


class FiducialListener:
    """Keeps the newest fiducials. A callback of the node writes, any thread reads.

    Args:
        node: that listens; has a `RobotTrackerConfig`.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._newest: Fiducials | None = None
        node.listen(PointCloud2, _TOPIC, self._receive, qos.latched(), required=False)

    def fiducials(self) -> Fiducials | None:
        """What was published last; None before the first message."""
        return self._newest

    def _receive(self, message: PointCloud2) -> None:
        """Replace what is known.

        Raises:
            InfomapError: the message cannot be used; what was known stays.
        """
        _, frame, fiducials = decode_fiducials(message)
        if frame != self._frame:
            raise FrameError(f"fiducials in frame '{frame}', the map is '{self._frame}'")
        self._newest = fiducials
