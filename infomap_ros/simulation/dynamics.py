"""Makes a robot in a world move by forces: springs at its wheels, servos in its joints.

The URDF knows rigid wheels without motors. Here each driven wheel gets a spring between it and the
body, loaded so that the robot stands as the URDF draws it; a servo that turns it; and friction
with the ground. All other joints get position servos.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.rendering import COLLISION_GROUP
from infomap_ros.simulation.robot_setup import RobotSetupConfig
from infomap_ros.simulation.trial import TrialModel, Wheel

import mujoco  # isort: skip  # after the backend has been chosen

SUSPENSION = "_suspension"
"""Ending of the names of the joints that are not in the URDF."""

_GRAVITY = 9.81  # [m/s^2]
_NO_EFFORT_LIMIT = 1e4  # [N or Nm]


@dataclass(frozen=True)
class DynamicsConfig:
    """Parameters of the simulation of forces."""

    timestep: float = parameter(0.004, "Step of the integration.", unit="s", low=0.0002, high=0.01)
    control_period: float = parameter(
        0.02, "Time between two commands to the servos.", unit="s", low=0.001, high=0.2
    )
    arm_stiffness: float = parameter(
        12.0, "Natural frequency of the joint servos.", unit="rad/s", low=1.0, high=200.0
    )

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
    loads = _loads(trial)
    for wheel, load in zip(trial.wheels, loads, strict=True):
        _shape_wheel(spec, prefix, wheel, setup)
        _suspend(spec, prefix, wheel, float(load), setup)
        _drive(spec, prefix, wheel, setup)
    for link in setup.casters:
        for geom in _solids(spec.body(prefix + link)):
            geom.priority, geom.condim = 2, 1
    for name, inertia in trial.inertia.items():
        _add_servo(spec, prefix + name, inertia, config)
    for first, second in trial.touching:
        spec.add_exclude(bodyname1=prefix + first, bodyname2=prefix + second)


def _loads(trial: TrialModel) -> FloatArray:
    """Weight on each wheel at home: the least unequal forces that balance the robot [N]."""
    places = np.array([wheel.place for wheel in trial.wheels])
    lever = np.vstack([np.ones(len(places)), places[:, :2].T])
    weight = trial.mass * _GRAVITY * np.array([1.0, *trial.center_of_mass[:2]])
    forces = np.asarray(np.linalg.lstsq(lever, weight, rcond=None)[0])
    return np.clip(forces, 0.0, trial.mass * _GRAVITY)


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
        friction=(setup.wheel_friction, 0.005, 0.0001),
        priority=1,
        mass=0.0,
    )


def _suspend(
    spec: mujoco.MjSpec, prefix: str, wheel: Wheel, load: float, setup: RobotSetupConfig
) -> None:
    """Put a loaded spring before the wheel's hinge, along the vertical of the base."""
    old = spec.joint(prefix + wheel.joint)
    body = old.parent
    hinge = {
        "name": old.name,
        "pos": np.array(old.pos),
        "axis": np.array(old.axis),
        "damping": np.array(old.damping),
        "actfrcrange": np.array(old.actfrcrange),
        "actfrclimited": old.actfrclimited,
    }
    spec.delete(old)
    if setup.suspension_sag > 0.0 and load > 0.0:
        stiffness = load / setup.suspension_sag
        damping = 2.0 * setup.suspension_damping * np.sqrt(stiffness * load / _GRAVITY)
        up = np.zeros(3)
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), _conjugate(np.array(body.quat)))
        body.add_joint(
            name=prefix + wheel.joint + SUSPENSION,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=up,
            stiffness=stiffness,
            damping=damping,
            springref=-setup.suspension_sag,
            range=(-setup.suspension_travel, setup.suspension_travel),
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
    body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, armature=0.002, **hinge)


def _conjugate(quaternion: FloatArray) -> FloatArray:
    return quaternion * (1.0, -1.0, -1.0, -1.0)


def _drive(spec: mujoco.MjSpec, prefix: str, wheel: Wheel, setup: RobotSetupConfig) -> None:
    """A position servo, which the drive moves at the wanted speed: it also holds on a slope."""
    joint = spec.joint(prefix + wheel.joint)
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
    actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    moved = 1.1 * inertia
    actuator.set_to_position(
        kp=moved * config.arm_stiffness**2, kv=2.0 * moved * config.arm_stiffness
    )
    effort = float(np.ptp(joint.actfrcrange)) / 2.0 or _NO_EFFORT_LIMIT
    actuator.forcerange, actuator.forcelimited = (-effort, effort), mujoco.mjtLimited.mjLIMITED_TRUE


def _solids(body: mujoco.MjsBody) -> list[mujoco.MjsGeom]:
    return [geom for geom in body.geoms if geom.group == COLLISION_GROUP]
