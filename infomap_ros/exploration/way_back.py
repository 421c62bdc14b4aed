"""Where a robot that does not know its place goes: to where it last looked and did."""

from __future__ import annotations

from collections.abc import Mapping

from infomap_ros.exploration.planar import planar_pose
from infomap_ros.exploration.robot import RobotState


class WayBack:
    """Remembers the last look that succeeded, and whether to go back there.

    From there known things are in view, by which a lost camera finds its place. One failed look
    sends the robot back once: where the look there fails too it goes on.

    Attributes:
        base: x, y [m] and yaw [rad] of the base at the last look; empty before the first.
        joints: positions then, by name [rad or m].
        is_due: whether the look after it failed.
    """

    def __init__(self) -> None:
        self.base: tuple[float, ...] = ()
        self.joints: Mapping[str, float] = {}
        self.is_due = self._is_taken = False

    def looked(self, state: RobotState) -> None:
        """A look succeeded from a state."""
        self.base, self.joints = planar_pose(state.T_map_base), dict(state.joints)
        self.is_due = self._is_taken = False

    def failed(self) -> None:
        """A look failed: it is time to go back, unless that was just done."""
        self.is_due = bool(self.base) and not self._is_taken
        self._is_taken = False

    def take(self) -> None:
        """The robot goes back."""
        self.is_due, self._is_taken = False, True
