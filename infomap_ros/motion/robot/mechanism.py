"""The joints of a robot, and how their positions move them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.joint_limits import JointLimits, joint_limits
from infomap_ros.motion.robot.mimicry import Follower


class Mechanism:
    """Joints by index of a Pinocchio model, and positions by name. Immutable.

    The model knows nothing of joints that mimic another: it takes a position of each. Pinocchio's
    own mimicking joints have to come after their leaders and cannot follow a follower.

    Args:
        model: the joints.
        followers: those that mimic another, by name.
        assumed: names of joints whose position may be missing; they stand where they rest.

    Raises:
        RobotModelError: a joint of `assumed` has no position of its own.

    Attributes:
        model: every joint has one degree of freedom; not to be written to.
        indices: index of each joint that has a position of its own, by name, in the model's order.
    """

    def __init__(
        self,
        model: pinocchio.Model,
        followers: Mapping[str, Follower] | None = None,
        assumed: Iterable[str] = (),
    ) -> None:
        self.model = model
        names = {str(name): index for index, name in enumerate(model.names) if index > 0}
        self._followers = {
            names[name]: (names[item.leader], item.factor, item.offset)
            for name, item in (followers or {}).items()
        }
        self.indices = {k: index for k, index in names.items() if index not in self._followers}
        self._limits = {name: joint_limits(model, index) for name, index in self.indices.items()}
        for name in assumed:
            if name not in self.indices:
                raise RobotModelError(f"there is no joint '{name}' whose position can be assumed")
        self._assumed = {
            name: limits.rest
            for name, limits in self._limits.items()
            if name in assumed or limits.lower == limits.upper
        }

    @property
    def joints(self) -> tuple[JointLimits, ...]:
        """The joints that have a position of their own, in the model's order."""
        return tuple(self._limits.values())

    def owner_of(self, index: int) -> int:
        """The joint whose position moves this one: itself, or the one that it mimics."""
        return self._followers.get(index, (index, 1.0, 0.0))[0]

    def scaling_of(self, index: int) -> tuple[float, float]:
        """Factor and offset from the position of `owner_of` to that of the joint."""
        return self._followers.get(index, (index, 1.0, 0.0))[1:]

    def limits_of(self, index: int) -> JointLimits:
        """Limits of a joint that has a position of its own."""
        return self._limits[str(self.model.names[index])]

    def slides(self, index: int) -> bool:
        """Whether the joint is prismatic."""
        return str(self.model.joints[index].shortname()).startswith("JointModelP")

    def above(self, joints: Iterable[int]) -> frozenset[int]:
        """All joints, those that mimic included, that carry these, with themselves."""
        return frozenset(int(index) for joint in joints for index in self.model.supports[joint]) - {
            0
        }

    def owners(self, joints: Iterable[int]) -> frozenset[str]:
        """Names of the joints whose positions move any of these."""
        return frozenset(str(self.model.names[self.owner_of(index)]) for index in joints)

    def configuration(self, positions: Mapping[str, float], needed: Iterable[str]) -> FloatArray:
        """Pinocchio's configuration, shape (nq,); joints that are not needed stand at zero.

        Args:
            positions: by name [rad or m]; unknown names are ignored.
            needed: names of joints that must be there.

        Raises:
            RobotModelError: a needed joint is missing or its position is not finite; names it.
        """
        known = {**self._assumed, **positions}
        missing = [name for name in needed if name not in known]
        if missing:
            names = ", ".join(map(repr, sorted(missing)))
            raise RobotModelError(
                f"no position of joint {names}; if nobody reports it, name it in assumed_joints"
            )
        return self._written({name: known[name] for name in needed})

    def resting(self, held: Mapping[str, float]) -> FloatArray:
        """Pinocchio's configuration, shape (nq,), with all joints at rest but those of `held`.

        Args:
            held: by name [rad or m]; the others stand at zero or at their limit nearest to it.

        Raises:
            RobotModelError: a position of `held` is not finite or is that of an unknown joint.
        """
        for name in held:
            if name not in self.indices:
                raise RobotModelError(f"joint '{name}' has no position that can be held")
        return self._written({joint.name: joint.rest for joint in self.joints} | dict(held))

    def _written(self, positions: Mapping[str, float]) -> FloatArray:
        q = np.asarray(pinocchio.neutral(self.model))
        for name, value in positions.items():
            position = float(value)
            if not math.isfinite(position):
                raise RobotModelError(f"position of joint '{name}' is {position}")
            self._write(q, self.indices[name], position)
        for index, (leader, factor, offset) in self._followers.items():
            name = str(self.model.names[leader])
            if name in positions:
                self._write(q, index, factor * float(positions[name]) + offset)
        return q

    def _write(self, q: FloatArray, index: int, position: float) -> None:
        joint = self.model.joints[index]
        if joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = math.cos(position), math.sin(position)
        else:
            q[joint.idx_q] = position
