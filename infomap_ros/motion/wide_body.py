"""The vehicle as wide as the doubt about its pose asks for, and its place allows."""

from __future__ import annotations

import math

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.pose_margin import widenings_for
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.reaching_config import ReachingConfig
from infomap_ros.motion.whole_body import WholeBody


def widest_vehicle(
    whole: WholeBody,
    config: ReachingConfig,
    terrain: Terrain,
    T_map_base: FloatArray,
    sigma: float,
) -> Vehicle:
    """The vehicle to plan with where its position is known within a standard deviation.

    What is nearer to the robot already than the margin cannot be kept farther off: the body is
    taken for as wide as it may be where the robot stands.

    Args:
        whole: the robot.
        config: how it reaches.
        terrain: the ground.
        T_map_base: where the robot stands, shape (4, 4).
        sigma: of its position, from `base_sigma` [m].
    """
    wanted = widenings_for(config.vehicle, sigma)
    if len(wanted) == 1:
        return whole.vehicle
    reach = config.base.standing_reach
    ground = with_standing_ground(terrain, whole.vehicle, T_map_base, reach)
    x, y = float(T_map_base[0, 3]), float(T_map_base[1, 3])
    yaw = math.atan2(T_map_base[1, 0], T_map_base[0, 0])
    vehicles = (whole.wider_vehicle(by) for by in wanted)
    return next((each for each in vehicles if each.stance(ground, x, y, yaw).ok), whole.vehicle)
