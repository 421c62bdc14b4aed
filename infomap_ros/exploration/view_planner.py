"""The next best view of a robot with arm and base: choice and motion put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from infomap_ros.exploration.mission import Mission, look_poses
from infomap_ros.exploration.progress import measure_progress
from infomap_ros.exploration.records.choice_text import SurfaceGrowth
from infomap_ros.exploration.robot import (
    Choice,
    FailedView,
    KnownPlace,
    MapProgress,
    RobotState,
    planar_pose,
)
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_choice import ViewChoice
from infomap_ros.exploration.view_motion import ViewMotion
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PlacedSolid, StereoRig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.keep_out import Obstacle
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import (
    camera_elevations,
    camera_heights,
    solid_extent,
)
from infomap_ros.motion.route import ReachResult, Route
from infomap_ros.views.decision import (
    GainPrior,
    GoalMemory,
    RatedView,
    UnproductiveLooks,
    ViewDecision,
)
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.ranking.terms import LocalizationError
from infomap_ros.views.situation import Interest, RegionOfTask, Situation, Teammate

__all__ = ["Surrounding", "ViewPlanner", "ViewPlannerConfig"]

_POOR = 0.1  # rating below which it matters more what keeps the robot from better views
_BLOCKING = 5.0  # weight of space that blocks the base because it was never seen
_SAME = 0.02  # [m] between a view that was taken and where the camera still is


@dataclass(frozen=True, eq=False)
class Surrounding:
    """What the choice depends on besides map and robot.

    Attributes:
        interests: places that matter more or less.
        teammates: other robots.
        obstacles: what must not be touched and the map does not show, such as their bodies.
        T_map_start: pose of the base where the mission began, shape (4, 4); that of the first
            choice where not given.
        past_views: ``T_map_camera`` of the views of the mission, shape (V, 4, 4): what they left
            unknown is not looked for again by a planner that was not there.
    """

    interests: Sequence[Interest] = ()
    teammates: Sequence[Teammate] = ()
    obstacles: Sequence[Obstacle] = ()
    T_map_start: FloatArray | None = None
    past_views: FloatArray = field(default_factory=lambda: np.empty((0, 4, 4)))

    @classmethod
    def of(cls, mission: Mission) -> Surrounding:
        """What a mission has seen so far; no interests, nobody else."""
        home = np.array(mission.home_pose) if mission.home_pose else None
        return cls(T_map_start=home, past_views=look_poses(mission.looks))


class ViewPlanner:
    """Chooses where the robot looks next, and how it gets there.

    Args:
        robot: with its camera frame.
        rig: the rectified stereo pair.
        task: what is to be mapped.
        config: of choice and motion.
        localization_error: model of LE of eq. (11); odometry drift where not given.

    Attributes:
        motion: what moves the robot, and checks the route that it is sent along.
    """

    def __init__(
        self,
        robot: RobotModel,
        rig: StereoRig,
        task: TaskConfig,
        config: ViewPlannerConfig | None = None,
        localization_error: LocalizationError | None = None,
    ) -> None:
        self.robot, self._rig, self._error = robot, rig, localization_error
        settings = config or ViewPlannerConfig()
        self.motion = ViewMotion(robot, settings, task, rig.left)
        self._rng = np.random.default_rng(settings.seed)
        self._heights, self._elevations = camera_heights(robot), camera_elevations(robot)
        self._unproductive, self._kept = UnproductiveLooks(), GainPrior()
        self._memory, self._growth = GoalMemory(), SurfaceGrowth()
        self._fine: tuple[Interest, ...] = ()
        self._configure(task, settings)
        self._goal: FloatArray | None = None
        self._measured: MapProgress | None = None
        self._failures: list[FailedView] = []
        self._past: list[FloatArray] = []
        self._noted = 0  # so many of which are known for what they promised in vain
        self._wanted = 0  # so many of the last of which were only wanted, and looked at from beside

    def reconfigure(self, task: TaskConfig, config: ViewPlannerConfig) -> None:
        """Choose by another task and configuration from now on.

        What past views have told, and which could not be reached, stays known.
        """
        self._configure(task, config)
        self.motion.config, self.motion.task = config, task

    def _configure(self, task: TaskConfig, config: ViewPlannerConfig) -> None:
        self.config, self._task = config, task
        sensor = replace(
            InformationConfig.of_stereo(self._rig),
            wanted_sigma=task.precise_sigma if self._fine else task.surface_sigma,
            coarse_sigma=task.surface_sigma,
            fine_places=tuple(each.place for each in self._fine),
            predict_unknown=config.predict_unknown,
        )
        self._information = ExpectedInformation(config.metric, sensor, threads=config.threads)
        self._choice = ViewChoice(config, self._information, self._memory, self._error)

    def choose(
        self, voxel_map: VoxelMap, state: RobotState, around: Surrounding | None = None
    ) -> Choice:
        """The next best view and the route there, or why there is none.

        Args:
            voxel_map: what is known.
            state: where the robot is.
            around: interests and teammates.
        """
        around = self._with_places_of_task(around or Surrounding())
        self._take_note(voxel_map, state, around)
        progress = self._progress(voxel_map, state)
        decision = self._select(voxel_map, state, around, progress)
        route = decision.reach.route if isinstance(decision.reach, ReachResult) else None
        self.motion.send(voxel_map, state, route)
        partial = route is not None and route.partial
        self._goal = decision.chosen.pose if decision.chosen is not None and partial else None
        choice = _choice_of(decision, route, progress, state, self.motion.stands_wrongly)
        surface = {"surface": self._growth.text(voxel_map)}
        return replace(choice, explanation={**choice.explanation, **surface})

    def _with_places_of_task(self, around: Surrounding) -> Surrounding:
        """Add the task's places of interest; those that matter more are mapped more precisely."""
        interests = (*self._task.places, *around.interests)
        fine = tuple(each for each in interests if each.weight > 1.0)
        if fine != self._fine:
            self._fine = fine
            self._configure(self._task, self.config)
        return replace(around, interests=interests)

    def _select(
        self, voxel_map: VoxelMap, state: RobotState, around: Surrounding, progress: MapProgress
    ) -> ViewDecision:
        """Choose among candidates, more thoroughly while the task is not met.

        Where a doubtful pose asks for so much room that no view is left, for as much as a sure one.
        Where no good view is left, space that keeps the base from going on counts more.
        """
        robot = self.motion.reach(voxel_map, state, around.obstacles)
        situation = self._situation(voxel_map, state, robot, around)
        situation = self._without_unproductive_looks(situation, progress.entropy_bits)
        ask: dict[str, Any] = {
            "goal": self._goal,
            "thorough": not self.is_done(progress),
        }
        if robot.is_wider:
            decision = self._choice.select(situation, robot, self._rng, lasting=False, **ask)
            if decision.chosen is not None:
                return decision
            robot = self.motion.reach(voxel_map, state, around.obstacles, widen=False)
        decision = self._choice.select(situation, robot, self._rng, **ask)
        if decision.chosen is not None and decision.chosen.rating > _POOR:
            return decision
        blocking = [Interest(each, _BLOCKING) for each in robot.unseen_ahead]
        if not blocking:
            return decision
        situation = replace(situation, interests=(*situation.interests, *blocking))
        onward = self._choice.select(situation, robot, self._rng, **ask)
        return onward if onward.chosen is not None else decision

    def _without_unproductive_looks(self, situation: Situation, entropy: float) -> Situation:
        """Note what the views taken since the last choice promised in vain; expect it no more."""
        views = situation.past_views[self._noted :]
        left: list[float] = []
        self._noted = len(situation.past_views)
        for view, gains in zip(views, self._information.gains(situation, views), strict=True):
            is_taken = len(left) < len(views) - self._wanted
            promised = gains.gains[~self._unproductive.are_given_up(gains.keys)]
            left.append(float(promised.sum()) if is_taken else float("nan"))
            self._unproductive.note(
                gains.keys, situation.voxel_map, view[:3, 3], situation.max_range
            )
        self._kept.note(left, entropy)
        promising = self._unproductive.without_them(situation.voxel_map)
        return replace(situation, promising=promising, kept_shares=np.array(self._kept.shares))

    def route_to(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        place: KnownPlace,
        obstacles: Sequence[Obstacle] = (),
    ) -> Choice:
        """The route to where the robot has stood, or why there is none."""
        result = self.motion.route_to(voxel_map, state, place, obstacles)
        pose = None if result.route is None else result.route.T_map_camera
        return Choice(self._progress(voxel_map, state), pose, result.route, result.reason)

    def plan_arm(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        T_map_camera: FloatArray,
        obstacles: Sequence[Obstacle] = (),
    ) -> Choice:
        """The rest of the route to a view, or as near as can be, from where the base stands."""
        result = self.motion.plan_arm(voxel_map, state, T_map_camera, obstacles)
        pose = None if result.route is None else result.route.T_map_camera
        progress = self._measured or self._progress(voxel_map, state)
        return Choice(progress, pose, result.route, result.reason)

    def failed(self, view: FailedView) -> None:
        """Note that a view failed; it is not chosen until the map changes there.

        Where the robot looked from there or nearby, it counts as a look at what the view was to
        show, as one into the sky, in which nothing tells where the camera is.
        """
        self._failures.append(view)
        self._goal = None

    def is_done(self, progress: MapProgress) -> bool:
        """Whether the task is met."""
        return self._task.is_met(progress)

    def withdraw(self) -> None:
        """Note that what was chosen last is not carried out."""
        self.motion.withdraw()
        self._goal = None

    def share_left(
        self, voxel_map: VoxelMap, pose: FloatArray, teammates: Sequence[Teammate]
    ) -> float:
        """Share of what a view is expected to tell that teammates leave to it, 0 to 1.

        Args:
            voxel_map: what is known.
            pose: ``T_map_camera``, shape (4, 4).
            teammates: with the views that they are heading for.
        """
        low, high = self._task.region
        task = RegionOfTask(low, high)
        situation = Situation(
            voxel_map, self._rig.left, self.config.max_range, pose, region=task, teammates=teammates
        )
        return self._choice.share_left(situation, pose)

    def _take_note(self, voxel_map: VoxelMap, state: RobotState, around: Surrounding) -> None:
        """Remember where views were taken, and which ones could not be: no look tells of those."""
        if not self._past:
            gaps = np.linalg.norm(around.past_views[:, :3, 3] - state.T_map_camera[:3, 3], axis=1)
            self._past.extend(around.past_views[gaps > _SAME])
        if all(view.reached for view in self._failures) or not self._past:
            self._past.append(state.T_map_camera)
        self.motion.begin(state.T_map_base if around.T_map_start is None else around.T_map_start)
        for view in self._failures:
            self._memory.remember(view.pose, view.reason, voxel_map)
        wanted = [view.pose for view in self._failures if view.reached]
        self._past += wanted
        self._wanted = len(wanted)
        self._failures.clear()

    def _progress(self, voxel_map: VoxelMap, state: RobotState) -> MapProgress:
        task, inside = self._task, state.T_map_camera[:3, 3]
        boxes = (_box_about(each, task.region) for each in self._fine)
        places = [box for box in boxes if (box[1] > box[0]).all()]
        self._measured = measure_progress(
            voxel_map, task.region, inside, task.surface_sigma, places, task.precise_sigma
        )
        return self._measured

    def _situation(
        self, voxel_map: VoxelMap, state: RobotState, reach: WholeBodyReach, around: Surrounding
    ) -> Situation:
        low, high = self._task.region
        return Situation(
            voxel_map,
            self._rig.left,
            self.config.max_range,
            state.T_map_camera,
            state.pose_covariance,
            RegionOfTask(low, high),
            around.interests,
            around.teammates,
            past_views=np.array(self._past),
            free_body=self._body(state),
            clear_space=self.motion.clear_space,
            arm_views=self._arm_views(state),
            heights=self._heights,
            elevations=self._elevations,
            ground_height=reach.terrain.height_at,
            times=self.motion.times(state),
        )

    def _body(self, state: RobotState) -> list[PlacedSolid]:
        """The robot's solids in the map."""
        solids = self.robot.solids_in(self.robot.base_frame, state.joints)
        return [
            PlacedSolid(each.solid, state.T_map_base @ each.transform, each.name) for each in solids
        ]

    def _arm_views(self, state: RobotState) -> FloatArray:
        """Camera poses of random postures of the arm, shape (A, 4, 4)."""
        postures = self.motion.whole(state).postures.q
        count = min(self.config.arm_views, len(postures))
        chosen = self._rng.choice(len(postures), count, replace=False)
        return np.asarray(state.T_map_base @ self.robot.arm.camera_pose(postures[chosen]))


