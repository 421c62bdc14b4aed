"""Which trajectories ros2_control's joint_trajectory_controller accepts, as of ROS 2 Jazzy.

The checks of its ``validate_trajectory_msg`` for a controller of positions with its default
parameters; those of array sizes are made where messages are decoded.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infomap_ros.messages.commands import ArmTrajectoryCommand

_NANOSECONDS = 1_000_000_000
_ZERO = float(np.finfo(np.float32).eps)  # [rad/s or m/s]


def why_refused(
    command: ArmTrajectoryCommand, joints: Sequence[str], now: int, *, allow_partial: bool = False
) -> str:
    """Why the controller refuses a trajectory; empty where it accepts it.

    Args:
        command: the trajectory.
        joints: of the controller.
        now: time of the controller's clock [ns].
        allow_partial: whether the trajectory may leave joints out.
    """
    if not allow_partial and len(command.names) != len(joints):
        return f"{len(command.names)} joints, the controller has {len(joints)}"
    foreign = [name for name in command.names if name not in joints]
    if foreign:
        return f"no such joint: {', '.join(foreign)}"
    if command.velocities is not None and (np.abs(command.velocities[-1]) > _ZERO).any():
        return "the last velocity is not zero"
    end = command.stamp + round(float(command.times[-1]) * _NANOSECONDS)
    if command.stamp and end < now:
        return f"it begins at a time and ends {(now - end) / _NANOSECONDS:.3f} s ago"
    if (np.diff(command.times) <= 0.0).any():
        return "times do not strictly increase"
    return ""
