"""Two robots stay close behind each other over a link that loses a fifth of all packets."""

from __future__ import annotations

import pytest

from infomap_ros.studies.team.team_network import LagMeter, Radio, TeamNetwork
from infomap_ros.team.config import TeamConfig


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_what_one_robot_sees_the_other_has_within_two_seconds(loss: float) -> None:
    config = TeamConfig(bandwidth=1.1, message_size=1400)
    network = TeamNetwork(2, Radio(10e6, loss), config, voxel_size=0.2)
    meter = LagMeter(network)
    for _ in range(4):
        for robot in network.robots:
            meter.look(robot)
        for _ in range(10):
            network.step()
            meter.check()
    for _ in range(60):
        network.step()
        meter.check()

    assert len(meter.lags) == 8
    assert max(meter.lags) < 2.0
    assert min(robot.changed for robot in network.robots) > 2000
    assert len({robot.member.replica.hash() for robot in network.robots}) == 1


def test_a_slow_link_delays_what_is_heard() -> None:
    network = TeamNetwork(2, Radio(0.2e6, 0.0), TeamConfig(bandwidth=1.0), voxel_size=0.2)
    meter = LagMeter(network)
    meter.look(network.robots[0])
    for _ in range(60):
        network.step()
        meter.check()

    assert meter.open == 0
    assert meter.lags[0] > 0.2
