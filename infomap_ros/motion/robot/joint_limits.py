"""How far and how fast a joint moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class JointLimits:
    """A joint that has a position of its own.

    Attributes:
        name: as in the URDF.
        lower: smallest position [rad or m]; -inf for a continuous joint.
        upper: largest position [rad or m]; inf for a continuous joint.
        velocity: largest speed [rad/s or m/s]; inf where the URDF gives none.
        is_continuous: turns without end.
    """

    name: str
    lower: float
    upper: float
    velocity: float
    is_continuous: bool = False

    @property
    def rest(self) -> float:
        """Zero, or the limit nearest to it [rad or m]."""
        return min(max(0.0, self.lower), self.upper)


def joint_limits(model: pinocchio.Model, index: int) -> JointLimits:
    """Limits of one joint of a model, of one degree of freedom.

    Raises:
        RobotModelError: the lower limit is above the upper one.
    """
    name, joint = str(model.names[index]), model.joints[index]
    speed = float(_velocity_limits(model)[joint.idx_v])
    speed = speed if speed > 0.0 else math.inf
    if joint.nq == 2:
        return JointLimits(name, -math.inf, math.inf, speed, True)
    lower, upper = (
        float(x[joint.idx_q]) for x in (model.lowerPositionLimit, model.upperPositionLimit)
    )
    if not lower <= upper:
        raise RobotModelError(f"joint '{name}' has the lower limit {lower:g}, upper {upper:g}")
    return JointLimits(name, lower, upper, speed)


def _velocity_limits(model: pinocchio.Model) -> FloatArray:
    """Largest speeds by velocity index; Pinocchio 3, which ROS has, knows one for both signs."""
    if hasattr(model, "upperVelocityLimit"):
        return np.asarray(model.upperVelocityLimit)
    return np.asarray(model.velocityLimit)
