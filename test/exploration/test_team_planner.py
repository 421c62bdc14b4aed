"""Two robots that choose: never the same thing, whoever is quicker and also at the same moment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from infomap_ros.errors import TeammatesBusyError, UpdateRefusedError
from infomap_ros.exploration.robot import Choice, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.team.team_planner import SETTLING, TeamPlanner
from infomap_ros.exploration.team.teamwork import Presence, Teamwork, teammate_of
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera, StereoRig, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.state import VoxelStates, information_of, put_states
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.whole_body import ReachingConfig
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.team.agent_board import SILENCE
from infomap_ros.team.agents import AgentsConfig
from infomap_ros.views.next_best_view import NextBestViewConfig
from infomap_ros.views.sampling.candidates import CandidateConfig
from infomap_ros.views.selection import SelectionConfig
from infomap_ros.views.situation import Teammate

from .fakes import pose_at, progress, route_to

CAMERA = PinholeCamera(160, 120, 110.0, 110.0, 79.5, 59.5)
TASK = TaskConfig(region_low=(-2.4, -0.6, -0.3), region_high=(3.4, 0.6, 1.0))
QUICK = ViewPlannerConfig(
    arm_views=40,
    threads=1,
    max_range=2.5,
    choice=NextBestViewConfig(
        candidates=CandidateConfig(candidates=250), selection=SelectionConfig(refined=15)
    ),
    reaching=ReachingConfig(postures=3000),
)


class Air:
    """Carries what robots announce, when it is asked to; keeps the time."""

    def __init__(self) -> None:
        self.now = 100.0
        self.waiting: list[tuple[Teamwork, str]] = []
        self.teams: list[Teamwork] = []

    def carry(self) -> None:
        while self.waiting:
            sender, text = self.waiting.pop(0)
            for team in self.teams:
                if team is not sender:
                    team.receive(text, self.now)


class Member:
    """A robot that has a team.

    Args:
        air: to which it speaks.
        number: its id.
        planner: of its own; `during_wait` is called while it waits for claims that cross.
    """

    def __init__(
        self, air: Air, number: int, planner: ViewPlanner, state: RobotState, robot: RobotModel
    ) -> None:
        self.air, self.state, self.robot = air, state, robot
        config = AgentsConfig(idle_timeout=10.0)
        self.team = Teamwork(number, 10 + number, 1000 * number, config)
        air.teams.append(self.team)
        self.during_wait: Callable[[], object] = lambda: None
        clock = lambda: air.now  # noqa: E731
        self.planner = TeamPlanner(planner, self.team, self.announce, self.wait, clock)
        self.choices: list[Choice] = []

    def announce(self) -> None:
        presence = Presence(5, self.state, self.robot, CAMERA, 2.5, "choosing")
        self.air.waiting.append((self.team, self.team.announcement(presence).text))

    def wait(self, seconds: float) -> None:
        assert seconds == SETTLING
        during, self.during_wait = self.during_wait, lambda: None
        during()
        self.air.now += seconds
        self.air.carry()

    def choose(self, voxel_map: VoxelMap) -> Choice:
        self.choices.append(self.planner.choose(voxel_map, self.state))
        return self.choices[-1]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    description = read_description(find_share("config/rover.urdf"))
    return RobotModel.from_urdf(description, "left_camera_optical_frame", "base_link")


@pytest.fixture(scope="module")
def yard() -> VoxelMap:
    """Even ground, of which x < -1 m and, farther away, x > 2.6 m is not known."""
    voxel_map = VoxelMap()
    size = voxel_map.config.voxel_size
    indices = np.indices((72, 80, 27), np.int32).reshape(3, -1).T + np.int32((-20, -40, -1))
    quanta = np.where(indices[:, 2] < 0, 20, -20).astype(np.int32)
    ground = indices[:, 2] == -1
    covariances = np.tile(1e-6 * np.eye(3), (len(indices), 1, 1))
    gaussians = information_of(indices, ground, (indices + 0.5) * size, covariances, size)
    known = np.ones(len(indices), bool)
    put_states(voxel_map._storage, VoxelStates(indices, known, quanta, gaussians))
    return voxel_map


def standing(robot: RobotModel, x: float, y: float) -> RobotState:
    joints = {joint.name: 0.0 for joint in robot.joints}
    T_map_base = make_transform(np.eye(3), (x, y, 0.09))
    T_base_camera = robot.forward_kinematics(joints, robot.camera_frame)
    return RobotState(T_map_base, T_map_base @ T_base_camera, 1e-6 * np.eye(6), joints)


def pair(robot: RobotModel, first: int, second: int) -> tuple[Air, Member, Member]:
    """Two robots beside each other, 1.4 m apart, that have heard of each other."""
    air, rig = Air(), StereoRig(CAMERA, CAMERA, 0.1)
    members = [
        Member(air, n, ViewPlanner(robot, rig, TASK, QUICK), standing(robot, 0.3, y), robot)
        for n, y in ((first, 0.7), (second, -0.7))
    ]
    for member in members:
        member.announce()
    air.carry()
    return air, members[0], members[1]


def left_of(planner: ViewPlanner, voxel_map: VoxelMap, choice: Choice, other: Teamwork) -> float:
    """Share of a choice that is left by what another robot tells it is heading for."""
    assert choice.pose is not None and other.goal is not None
    goal = Teammate(np.array((90.0, 0, 0)), other.goal, 2.5)
    return planner.share_left(voxel_map, choice.pose, [goal])


def test_who_hears_a_goal_chooses_another_thing_and_another_place(
    robot: RobotModel, yard: VoxelMap
) -> None:
    _, one, two = pair(robot, 1, 2)
    alone = two.planner.planner.choose(yard, two.state)
    first = one.choose(yard)
    assert alone.pose is not None and first.pose is not None
    left = left_of(one.planner.planner, yard, alone, one.team)
    assert left < 0.5, "alone it would see the same"
    second = two.choose(yard)
    assert left_of(two.planner.planner, yard, second, one.team) >= 0.5
    assert second.explanation["terms"]["teammates"] <= 0.0
    assert any("teammate" in reason for reason in second.explanation["rejections"])
    assert first.route is not None and second.route is not None
    apart = first.route.base_poses[-1][:2, 3] - second.route.base_poses[-1][:2, 3]
    assert np.linalg.norm(apart) > 0.6


@pytest.mark.parametrize(("first", "second"), [(1, 2), (2, 1)])
def test_of_two_that_choose_at_once_the_smaller_id_goes(
    robot: RobotModel, yard: VoxelMap, first: int, second: int
) -> None:
    """The other chooses while the first waits: neither has heard of the other's claim."""
    _, one, two = pair(robot, first, second)
    one.during_wait = lambda: two.choose(yard)
    one.choose(yard)
    goes, yields = (one, two) if first < second else (two, one)
    for member, plans in ((goes, 1), (yields, 2)):
        assert len(member.planner.planner._past) == plans
        assert member.choices[-1].pose is not None and member.team.goal is not None
        np.testing.assert_allclose(member.team.goal, member.choices[-1].pose)
    left = left_of(yields.planner.planner, yard, yields.choices[-1], goes.team)
    assert left >= 0.5


