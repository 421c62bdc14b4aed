"""How long driving a path takes, by the same control that drives it."""

from __future__ import annotations

import math

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.path_driving import PathDriving
from infomap_ros.motion.base.path_following import PathFollowingConfig

_PERIOD = 0.05  # [s] of the control; half of it changes the time by less than one percent
_LAG = 0.5  # [s] of wheels behind what they are told, and until odometry shows that they rest
_SLOWEST = 0.02  # share of the largest speeds below which nothing is driven for long


def drive_seconds(path: FloatArray, config: PathFollowingConfig) -> float:
    """Time from rest to rest of a base that follows a path as told, but for a lag [s].

    Args:
        path: x, y [m] and yaw [rad], shape (K, 3); without length it takes no time.
        config: speeds and accelerations.
    """
    if len(path) < 2:
        return 0.0
    driving, pose, seconds = PathDriving(config), np.array(path[0]), 0.0
    driving.follow(path)
    length = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
    turning = float(np.abs(np.diff(path[:, 2])).sum())
    longest = 10.0 + (length / config.max_speed + turning / config.max_turn_rate) / _SLOWEST
    while seconds < longest:
        speed, turn_rate = driving.velocity(pose, _PERIOD)
        if driving.done or driving.problem:
            break
        middle = pose[2] + 0.5 * turn_rate * _PERIOD
        pose[0] += speed * _PERIOD * math.cos(middle)
        pose[1] += speed * _PERIOD * math.sin(middle)
        pose[2] += turn_rate * _PERIOD
        seconds += _PERIOD
    return seconds + _LAG
