"""The next best view of a robot in a team: chosen, claimed, and given up for a teammate's.

While this robot chooses, others do. What they have claimed meanwhile is seen when the choice is
made, and the robot chooses again. Claims that cross on their way are waited for: of two robots that
are about to see the same, the one with the smaller id goes, the other chooses again. So two robots
are never sent to look at the same thing as long as messages arrive within `SETTLING`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from infomap_ros.errors import TeammatesBusyError
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState
from infomap_ros.exploration.team.teamwork import Teamwork, teammate_of
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.team.agents import Agent

WAITING = "waiting for teammates"
"""How the message of each `TeammatesBusyError` begins."""

SETTLING = 0.3
"""After a goal is claimed, time for claims that teammates made at the same moment: longer than a
message takes [s]."""
_ROUNDS = 4  # choices, one after the other, that a teammate was quicker to claim
_RETRY = 5.0  # time after which the map may have become another although no goal has [s]


@dataclass(frozen=True)
class _Waiting:
    """What there was to wait for: the others' claims, since when, when it was tried last."""

    claims: dict[int, int]
    since: float
    tried: float
    reason: str


class TeamPlanner:
    """A `ViewPlanner` that knows of its team.

    Args:
        planner: of this robot alone.
        team: what is known of the others.
        announce: reports this robot to the others at once.
        wait: lets a time pass [s], in which messages are received.
        clock: steady time, as the one by which messages are received [s].
    """

    def __init__(
        self,
        planner: ViewPlanner,
        team: Teamwork,
        announce: Callable[[], None],
        wait: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.planner, self._team = planner, team
        self._announce, self._wait, self._clock = announce, wait, clock
        self._waiting: _Waiting | None = None

    def choose(
        self, voxel_map: VoxelMap, state: RobotState, around: Surrounding | None = None
    ) -> Choice:
        """The next best view that no teammate is about to see, or why there is none.

        Args:
            voxel_map: what the team knows.
            state: where the robot is.
            around: interests and start; the teammates are put in.

        Raises:
            TeammatesBusyError: what is left the others are at, or they are in the way; the answer
                may be another one later. Raised as long as others go from view to view, and for
                `AgentsConfig.idle_timeout` after that.
        """
        self._stay_while_nothing_changes()
        for _ in range(_ROUNDS):
            known = self._team.claims(self._clock())
            choice = self.planner.choose(voxel_map, state, self._among(around, state))
            if choice.pose is None or choice.route is None:
                return self._nothing(choice)
            claimed = self._team.claims_since(known, self._clock())
            if self._see_the_same(voxel_map, choice.pose, claimed):
                self.planner.withdraw()
                continue
            if self._claimed(voxel_map, choice.pose, choice.route.base_path):
                self._waiting = None
                return choice
        return self._later("they were quicker to claim every view that was chosen")

    def route_to(self, voxel_map: VoxelMap, state: RobotState, place: KnownPlace) -> Choice:
        """The route to where the robot has stood, around the others."""
        self._team.give_up()
        obstacles = self._team.obstacles(self._clock(), state, self.planner.robot)
        return self.planner.route_to(voxel_map, state, place, obstacles)

    def plan_arm(self, voxel_map: VoxelMap, state: RobotState, T_map_camera: FloatArray) -> Choice:
        """The rest of the route to a view, around the others."""
        obstacles = self._team.obstacles(self._clock(), state, self.planner.robot)
        return self.planner.plan_arm(voxel_map, state, T_map_camera, obstacles)

    def failed(self, view: FailedView) -> None:
        """Note that a view brought nothing; this robot is not heading for it any more."""
        self._team.give_up()
        self.planner.failed(view)

    def _claimed(self, voxel_map: VoxelMap, pose: FloatArray, path: FloatArray) -> bool:
        """Claim a view; whether it is still this robot's when claims had time to cross."""
        self._team.claim(pose, path, self._team.claims(self._clock()))
        self._announce()
        if self._team.present(self._clock()):
            self._wait(SETTLING)
        if not self._see_the_same(voxel_map, pose, self._team.rivals(self._clock())):
            return True
        self._team.give_up()
        self.planner.withdraw()
        self._announce()
        return False

    def _see_the_same(self, voxel_map: VoxelMap, pose: FloatArray, others: Sequence[Agent]) -> bool:
        """Whether robots are about to see most of what a view does, or it is too near to theirs."""
        if not others:
            return False
        choice = self.planner.config.choice
        mates = [teammate_of(agent) for agent in others]
        for mate in mates:
            assert mate.goal is not None
            gap = np.linalg.norm(mate.goal[:3, 3] - pose[:3, 3])
            if gap < choice.candidates.teammate_clearance:
                return True
        left = self.planner.share_left(voxel_map, pose, mates)
        return 1.0 - left > choice.selection.max_shared

    def _among(self, around: Surrounding | None, state: RobotState) -> Surrounding:
        now = self._clock()
        return replace(
            around or Surrounding(),
            teammates=self._team.teammates(now),
            obstacles=self._team.obstacles(now, state, self.planner.robot),
        )

    def _nothing(self, choice: Choice) -> Choice:
        """There is no view: others may be why, unless the task is done."""
        self._team.give_up()
        busy = [agent for agent in self._team.present(self._clock()) if agent.goal is not None]
        done = self.planner.is_done(choice.progress)
        if busy and not done:
            names = ", ".join(str(agent.robot) for agent in busy)
            return self._later(f"there is nothing to do while they are at work ({names})", choice)
        self._waiting = None
        return choice

    def _stay_while_nothing_changes(self) -> None:
        """Spare a choice that would end as the last one.

        Raises:
            TeammatesBusyError: that one had to wait for teammates, and they are where they were.
        """
        now, waiting = self._clock(), self._waiting
        same = waiting is not None and waiting.claims == self._team.claims(now)
        if waiting is not None and same and now - waiting.tried < _RETRY:
            raise TeammatesBusyError(waiting.reason)

    def _later(self, why: str, choice: Choice | None = None) -> Choice:
        """Ask to be asked again, until that has lasted too long.

        Raises:
            TeammatesBusyError: not yet too long.
        """
        now, before = self._clock(), self._waiting
        claims, reason = self._team.claims(now), f"{WAITING}: {why}"
        since = now if before is None or before.claims != claims else before.since
        self._waiting = _Waiting(claims, since, now, reason)
        if choice is None or now - since < self._team.config.idle_timeout:
            raise TeammatesBusyError(reason)
        self._waiting = None
        return choice
