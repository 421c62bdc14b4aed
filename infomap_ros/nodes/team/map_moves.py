"""The topic map_alignment: where the frame of a robot's map belongs, told by others or by hand.

A geometry_msgs/PoseWithCovarianceStamped: its pose is ``T_new_old``, the frame of the map as it is
in that which it should be. Its stamp is that of the image by which this was found; zero for now.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from infomap_ros.errors import FrameError, InvalidInputError
from infomap_ros.geometry import PoseRecord
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.replay.messages import decode_pose_with_covariance

MAP_ALIGNMENT = "map_alignment"


def listen_to_moves(
    node: MonitoredNode,
    frame: str,
    worker: Worker,
    move: Callable[[PoseRecord], object],
    topic: str = MAP_ALIGNMENT,
) -> None:
    """Have a worker move a map when it is told to.

    Args:
        node: that listens; errors of the library are counted drops.
        frame: of the map.
        worker: whose thread owns the map.
        move: does it.
        topic: relative name.
    """

    def receive(message: PoseWithCovarianceStamped) -> None:
        told = decode_pose_with_covariance(message)
        if told.frame_id != frame:
            raise FrameError(f"{topic} in frame '{told.frame_id}', the map is '{frame}'")
        worker.submit_always(lambda: node.guard(topic, lambda: move(told)))

    node.listen(PoseWithCovarianceStamped, topic, receive, qos.stream(), required=False)


def describe_move(T_new_old: np.ndarray) -> str:
    """How far a map is moved, in words."""
    way = float(np.linalg.norm(T_new_old[:3, 3]))
    cosine = 0.5 * (float(np.trace(T_new_old[:3, :3])) - 1.0)
    return f"by {way:.3f} m and {np.arccos(np.clip(cosine, -1.0, 1.0)):.3f} rad"


def check_is_later(told: PoseRecord, moved: int) -> None:
    """Refuse what was found in an image of before the last move.

    Args:
        told: the alignment.
        moved: stamp of the last image before the last move [ns].

    Raises:
        InvalidInputError: it was.
    """
    if 0 < told.stamp <= moved:
        raise InvalidInputError(MAP_ALIGNMENT, "is from before the map was moved last")