def _box_about(interest: Interest, region: FloatArray) -> FloatArray:
    """What of a region is about a place of interest, (low, high), shape (2, 3) [m]."""
    low, high = solid_extent(interest.place)
    return np.array([np.maximum(low, region[0]), np.minimum(high, region[1])])


def _choice_of(
    decision: ViewDecision,
    route: Route | None,
    progress: MapProgress,
    state: RobotState,
    stands_wrongly: str,
) -> Choice:
    chosen = decision.chosen
    if chosen is not None and route is None:
        raise TypeError("a view was chosen without a route")
    pose = None if chosen is None else chosen.pose
    reason = decision.reason
    if route is not None and route.moves_base and stands_wrongly:
        reason += f"; it first drives out, as the base stands {stands_wrongly}"
    return Choice(progress, pose, route, reason, explain(replace(decision, reason=reason), state))


_LISTED = 300


def explain(decision: ViewDecision, state: RobotState) -> dict[str, Any]:
    """A decision as the run log has it; the best candidates and some of each kind rejected."""
    chosen = decision.chosen
    return {
        "pose": None if chosen is None else chosen.pose.ravel(),
        "base": planar_pose(state.T_map_base),
        "position_sigma": float(np.sqrt(np.trace(state.pose_covariance[:3, :3]))),
        "strategy": decision.strategy,
        "rating": None if chosen is None else chosen.rating,
        "terms": {} if chosen is None else chosen.terms,
        "reason": decision.reason,
        "considered": len(decision.candidates),
        "seconds": decision.seconds,
        "rejections": dict(decision.rejections()),
        "candidates": [_listed(view) for view in _worth_listing(decision.candidates)],
    }


def _worth_listing(views: Sequence[RatedView]) -> list[RatedView]:
    """The best rated views; of the others every so many."""
    rated = sorted(
        (view for view in views if np.isfinite(view.rating)), key=lambda view: -view.rating
    )
    rest = [view for view in views if not np.isfinite(view.rating)]
    best = rated[: _LISTED // 2]
    others = [*rated[_LISTED // 2 :], *rest]
    step = max(1, -(-len(others) // (_LISTED // 2)))
    return [*best, *others[::step]]


def _listed(view: RatedView) -> dict[str, Any]:
    return {
        "position": view.pose[:3, 3],
        "direction": view.pose[:3, 2],
        "rating": view.rating,
        "terms": view.terms,
        "rejection": view.rejection,
    }
