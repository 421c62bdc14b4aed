"""A robot that cannot turn where it stands drives straight before it turns."""

from __future__ import annotations

import numpy as np

from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.vehicle import Vehicle

from .grounds import FOLDED, ground, rover_model, stance_of

YAW = 0.25  # between the headings of the planner's graph, 0 and 0.46


def lane(half_width: float):
    """Flat ground, but for banks beside a lane that ends at the origin's level, 0.5 m ahead."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = np.cos(YAW) * x + np.sin(YAW) * y
        across = np.abs(np.cos(YAW) * y - np.sin(YAW) * x)
        return np.where((across > half_width) & (along > -0.5) & (along < 0.6), 0.4, 0.0)

    return height


def test_robot_in_a_lane_backs_out_before_it_turns() -> None:
    vehicle = Vehicle.from_robot(rover_model(), joint_positions=FOLDED)
    terrain = ground(lane(0.28))
    start = np.array([0.0, 0.0, YAW])
    assert stance_of(vehicle, terrain, *start).ok
    for turn in (-YAW, 0.4636 - YAW):  # to the nearest headings of the graph
        assert not stance_of(vehicle, terrain, 0.0, 0.0, YAW + turn).ok
    planner = BasePlanner(terrain, vehicle)
    assert planner.reachable_area(start).any()
    path = planner.plan(start, (-1.3, 0.8, np.nan), samples=0)
    assert path.complete, path.reason
    assert vehicle.stances(terrain, path.poses).ok.all()
    turned = np.flatnonzero(np.abs(path.poses[:, 2] - YAW) > 0.02)
    assert np.hypot(*path.poses[turned[0], :2]) > 0.15
