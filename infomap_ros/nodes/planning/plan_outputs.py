"""What next_best_view publishes of its plan.

traversability_map: where the base can stand, on a topic and by service.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetMap
from std_msgs.msg import ColorRGBA
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.exploration.records.run_log import rating_text
from infomap_ros.exploration.robot import Choice
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.files.export import ProjectedGrid
from infomap_ros.messages import encode_occupancy_grid
from infomap_ros.messages.motions import (
    encode_arm_trajectory,
    encode_base_path,
    encode_pose_stamped,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.orders import offer_service
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

CANDIDATES, REJECTED = "candidates", "rejected"
"""Namespaces of the markers on view_candidates."""

_ARROW = (0.12, 0.012, 0.03)  # length, shaft and head of a candidate [m]
_REJECTED = ColorRGBA(r=0.55, g=0.55, b=0.55, a=0.35)
# viridis: low to high ratings, in steps of a quarter
_RATINGS = np.array(
    [
        (0.27, 0.0, 0.33),
        (0.23, 0.32, 0.55),
        (0.13, 0.57, 0.55),
        (0.37, 0.79, 0.38),
        (0.99, 0.91, 0.14),
    ]
)


class PlanOutputs:
    """The publishers of a plan.

    next_view, base_path and arm_trajectory are below the node's own name but the first: what the
    robot's controllers listen to is only for the explorer to publish.

    Args:
        node: the node that publishes.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._clock, self._types = node.get_clock(), RclpyMessageTypes()
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._next_view = node.advertise(PoseStamped, "next_view", qos.latched())
        self._base_path = node.advertise(Path, "~/base_path", qos.latched())
        self._arm = node.advertise(JointTrajectory, "~/arm_trajectory", qos.latched())
        self._candidates = node.advertise(MarkerArray, "view_candidates", qos.latched())

    def publish(self, choice: Choice) -> None:
        """Publish view, paths and candidates of a choice, all with the same stamp."""
        stamp = int(self._clock.now().nanoseconds)
        candidates = choice.explanation.get("candidates", ())
        self._candidates.publish(self._markers(stamp, candidates, choice.pose))
        if choice.pose is None or choice.route is None:
            return
        types, frame, route = self._types, self._frame, choice.route
        self._next_view.publish(encode_pose_stamped(types, stamp, frame, choice.pose))
        self._base_path.publish(encode_base_path(types, stamp, frame, route.base_poses))
        self._arm.publish(encode_arm_trajectory(types, stamp, route.arm_after))

    def _markers(
        self, stamp: int, candidates: Sequence[Mapping[str, Any]], chosen: FloatArray | None
    ) -> MarkerArray:
        """Candidates as arrows, colored by rating; rejected ones gray, with the reason."""
        forget = Marker(action=Marker.DELETEALL)
        array = MarkerArray(markers=[forget])
        shares = _shares([each["rating"] for each in candidates])
        for number, (each, share) in enumerate(zip(candidates, shares, strict=True)):
            marker = self._marker(stamp, REJECTED if each["rejection"] else CANDIDATES, number)
            marker.color = _REJECTED if each["rejection"] else _color(share)
            marker.text = each["rejection"] or rating_text(each["rating"], each["terms"])
            start = np.asarray(each["position"], dtype=float)
            end = start + _ARROW[0] * np.asarray(each["direction"], dtype=float)
            marker.points = [_point(start), _point(end)]
            array.markers.append(marker)
        if chosen is not None:
            marker = self._marker(stamp, "chosen", 0)
            marker.color = ColorRGBA(r=0.9, g=0.2, b=0.1, a=1.0)
            marker.points = [_point(chosen[:3, 3]), _point(chosen[:3, 3] + 0.4 * chosen[:3, 2])]
            marker.scale.x, marker.scale.y = 0.03, 0.07
            array.markers.append(marker)
        return array

    def _marker(self, stamp: int, namespace: str, number: int) -> Marker:
        marker = Marker(ns=namespace, id=number, type=Marker.ARROW, action=Marker.ADD)
        marker.header.frame_id = self._frame
        marker.header.stamp.sec, marker.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        marker.scale.x, marker.scale.y = _ARROW[1:]
        marker.pose.orientation.w = 1.0
        return marker


def _shares(ratings: Sequence[float | None]) -> FloatArray:
    """Ratings from the lowest, 0, to the highest, 1; 0 where there is none."""
    values = np.array([np.nan if each is None else each for each in ratings], dtype=float)
    if not np.isfinite(values).any():
        return np.zeros(len(values))
    low, high = np.nanmin(values), np.nanmax(values)
    return np.nan_to_num((values - low) / max(high - low, 1e-9))


def _color(share: float) -> ColorRGBA:
    stops = np.linspace(0.0, 1.0, len(_RATINGS))
    r, g, b = (float(np.interp(share, stops, channel)) for channel in _RATINGS.T)
    return ColorRGBA(r=r, g=g, b=b, a=0.9)


def _point(place: FloatArray) -> Point:
    x, y, z = (float(value) for value in place)
    return Point(x=x, y=y, z=z)


_NAME = "traversability_map"


class TraversabilityMap:
    """Makes the grid when it is asked for, and for subscribers when `publish` is called.

    Args:
        node: that publishes; has the configuration of frames.
        worker: whose thread makes it.
        make: the grid as it is now.
    """

    def __init__(
        self, node: MonitoredNode, worker: Worker, make: Callable[[], ProjectedGrid]
    ) -> None:
        self._node, self._worker, self._make = node, worker, make
        self._types = RclpyMessageTypes()
        self._frame = node.config(RobotTrackerConfig).map_frame
        show = self._on_subscriber
        self._publisher = node.advertise(OccupancyGrid, _NAME, qos.current(), show)
        offer_service(node, GetMap, _NAME, worker, self._give)

    def publish(self) -> None:
        """Publish to who subscribes; called by the worker."""
        if self._publisher.get_subscription_count():
            self._node.guard(_NAME, lambda: self._publisher.publish(self._message()))

    def _on_subscriber(self) -> None:
        self._worker.submit_always(self.publish)

    def _give(self, _: Any, response: Any) -> None:
        response.map = self._message()

    def _message(self) -> Any:
        grid, stamp = self._make(), self._node.get_clock().now().nanoseconds
        return encode_occupancy_grid(
            self._types, stamp, self._frame, grid.cells, grid.resolution, grid.origin
        )
