"""The topic map_alignment: where the frame of a robot's map belongs, told by others or by hand.

A geometry_msgs/PoseWithCovarianceStamped: its pose is ``T_new_old``, the frame of the map as it is
in that which it should be. Its stamp is that of the image by which this was found; zero for now.

Where the team has a key, the name of the frame is followed by a blank and the message's code, made
from the robot that is told, stamp and numbers; who has no key does not look at it. A message
without an image's stamp is then not heard, as it could be repeated at any time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from infomap_ros.errors import FrameError, InvalidInputError, UpdateRefusedError
from infomap_ros.geometry import PoseRecord
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.team.authentication import NOT_AUTHENTIC, TeamKey

MAP_ALIGNMENT = "map_alignment"


class MoveSeal:
    """Says of an alignment that it is the team's, and for which robot.

    Args:
        key: of the team; without one every message is taken for genuine.
        robot: id of the robot that is told to move its map.
    """

    def __init__(self, key: TeamKey | None, robot: int) -> None:
        self._key, self._robot = key, robot

    def sign(self, message: PoseWithCovarianceStamped) -> PoseWithCovarianceStamped:
        """The message, with its code if there is a key."""
        if self._key is not None:
            frame = message.header.frame_id
            message.header.frame_id = f"{frame} {self._key.code_of_text(self._text(message))}"
        return message

    def open(self, message: PoseWithCovarianceStamped) -> PoseRecord:
        """What the message says, in its frame.

        Raises:
            InvalidInputError: it is malformed.
            UpdateRefusedError: there is a key, and it was not signed with it, or without a stamp.
        """
        frame, _, code = message.header.frame_id.partition(" ")
        message.header.frame_id = frame
        told = decode_pose_with_covariance(message)
        key = self._key
        if key is not None and not (told.stamp and key.is_code_of_text(self._text(message), code)):
            raise UpdateRefusedError(f"{MAP_ALIGNMENT} is not of this team", NOT_AUTHENTIC)
        return told

    def _text(self, message: PoseWithCovarianceStamped) -> str:
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        numbers = [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
        numbers += message.pose.covariance.tolist()
        stamp, frame = message.header.stamp, message.header.frame_id
        whole = MAP_ALIGNMENT, self._robot, frame, stamp.sec, stamp.nanosec
        return " ".join([*map(str, whole), *(float(number).hex() for number in numbers)])


_OPEN = MoveSeal(None, 0)


def listen_to_moves(
    node: MonitoredNode,
    frame: str,
    worker: Worker,
    move: Callable[[PoseRecord], object],
    topic: str = MAP_ALIGNMENT,
    seal: MoveSeal = _OPEN,
) -> None:
    """Have a worker move a map when it is told to.

    Args:
        node: that listens; errors of the library are counted drops.
        frame: of the map.
        worker: whose thread owns the map.
        move: does it.
        topic: relative name.
        seal: that a message must have.
    """

    def receive(message: PoseWithCovarianceStamped) -> None:
        told = seal.open(message)
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
