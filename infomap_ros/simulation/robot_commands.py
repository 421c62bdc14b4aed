"""Paths for a simulated robot whose frame is the map, which only localization knows."""

from __future__ import annotations

from infomap_ros.errors import FrameError, InvalidInputError, PoseUnavailableError
from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.commands import ArmTrajectoryCommand, BasePathCommand
from infomap_ros.simulation.body.arm_motion import why_refused
from infomap_ros.simulation.simulator import Simulator

_KEPT = 400  # places of the camera in odom, by stamp


class RobotCommands:
    """Carries out commands; learns from poses of the camera where the map is in odom.

    Args:
        simulator: whose robot is commanded.
        map_frame: frame of the poses of the camera, and of paths.
    """

    def __init__(self, simulator: Simulator, map_frame: str = "map") -> None:
        self._simulator, self._map_frame = simulator, map_frame
        self._T_odom_map: FloatArray | None = None
        self._places: dict[int, FloatArray] = {}
        self._in_map = False

    def note_place(self) -> None:
        """Remember where the camera is in odom now; to be called before each step."""
        stamp = self._simulator.stamp
        if stamp not in self._places:
            self._places[stamp] = self._simulator.odometry_camera_pose()
        while len(self._places) > _KEPT:
            del self._places[next(iter(self._places))]

    def follow_base_path(self, command: BasePathCommand) -> None:
        """Follow a path in odom or in the map; stop where it has no pose.

        Raises:
            FrameError: it is in another frame.
            PoseUnavailableError: it is in the map, and no pose of the camera is known.
        """
        if not len(command.poses):
            self._simulator.stop_base()
            return
        if command.frame_id == "odom":
            self._in_map = False
            self._simulator.follow_base_path(command.poses)
            return
        if command.frame_id != self._map_frame:
            raise FrameError(
                f"base_path in frame '{command.frame_id}', expected '{self._map_frame}' or 'odom'"
            )
        if self._T_odom_map is None:
            raise PoseUnavailableError("no camera_pose has come: the map is not known in odom")
        self._simulator.follow_base_path(command.poses, self._T_odom_map)
        self._in_map = True

    def follow_arm_trajectory(self, command: ArmTrajectoryCommand) -> None:
        """Move the arm along a trajectory that a controller would accept.

        Raises:
            InvalidInputError: a controller would refuse it.
            RobotModelError: a joint is unknown.
        """
        joints = self._simulator.arm_joints
        refused = why_refused(command, joints, self._simulator.stamp, allow_partial=True)
        if refused:
            raise InvalidInputError("arm trajectory", refused)
        self._simulator.follow_arm_trajectory(command.names, command.positions, command.times)

    def locate(self, pose: PoseRecord) -> None:
        """Learn where the camera was in the map, and correct a path in the map by it."""
        place = self._places.get(pose.stamp)
        if place is None or pose.frame_id != self._map_frame:
            return
        self._T_odom_map = place @ invert_transform(pose.transform)
        if self._in_map:
            self._simulator.correct_path(self._T_odom_map)
