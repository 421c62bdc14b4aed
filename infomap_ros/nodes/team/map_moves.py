"""The topic map_alignment: where the frame of a robot's map belongs, given by others or by hand.

A geometry_msgs/PoseWithCovarianceStamped: its pose is ``T_new_old``, the frame of the map as it is
in that which it should be. Its stamp is that of the image by which this was found; zero for now.

Where the team has a key, teammates send the same on map_alignment_signed, and map_alignment is
refused. As map updates, that is rows of named fields, here one row, with the header in the name of
one more field: whom it is for, the frame, and the stamp of the image by which it was found. A
message without an image's stamp is then refused, as it could be repeated at any time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError, InvalidInputError, UpdateRefusedError
from infomap_ros.geometry import PoseRecord, check_transform
from infomap_ros.geometry.transforms import check_covariance
from infomap_ros.messages import decode_pose_with_covariance, encode_pose
from infomap_ros.messages.fields import MessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import MOST_WAITING, Worker
from infomap_ros.team.membership import NOT_AUTHENTIC, TeamKey
from infomap_ros.team.message_header import (
    dtype_with_header,
    header_of,
    whole_number,
    without_header,
)
from infomap_ros.team.update import MAX_ROBOT

ALIGNMENT_ROW = np.dtype([("T_new_old", "<f8", (12,)), ("covariance", "<f8", (36,))])
"""The upper three rows of the transform, and its covariance (`geometry.transforms`), by rows."""

_WHAT = "alignment"
_MAX_STAMP = 2**63 - 1


def encode_alignment(alignment: PoseRecord, robot: int) -> NDArray[np.void]:
    """The row that commands a robot to move its map.

    Args:
        alignment: ``T_new_old`` with its covariance, in the map frame.
        robot: id of the robot.
    """
    header = {_WHAT: robot, "frame": alignment.frame_id, "stamp": alignment.stamp}
    rows = np.zeros(1, dtype_with_header(ALIGNMENT_ROW, header))
    rows["T_new_old"] = alignment.transform[:3].reshape(-1)
    if alignment.covariance is not None:
        rows["covariance"] = alignment.covariance.reshape(-1)
    return rows


def decode_alignment(rows: NDArray[np.void]) -> tuple[int, PoseRecord]:
    """Read such a row: id of the robot that is to move, and how; zeros are an unknown covariance.

    Raises:
        InvalidInputError: it is not one, or its numbers are no transform or covariance.
    """
    header = header_of(rows, _WHAT)
    robot = whole_number(header, _WHAT, 0, MAX_ROBOT, _WHAT)
    stamp = whole_number(header, "stamp", 0, _MAX_STAMP, _WHAT)
    table = without_header(rows, (ALIGNMENT_ROW,))
    if len(table) != 1:
        raise InvalidInputError(_WHAT, f"of {len(table)} rows, expected one")
    transform = np.vstack([table["T_new_old"][0].reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    matrix = table["covariance"][0].reshape(6, 6)
    covariance = check_covariance(matrix, 6) if matrix.any() else None
    alignment = check_transform(transform, "T_new_old")
    return robot, PoseRecord(stamp, header.get("frame", ""), alignment, covariance)


MAP_ALIGNMENT, MAP_ALIGNMENT_SIGNED = "map_alignment", "map_alignment_signed"
_SIZE = MOST_WAITING // 16  # as which a move of the map counts: a few may wait


def advertise_alignment(node: MonitoredNode, namespace: str, key: TeamKey | None) -> Publisher:
    """The publisher by which the robot in a namespace is commanded to move its map."""
    if key is None:
        topic = f"{namespace}/{MAP_ALIGNMENT}"
        return node.advertise(PoseWithCovarianceStamped, topic, qos.stream())
    return node.advertise(PointCloud2, f"{namespace}/{MAP_ALIGNMENT_SIGNED}", qos.stream())


def alignment_message(
    types: MessageTypes, alignment: PoseRecord, robot: int, key: TeamKey | None
) -> Any:
    """What that publisher sends.

    Args:
        types: who makes the message.
        alignment: ``T_new_old``, in the frame of the map.
        robot: id of the robot that is to move it.
        key: of the team, None without one.
    """
    if key is None:
        return encode_pose(types, alignment)
    rows = key.sign(encode_alignment(alignment, robot))
    return encode_rows(types, alignment.stamp, alignment.frame_id, rows)


def read_signed(message: PointCloud2, key: TeamKey, robot: int) -> PoseRecord:
    """The alignment in a signed message.

    Args:
        message: as it was received.
        key: of the team.
        robot: id of this robot.

    Raises:
        InfomapError: it is malformed.
        UpdateRefusedError: it is not signed with the key, not for this robot, or without a stamp.
    """
    receiver, alignment = decode_alignment(key.verify(decode_rows(message)[2]))
    if receiver != robot or not alignment.stamp:
        what = f"{MAP_ALIGNMENT_SIGNED} for robot {receiver}, stamp {alignment.stamp} ns"
        raise UpdateRefusedError(f"{what}: not for this robot and its images", NOT_AUTHENTIC)
    return alignment


def listen_to_moves(
    node: MonitoredNode,
    frame: str,
    worker: Worker,
    move: Callable[[PoseRecord], object],
    topic: str = MAP_ALIGNMENT,
    key: TeamKey | None = None,
    robot: int = 0,
) -> None:
    """Have a worker move a map when a message asks for it.

    Args:
        node: that listens; what is refused are counted drops.
        frame: of the map.
        worker: whose thread owns the map.
        move: does it.
        topic: relative name.
        key: of the team; with one, only what is signed is taken.
        robot: id of this robot.
    """

    def pass_on(alignment: PoseRecord) -> None:
        if alignment.frame_id != frame:
            raise FrameError(f"{topic} in frame '{alignment.frame_id}', the map is '{frame}'")
        worker.submit_from(topic, _SIZE, lambda: node.guard_peer(topic, lambda: move(alignment)))

    def receive(message: PoseWithCovarianceStamped) -> None:
        if key is not None:
            raise UpdateRefusedError(f"{topic} is not signed", NOT_AUTHENTIC)
        pass_on(decode_pose_with_covariance(message))

    common: dict[str, Any] = {"profile": qos.stream(), "required": False, "from_peer": True}
    node.listen(PoseWithCovarianceStamped, topic, receive, **common)
    if key is not None:
        team_key = key

        def receive_signed(message: PointCloud2) -> None:
            pass_on(read_signed(message, team_key, robot))

        node.listen(PointCloud2, MAP_ALIGNMENT_SIGNED, receive_signed, **common)


def describe_move(T_new_old: np.ndarray) -> str:
    """How far a map is moved, in words."""
    distance = float(np.linalg.norm(T_new_old[:3, 3]))
    cosine = 0.5 * (float(np.trace(T_new_old[:3, :3])) - 1.0)
    return f"by {distance:.3f} m and {np.arccos(np.clip(cosine, -1.0, 1.0)):.3f} rad"


def check_is_later(alignment: PoseRecord, moved: int) -> None:
    """Refuse what was found in an image of before the last move.

    Args:
        alignment: the alignment.
        moved: stamp of the last image before the last move [ns].

    Raises:
        InvalidInputError: it was.
    """
    if 0 < alignment.stamp <= moved:
        raise InvalidInputError(MAP_ALIGNMENT, "is from before the map was moved last")
