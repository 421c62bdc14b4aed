"""Commands to a robot out of messages, and back again."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from infomap_ros.errors import MalformedMessageError
from infomap_ros.messages.commands import (
    decode_arm_trajectory,
    decode_base_path,
    decode_velocity,
)
from infomap_ros.messages.fields import RosbagsMessageTypes
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.route import ArmPath

TYPES = RosbagsMessageTypes()


def test_a_path_comes_back(rng: np.random.Generator) -> None:
    poses = rng.uniform(-3.0, 3.0, (5, 3))
    command = decode_base_path(encode_base_path(TYPES, 5, "map", poses))
    assert command.frame_id == "map"
    np.testing.assert_allclose(command.poses, poses, atol=1e-12)


def test_a_path_without_poses_is_one() -> None:
    assert decode_base_path(encode_base_path(TYPES, 5, "odom", np.zeros((0, 3)))).poses.shape == (
        0,
        3,
    )


def test_a_path_that_leads_nowhere_is_refused() -> None:
    with pytest.raises(MalformedMessageError, match="position"):
        decode_base_path(encode_base_path(TYPES, 5, "map", np.array([(np.nan, 0.0, 0.0)])))


def test_a_trajectory_comes_back(rng: np.random.Generator) -> None:
    path = ArmPath(("a", "b"), rng.uniform(-1, 1, (4, 2)), np.array([0.0, 0.25, 1.0, 2.5]))
    command = decode_arm_trajectory(encode_arm_trajectory(TYPES, 5, path))
    assert command.names == path.joint_names
    np.testing.assert_allclose(command.positions, path.positions)
    np.testing.assert_allclose(command.times, path.times, atol=1e-9)


def test_malformed_trajectories_are_refused() -> None:
    path = ArmPath(("a", "b"), np.zeros((2, 2)), np.array([0.0, 1.0]))
    message = encode_arm_trajectory(TYPES, 5, path)
    short = copy.deepcopy(message)
    short.points[1].positions = np.zeros(1)
    with pytest.raises(MalformedMessageError, match=r"points\[1\] has 1 positions for 2 joints"):
        decode_arm_trajectory(short)
    message.points = []
    with pytest.raises(MalformedMessageError, match="0 points"):
        decode_arm_trajectory(message)


def test_velocities_are_read_or_refused() -> None:
    def twist(speed: float, rate: float) -> object:
        vectors = [
            TYPES.make("geometry_msgs/msg/Vector3", x=x, y=0.0, z=z)
            for x, z in ((speed, 0.0), (0.0, rate))
        ]
        return TYPES.make("geometry_msgs/msg/Twist", linear=vectors[0], angular=vectors[1])

    assert decode_velocity(twist(0.2, -0.4)) == (0.2, -0.4)
    with pytest.raises(MalformedMessageError, match=r"angular\.z"):
        decode_velocity(twist(0.2, np.inf))
