"""Pairs of images wait here until it is known how the robot stood when they were taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from infomap_ros.geometry import PlacedSolid, PoseRecord
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.image_inputs import CLOCK_JUMP, Images, Infos
from infomap_ros.nodes.robot.posture_listener import PostureListener

_NO_MOTION = "no odometry or joints at the stamp"


@dataclass(frozen=True, eq=False)
class Look:
    """The images of one moment, with what the robot knows of itself.

    Attributes:
        images: of the cameras.
        infos: their camera infos.
        posture: where base and camera were by odometry and joints, None where that is not known.
        body: solids of the robot in the camera's frame.
        odom_frame: frame of odometry, empty where there is none.
    """

    images: Images
    infos: Infos
    posture: RobotPosture | None = None
    body: Sequence[PlacedSolid] = ()
    odom_frame: str = ""

    @property
    def stamp(self) -> int:
        """Of the first image [ns]."""
        return self.images[0].stamp


class ViewGate:
    """Lets looks through in the order of time, each when the robot's posture is known.

    Where it is not known in time they go on without it; but where odometry is wanted, not before
    the first one that has it, with which the map begins.

    Args:
        node: has the configuration of the queue, and counts what is dropped.
        motion: ``odometry``, ``none``, or ``auto``: odometry where it is offered.
        on_look: gets each look.
        on_clock_jump: told when the images' clock has jumped back.
    """

    def __init__(
        self,
        node: MonitoredNode,
        motion: str,
        on_look: Callable[[Look], None],
        on_clock_jump: Callable[[], None],
    ) -> None:
        self._node, self._motion = node, motion
        self._on_look, self._on_clock_jump = on_look, on_clock_jump
        self._newest, self._has_begun = 0, False
        self._blind: list[Look] = []
        self._waiting: WaitingQueue[Look] = WaitingQueue(
            self._pose_at, node.config(WaitingQueueConfig), self._on_no_posture
        )
        self.postures = None
        if motion != "none":
            required = motion == "odometry"
            self.postures = PostureListener(node, self._let_through, required=required)

    def add(self, images: Images, infos: Infos) -> None:
        """Take in the images of one moment."""
        look = Look(images, infos)
        if look.stamp < self._newest - CLOCK_JUMP:
            self._node.get_logger().warning("time went backwards")
            self._waiting.drop_all("time went backwards")
            self._newest, self._has_begun = 0, False
            self._on_clock_jump()
        self._newest = max(self._newest, look.stamp)
        if self.postures is not None:
            self.postures.look_from(images[0].frame_id)
        self._waiting.push(look.stamp, look)
        self._let_through()

    @property
    def _is_wanted(self) -> bool:
        """Whether the map has to begin with odometry."""
        if self.postures is None or self._motion == "odometry":
            return self.postures is not None
        return self.postures.is_offered

    def _pose_at(self, stamp: int) -> PoseRecord:
        """Whether the robot's posture is known, or nobody tells it; see `WaitingQueue`."""
        if self.postures is None or not self._is_wanted:
            return PoseRecord(stamp, "", np.eye(4))
        return PoseRecord(stamp, "", self.postures.posture(stamp).T_odom_camera)

    def _on_no_posture(self, look: Look, reason: str) -> None:
        if reason == "time went backwards":
            self._node.drop(reason)
        elif self._is_wanted and not self._has_begun:
            self._node.drop(_NO_MOTION, reason)
        else:
            self._blind.append(look)

    def _let_through(self) -> None:
        ready = [self._complete(look) for look, _ in self._waiting.take()]
        blind, self._blind = self._blind, []
        for look in sorted([*ready, *blind], key=lambda each: each.stamp):
            self._has_begun = True
            self._on_look(look)

    def _complete(self, look: Look) -> Look:
        """A look with the robot's posture and body."""
        postures = self.postures
        if postures is None or not self._is_wanted:
            return look
        return replace(
            look,
            posture=postures.posture(look.stamp),
            body=postures.body(look.stamp),
            odom_frame=postures.odom_frame,
        )