class Script:
    """A planner that chooses what it is told, and says of any two views whether they overlap."""

    def __init__(self, robot: RobotModel, *choices: Choice, overlap: bool = True) -> None:
        self.robot, self.config, self._choices, self._overlap = robot, QUICK, choices, overlap
        self.during: Callable[[], object] = lambda: None
        self.around: list[Surrounding] = []
        self.withdrawn: list[int] = []

    def choose(self, voxel_map: VoxelMap, state: RobotState, around: Surrounding) -> Choice:
        self.around.append(around)
        self.during()
        return self._choices[min(len(self.around), len(self._choices)) - 1]

    def share_left(self, voxel_map: VoxelMap, pose: np.ndarray, mates: Any) -> float:
        return 0.0 if self._overlap else 1.0

    def withdraw(self) -> None:
        self.withdrawn.append(len(self.around))

    def is_done(self, state: Any) -> bool:
        return state.known_fraction > 0.9


def view(x: float) -> Choice:
    return Choice(progress(), pose_at(x, 0.0), route_to(x), "")


def nothing(known: float = 0.5) -> Choice:
    return Choice(progress(known), None, None, "no view")


def scripted(robot: RobotModel, script: Script, number: int = 1) -> tuple[Air, Member, Member]:
    air = Air()
    states = standing(robot, 0.0, 0.0), standing(robot, 3.0, 0.0)
    one = Member(air, number, cast(ViewPlanner, script), states[0], robot)
    mate = Member(air, 5, cast(ViewPlanner, Script(robot)), states[1], robot)
    return air, one, mate


