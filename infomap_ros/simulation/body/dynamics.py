"""Makes a robot in a world move by forces: springs at its wheels, servos in its joints.

The URDF knows rigid wheels without motors. Here each driven wheel gets a spring between it and the
body, a servo that turns it, and friction with the ground. All other joints get position servos.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.suspension import add_suspension
from infomap_ros.simulation.body.trial import TrialModel, Wheel
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP

import mujoco  # isort: skip  # after the backend has been chosen

_WHEEL_DAMPING = 0.02  # [Nm s/rad]
_NO_EFFORT_LIMIT = 1e4  # [N or Nm]
_ON_ROLLERS = 0.02  # friction of wheels whose rollers are not simulated one by one


@dataclass(frozen=True)
class DynamicsConfig:
    """Parameters of the simulation of forces."""

    timestep: ClassVar[float] = 0.005
    """Step of the integration [s]."""
    control_period: ClassVar[float] = 0.02
    """Time between two commands to the servos [s]."""
    arm_stiffness: ClassVar[float] = 12.0
    """Natural frequency of the joint servos [rad/s]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)

    @property
    def steps(self) -> int:
        """Steps of the integration in one control period, at least 1."""
        return max(1, round(self.control_period / self.timestep))


def add_dynamics(
    spec: mujoco.MjSpec,
    prefix: str,
    setup: RobotSetupConfig,
    trial: TrialModel,
    config: DynamicsConfig,
) -> None:
    """Give a robot that `robot.add_robot` has put into a world its springs and servos.

    Args:
        spec: the world.
        prefix: of the robot's names.
        setup: names of the robot's parts.
        trial: the same robot, measured.
        config: the parameters.
    """
    spec.option.timestep = config.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL  # elliptic ones converge worse here
    spec.option.iterations, spec.option.ls_iterations = 60, 30
    for name in trial.locked:
        spec.delete(spec.joint(prefix + name))
    add_suspension(spec, prefix, setup, trial)
    for wheel in trial.wheels:
        _shape_wheel(spec, prefix, wheel, setup)
        _drive(spec, prefix, wheel, setup)
    for link in setup.casters:
        for geom in _solids(spec.body(prefix + link)):
            geom.priority, geom.condim = 2, 1
    _let_hover(spec, prefix, setup)
    for name, inertia in trial.inertia.items():
        _add_servo(spec, prefix + name, inertia, config)
    for first, second in trial.touching:
        spec.add_exclude(bodyname1=prefix + first, bodyname2=prefix + second)


def _shape_wheel(spec: mujoco.MjSpec, prefix: str, wheel: Wheel, setup: RobotSetupConfig) -> None:
    """Let the wheel touch the ground as a crowned tyre, an ellipsoid within its cylinder.

    The hull of a mesh has corners, and a cylinder touches a height field in so many points that
    the solver needs several times as long.
    """
    body = spec.body(prefix + wheel.body)
    for geom in _solids(body):
        spec.delete(geom)
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, wheel.axis)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        size=(wheel.radius, wheel.radius, 0.5 * wheel.width),
        pos=wheel.center,
        quat=turn,
        group=COLLISION_GROUP,
        friction=(_ON_ROLLERS if setup.rollers else setup.wheel_friction, 0.005, 0.0001),
        priority=1,
        mass=0.0,
    )


def _let_hover(spec: mujoco.MjSpec, prefix: str, setup: RobotSetupConfig) -> None:
    """Let links that are drawn down to the ground not touch it, by a contact bit of its own."""
    if not setup.hovering:
        return
    hovering = {prefix + name for name in setup.hovering}
    for body in spec.bodies:
        if body.name.startswith(prefix):
            for geom in _solids(body):
                geom.contype = geom.conaffinity = 1 if body.name in hovering else 3
    ground = spec.geom("ground")
    ground.contype = ground.conaffinity = 2


def _drive(spec: mujoco.MjSpec, prefix: str, wheel: Wheel, setup: RobotSetupConfig) -> None:
    """A position servo, which the drive moves at the wanted speed: it also holds on a slope."""
    joint = spec.joint(prefix + wheel.joint)
    joint.armature = 0.002
    joint.damping, joint.frictionloss = (_WHEEL_DAMPING, 0.0, 0.0), 0.0
    effort = float(np.ptp(joint.actfrcrange)) / 2.0 or setup.wheel_effort
    actuator = spec.add_actuator(
        name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    actuator.set_to_position(kp=4.0 * effort, kv=0.2 * effort)
    actuator.forcerange, actuator.forcelimited = (-effort, effort), mujoco.mjtLimited.mjLIMITED_TRUE


def _add_servo(spec: mujoco.MjSpec, name: str, inertia: float, config: DynamicsConfig) -> None:
    """A critically damped position servo for the largest inertia of its joint."""
    joint = spec.joint(name)
    joint.armature = 0.1 * inertia
    joint.damping, joint.frictionloss = (0.0, 0.0, 0.0), 0.0  # its servo knows them
    actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    moved = 1.1 * inertia
    actuator.set_to_position(
        kp=moved * config.arm_stiffness**2, kv=2.0 * moved * config.arm_stiffness
    )
    effort = float(np.ptp(joint.actfrcrange)) / 2.0 or _NO_EFFORT_LIMIT
    actuator.forcerange, actuator.forcelimited = (-effort, effort), mujoco.mjtLimited.mjLIMITED_TRUE


def _solids(body: mujoco.MjsBody) -> list[mujoco.MjsGeom]:
    return [geom for geom in body.geoms if geom.group == COLLISION_GROUP]
