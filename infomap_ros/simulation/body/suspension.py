"""Springs between the wheels and the body that give when the load shifts, not on uneven ground.

As a rocker with a differential does, they are stiff against what would move the body as a whole
(up and down, pitch, roll) and soft against what only sets the wheels apart. So all wheels stay on
the ground and carry their share of the weight.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.trial import TrialModel

import mujoco  # isort: skip  # after the backend has been chosen

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