def claims(mate: Member, x: float) -> None:
    mate.team.claim(pose_at(x, 0.0), np.array([[3.0, 0.0, 0.0], [x, 0.0, 0.0]]), {})
    mate.announce()
    mate.air.carry()


@pytest.mark.parametrize(("overlap", "choices"), [(True, 2), (False, 1)])
def test_what_was_claimed_while_it_planned_makes_it_plan_again(
    robot: RobotModel, overlap: bool, choices: int
) -> None:
    """Whatever the ids: the claim was there before its own."""
    script = Script(robot, view(1.0), view(-2.0), overlap=overlap)
    _, one, mate = scripted(robot, script)
    script.during = lambda: claims(mate, 2.0) if len(script.around) == 1 else None
    choice = one.planner.choose(VoxelMap(), one.state)
    assert len(script.around) == choices
    assert choice.pose is not None and choice.pose[0, 3] == (1.0 if choices == 1 else -2.0)
    assert script.withdrawn == [1][: choices - 1]
    goals = [around.teammates[0].goal for around in script.around[1:] if around.teammates]
    assert all(goal is not None and goal[0, 3] == 2.0 for goal in goals)


def test_a_claim_that_knew_of_ones_own_does_not_go_before_it(robot: RobotModel) -> None:
    script = Script(robot, view(1.0))
    air, one, mate = scripted(robot, script, number=9)

    def answer() -> None:
        air.carry()
        mate.team.claim(pose_at(2.0, 0.0), np.zeros((1, 3)), mate.team.claims(air.now))
        mate.announce()

    mate.announce()
    air.carry()
    one.during_wait = answer
    one.planner.choose(VoxelMap(), one.state)
    assert len(script.around) == 1


def test_it_waits_for_teammates_and_not_for_ever(robot: RobotModel) -> None:
    script = Script(robot, nothing())
    air, one, mate = scripted(robot, script)
    claims(mate, 2.0)
    for _ in range(3):
        with pytest.raises(TeammatesBusyError, match=r"at work \(5\)"):
            one.planner.choose(VoxelMap(), one.state)
        air.now += 3.0
        mate.announce()
        air.carry()
    air.now += 4.0
    mate.announce()
    air.carry()
    assert one.planner.choose(VoxelMap(), one.state).reason == "no view"


def test_it_waits_as_long_as_teammates_go_from_view_to_view(robot: RobotModel) -> None:
    """And plans only where a goal, or after some time the map, may have become another."""
    script = Script(robot, nothing())
    air, one, mate = scripted(robot, script)
    plans = []
    for x in (2.0, 2.5, 3.0):
        claims(mate, x)
        for _ in range(3):
            with pytest.raises(TeammatesBusyError, match="waiting for teammates"):
                one.planner.choose(VoxelMap(), one.state)
            plans.append(len(script.around))
            air.now += 2.9
            mate.announce()
            air.carry()
    assert plans == [1, 1, 2, 3, 3, 4, 5, 5, 6]


@pytest.mark.parametrize("why", ["done", "idle", "silent"])
def test_it_waits_for_nobody_where_that_cannot_help(robot: RobotModel, why: str) -> None:
    script = Script(robot, nothing(0.95 if why == "done" else 0.5))
    air, one, mate = scripted(robot, script)
    claims(mate, 2.0)
    if why == "idle":
        mate.team.give_up()
        mate.announce()
        air.carry()
    if why == "silent":
        air.now += SILENCE + 0.1
    assert one.planner.choose(VoxelMap(), one.state).reason == "no view"


def test_who_is_silent_no_longer_wants_anything_but_still_stands_there(robot: RobotModel) -> None:
    air, one, mate = scripted(robot, Script(robot))
    claims(mate, 2.0)
    (before,) = one.team.teammates(air.now)
    obstacles = one.team.obstacles(air.now, one.state, robot)
    air.now += 6.0
    (after,) = one.team.teammates(air.now)
    bodies = one.team.obstacles(air.now, one.state, robot)
    assert before.goal is not None and after.goal is None
    assert len(obstacles) > 1 and [body.name for body in bodies] == ["robot 5"]
    air.now += 60.0
    assert one.team.teammates(air.now) == ()


