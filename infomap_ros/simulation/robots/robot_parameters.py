"""Names of the parameters that a robot's file may hold for all nodes."""

from __future__ import annotations

from dataclasses import fields

from infomap_ros.simulation.body.robot_setup import RobotSetupConfig

_SHARED = ("base_frame", "arm_joints")  # of planning and simulation, by the same name

SECTIONS = ("/**", "/**/simulator")
"""Sections of a parameter file in which a robot may stand."""
SETUP = {
    one.name if one.name in _SHARED else f"robot.{one.name}": one.name
    for one in fields(RobotSetupConfig)
}
"""Field of `RobotSetupConfig` by its parameter."""
OTHERS = {
    "description": "world.description",
    "drive.turn_gain": "simulator.drive.turn_gain",
    "reaching.vehicle.wheel_links": "planner.reaching.vehicle.wheel_links",
    "reaching.vehicle.footprint": "planner.reaching.vehicle.footprint",
    "reaching.vehicle.ground_height": "planner.reaching.vehicle.ground_height",
    "reaching.vehicle.max_step": "planner.reaching.vehicle.max_step",
    "reaching.collision.ground_links": "planner.reaching.collision.ground_links",
}
"""Setting of ``infomap explore`` by the parameter, of those that are not of the setup."""
_OF_NODES = ("robot.assumed_joints", "robot.mesh_folders", "controllers", "arm")
PARAMETERS = frozenset({*SETUP, *OTHERS, *_OF_NODES})
"""All of them. A node leaves those alone that it does not have."""
