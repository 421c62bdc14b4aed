"""When a robot that does not know its place goes back to where it last looked and did."""

from __future__ import annotations

from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.robot import RobotState


class WayBack:
    """Notes the last look that succeeded, and whether to go back there.

    From there known things are in view, by which a lost camera finds its place. One failed look
    sends the robot back once: where the look there fails too it goes on.

    Args:
        mission: keeps the place, so that a restarted robot knows it, too.

    Attributes:
        is_due: whether the look after it failed.
    """

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self.is_due = self._is_taken = False

    def looked(self, state: RobotState) -> None:
        """A look succeeded from a state."""
        self._mission.note_success(state)
        self.is_due = self._is_taken = False

    def failed(self) -> None:
        """A look failed: it is time to go back, unless that was just done."""
        self.is_due = self._mission.last_look.is_known and not self._is_taken
        self._is_taken = False

    def take(self) -> None:
        """The robot goes back."""
        self.is_due, self._is_taken = False, True