def test_obstacles_hold_body_and_path_but_not_ones_own_place(robot: RobotModel) -> None:
    air, one, mate = scripted(robot, Script(robot))
    claims(mate, -3.0)
    body, *path = one.team.obstacles(air.now, one.state, robot)
    points = robot_points(robot, mate.state)
    away = np.hypot(points[:, 0] - body.x, points[:, 1] - body.y)
    assert away.max() + 0.3 <= body.radius + 1e-9
    assert body.bottom <= points[:, 2].min() and body.top >= points[:, 2].max()
    own = robot_points(robot, one.state)
    for obstacle in path:
        gaps = np.hypot(own[:, 0] - obstacle.x, own[:, 1] - obstacle.y)
        assert gaps.min() >= obstacle.radius
    corridor = [o for o in path if o.x > 1.5]
    assert max(np.diff(sorted(o.x for o in corridor))) < 2.0 * min(o.radius for o in corridor)


def robot_points(robot: RobotModel, state: RobotState) -> np.ndarray:
    """Centers of the solids of a robot, map frame, (S, 3)."""
    solids = robot.solids_in(robot.base_frame, state.joints)
    return np.array([(state.T_map_base @ each.transform)[:3, 3] for each in solids])


def test_strangers_do_not_count(robot: RobotModel) -> None:
    air, _, mate = scripted(robot, Script(robot))
    closed = Teamwork(1, 3, 1, team=(1, 2))
    mate.announce()
    with pytest.raises(UpdateRefusedError, match="not on the team list"):
        closed.receive(air.waiting[0][1], 0.0)
    assert closed.present(0.0) == ()


def test_it_tells_since_when_it_has_stood_still(robot: RobotModel) -> None:
    _, one, mate = scripted(robot, Script(robot))
    here, there = mate.state, standing(robot, 3.0, 0.02)
    waving = RobotState(
        here.T_map_base,
        here.T_map_camera,
        here.pose_covariance,
        {**here.joints, "arm_pan_joint": 0.1},
    )
    since = []
    for stamp, state in ((10, here), (20, here), (30, there), (40, waving), (50, waving)):
        text = mate.team.announcement(Presence(stamp, state, robot, CAMERA, 2.5)).text
        agent = one.team.receive(text, 0.0)
        assert agent is not None
        since.append(agent.since)
    assert since == [10, 10, 30, 40, 40]


def test_a_goal_that_is_never_reached_is_given_up(robot: RobotModel) -> None:
    _, _, mate = scripted(robot, Script(robot))
    mate.team.claim(pose_at(2.0, 0.0), np.zeros((1, 3)), {})
    held = []
    for seconds in (100, 399, 401, 500):
        mate.team.announcement(Presence(seconds * 10**9, mate.state, robot, CAMERA, 2.5))
        held.append(mate.team.goal is not None)
    assert held == [True, True, False, False]


def test_a_robot_whose_clock_went_back_learns_it_and_is_heard(robot: RobotModel) -> None:
    _, one, mate = scripted(robot, Script(robot))
    number = mate.team.robot
    versions = (10**6, 10**6 - 5000)
    first, again = (Teamwork(number, session, v) for session, v in enumerate(versions, start=50))
    presence = Presence(5, mate.state, robot, CAMERA, 2.5)
    assert one.team.receive(first.announcement(presence).text, 0.0)
    heard = []
    for now in (1.0, 1.2, 1.4):
        heard.append(one.team.receive(again.announcement(presence).text, now) is not None)
        again.receive(one.team.announcement(presence).text, now)
    assert heard == [False, True, True]
    liar = Teamwork(77, 1, 2**20)
    liar.claim(pose_at(2.0, 0.0), np.zeros((1, 3)), {number: 10**6 + 2**30})
    again.receive(liar.announcement(presence).text, 1.5)
    assert one.team.receive(again.announcement(presence).text, 1.6), (
        "not sent where nobody hears it"
    )


def test_a_teammate_is_told_as_it_is(robot: RobotModel) -> None:
    air, one, mate = scripted(robot, Script(robot))
    claims(mate, 2.0)
    (agent,) = one.team.present(air.now)
    seen = teammate_of(agent)
    assert seen.goal is not None
    np.testing.assert_allclose(seen.goal, pose_at(2.0, 0.0))
    np.testing.assert_allclose(agent.T_map_base, mate.state.T_map_base, atol=1e-12)
    assert (seen.max_range, seen.camera, agent.state) == (2.5, CAMERA, "choosing")
    assert seen.stand is not None and seen.stand[0] == 2.0
    assert dict(agent.joints) == dict(mate.state.joints)
