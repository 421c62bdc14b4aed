"""Before an exploration can begin: look for the target whose frame is the map."""

from __future__ import annotations

from typing import Protocol

from infomap_ros.exploration.loop import Ending, EndReason, Exploration
from infomap_ros.exploration.robot import Choice, Interrupted


class SearchSight(Protocol):
    """What says whether the target has come into sight. Every call is bounded in time."""

    def look(self, interrupted: Interrupted) -> str:
        """Wait until localization has looked at images from here; empty, or why it has not."""

    @property
    def found(self) -> bool:
        """Whether the camera has been located in the target's frame."""


class SearchPlanner(Protocol):
    """Chooses where to look for the target. Every call is bounded in time."""

    def look_for_target(self) -> Choice:
        """The next look; without a route, its reason says that there is none left."""


def find_target(
    exploration: Exploration, sight: SearchSight, planner: SearchPlanner, what: str = "the target"
) -> Ending | None:
    """Turn the camera until localization has found the target.

    Args:
        exploration: that cannot begin without; its robot moves, its log and state tell of it.
        sight: whether the target was found.
        planner: chooses the looks.
        what: is looked for, in words.

    Returns:
        None when it was found or the search was interrupted, else why it ended in vain.

    Raises:
        InfomapError: the planner gives no answer.
    """
    interrupted, failures = exploration.control.interrupted, 0
    while not interrupted():
        problem = sight.look(interrupted)
        if sight.found or interrupted():
            return None
        if not problem:
            choice = planner.look_for_target()
            exploration.say(f"looking for {what}", choice.reason)
            if choice.route is None:
                return Ending(EndReason.FAILED, choice.reason)
            problem = exploration.follow(choice.route, lambda: interrupted() or sight.found)
        failures = failures + 1 if problem and not sight.found else 0
        if failures >= exploration.task.max_failures:
            return Ending(EndReason.FAILED, f"{what} was not found: {problem}")
    return None
