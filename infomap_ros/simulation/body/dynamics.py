"""Makes a robot in a world move by forces: springs at its wheels, servos in its joints.

The URDF knows rigid wheels without motors. Here each driven wheel gets a spring between it and the
body, a servo that turns it, and friction with the ground. All other joints get position servos.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from infomap_ros.geometry.config import check_config
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.trial import TrialModel, Wheel
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP

# Springs between the wheels and the body that give when the load shifts, not on uneven ground.
#
# As a rocker with a differential does, they are stiff against what would move the body as a whole
# (up and down, pitch, roll) and soft against what only sets the wheels apart. So all wheels stay on
# the ground and carry their share of the weight.

SUSPENSION = "_suspension"
"""Ending of the names of the joints that are not in the URDF."""

_GRAVITY = 9.81  # [m/s^2]
_FEWEST_WHEELS = 3  # fewer have casters and do not rest on their wheels alone


def add_suspension(
    spec: mujoco.MjSpec, prefix: str, setup: RobotSetupConfig, trial: TrialModel
) -> None:
    """Put a slide before each wheel's hinge, and springs over all of them.

    The springs are loaded so that the robot stands on level ground as its URDF draws it. Robots
    with casters and those with a sag of 0 stay rigid.

    Args:
        spec: the world with the robot.
        prefix: of the robot's names.
        setup: gives sag, travel and damping.
        trial: the robot, measured.
    """
    if setup.suspension_sag == 0.0 or len(trial.wheels) < _FEWEST_WHEELS:
        return
    load = trial.mass * _GRAVITY / len(trial.wheels)
    stiffness = load / setup.suspension_sag
    damping = 2.0 * setup.suspension_damping * float(np.sqrt(stiffness * load / _GRAVITY))
    soft = setup.suspension_warp * stiffness
    slides = [
        _add_slide(spec, prefix, wheel.joint, soft, damping, setup.suspension_travel)
        for wheel in trial.wheels
    ]
    for index, (mode, weight) in enumerate(zip(*_modes(trial), strict=True)):
        tendon = spec.add_tendon(name=f"{prefix}suspension_{index}")
        for slide, share in zip(slides, mode, strict=True):
            tendon.wrap_joint(slide, share)
        tendon.stiffness = (stiffness - soft, 0.0, 0.0)
        rest = weight / (stiffness - soft)
        tendon.springlength = (rest, rest)


def _modes(trial: TrialModel) -> tuple[FloatArray, FloatArray]:
    """Ways in which the body moves over its wheels, and the weight that each carries.

    Returns:
        Orthonormal rows over the wheels, shape (3, n): how far each wheel goes down; and the
        weights, shape (3,), not negative [N].
    """
    places = np.array([wheel.place for wheel in trial.wheels])
    rigid = np.column_stack([np.ones(len(places)), places[:, :2]])
    modes = np.linalg.qr(rigid)[0].T
    balance = trial.mass * _GRAVITY * np.array([1.0, *trial.center_of_mass[:2]])
    loads = np.linalg.lstsq(rigid.T, balance, rcond=None)[0]
    weights = modes @ loads
    signs = np.where(weights < 0.0, -1.0, 1.0)
    return -modes * signs[:, None], np.abs(weights)


def _add_slide(
    spec: mujoco.MjSpec,
    prefix: str,
    wheel: str,
    stiffness: float,
    damping: float,
    travel: float,
) -> str:
    """Put a slide along the vertical of the wheel's parent before its hinge; returns its name."""
    old = spec.joint(prefix + wheel)
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
    up = np.zeros(3)
    turn = np.array(body.quat) * (1.0, -1.0, -1.0, -1.0)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), turn)
    name = prefix + wheel + SUSPENSION
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=up,
        stiffness=stiffness,
        damping=damping,
        range=(-travel, travel),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
    )
    body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, **hinge)
    return name


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
