"""Can the camera get to a view, and how: arm alone, or base and arm.

Where the arm alone can reach, the base stays. Else places for the base are derived from postures of
the arm (`arm_postures`), those where the robot stands safely and can unfold are given to the
planner of the base, and the arm is folded for the drive. Where no path leads all the way, the
farthest safe approach is offered (Sujan and Dubowsky 2005, Fig. 7).

Where a vehicle can stand, as a grid for planners that move a point, and what it has to see.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from infomap_ros.geometry import (
    Box,
    PinholeCamera,
    PlacedSolid,
    check_transform,
    float_array,
    make_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import FREE, OCCUPIED, UNKNOWN, ProjectedGrid
from infomap_ros.mapping.terrain.terrain import Terrain, terrain_of
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik_batch
from infomap_ros.motion.base import stance
from infomap_ros.motion.base.base_planner import BasePlanner, LeavingPlanner, why_confined
from infomap_ros.motion.base.drive_space import BasePath
from infomap_ros.motion.base.standing_ground import ClearStart, with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.collision.checker import NearSpace
from infomap_ros.motion.keep_out import KeepOut, Obstacle, with_closed_ground, with_obstacles
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ReachResult, Route
from infomap_ros.motion.route_planner import ArmTrail, RoutePlanner
from infomap_ros.motion.stances import StanceFinder, Stances
from infomap_ros.motion.whole_body import ReachingConfig, WholeBody, widenings_for

_HEADINGS = np.arange(8) * (np.pi / 4.0)  # [rad]
_AHEAD = 1.5  # [m] from where the base can go, in which what was never seen matters
_TILE = 0.5  # [m]; edge of the boxes about what was never seen
_NOT_KNOWN = (stance.OUTSIDE, stance.UNKNOWN_WHEEL, stance.UNKNOWN_BODY, stance.UNSEEN)


def traversability(terrain: Terrain, vehicle: Vehicle) -> ProjectedGrid:
    """Whether a vehicle can stand with its base at each cell's middle.

    Steps, slope, roughness, tipping over, ground clearance and what the body would touch count, as
    where the base is planned (Fig. 3 of Sujan and Dubowsky 2005). A cell's value is the share of
    eight headings in which it cannot stand, of those of which that is known, in percent; UNKNOWN
    where it is of none. The vehicle's extent is in the cells already.

    Args:
        terrain: the ground.
        vehicle: what drives.
    """
    cells = np.argwhere(np.isfinite(terrain.heights))
    grid = np.full(terrain.heights.shape, UNKNOWN, np.int8)
    if len(cells):
        places = np.empty((len(cells), len(_HEADINGS), 3))
        places[:, :, :2] = terrain.centers_of(cells)[:, None]
        places[:, :, 2] = _HEADINGS
        outcomes = vehicle.stances(terrain, places.reshape(-1, 3)).outcomes
        grid[cells[:, 0], cells[:, 1]] = _values(outcomes.reshape(len(cells), -1))
    return ProjectedGrid(np.ascontiguousarray(grid.T), terrain.origin, terrain.resolution)


def unseen_above(terrain: Terrain, area: NDArray[np.bool_], height: float) -> list[PlacedSolid]:
    """Space near by that only has to be seen for a vehicle to drive there: boxes about it [map].

    Over ground that is known, between the height up to which the space above it was seen and that
    of the vehicle, where nothing is known to hang so low.

    Args:
        terrain: the ground.
        area: where the base can go, on the terrain's cells.
        height: of the vehicle [m].
    """
    top = terrain.heights + height
    unseen = (terrain.seen < top) & (terrain.overhead > top)  # False where no ground is known
    if not (unseen.any() and area.any()):
        return []
    unseen &= distance_transform_edt(~area) * terrain.resolution < _AHEAD
    cells = np.argwhere(unseen)
    places, rows = terrain.centers_of(cells), tuple(cells.T)
    low, high = np.maximum(terrain.seen[rows], terrain.heights[rows]), top[rows]
    tiles, owners = np.unique(np.floor(places / _TILE), axis=0, return_inverse=True)
    return [
        _box((tile + 0.5) * _TILE, float(low[of].min()), float(high[of].max()))
        for number, tile in enumerate(tiles)
        for of in [owners.ravel() == number]
    ]


def _box(middle: FloatArray, low: float, high: float) -> PlacedSolid:
    """An upright box about a place, shape (2,), between two heights [m]."""
    center = make_transform(np.eye(3), (*middle, 0.5 * (low + high)))
    return PlacedSolid(Box((_TILE, _TILE, high - low)), center, "never seen")


def _values(outcomes: NDArray[np.int64]) -> NDArray[np.int8]:
    """Values of cells, shape (K,), of the outcomes in all headings, shape (K, H)."""
    known = (~np.isin(outcomes, _NOT_KNOWN)).sum(axis=1)
    refused = known - (outcomes == stance.STANDS).sum(axis=1)
    share = np.round((OCCUPIED - FREE) * refused / np.maximum(known, 1)) + FREE
    return np.where(known > 0, share, UNKNOWN).astype(np.int8)


_NO_PLACE = "no place to stand from which the arm reaches it"
_UNEVEN = (-0.2, -0.1, 0.0, 0.1, 0.2)  # [m]; heights of the ground against the nearest

__all__ = ["ReachingConfig", "WholeBodyReach"]


class WholeBodyReach:
    """Answers for one state of map and robot; it answers the question of `views.decision`.

    Args:
        robot: with its camera frame; what must be found out about its body is kept for next time.
        voxel_map: what is known; must not change while this is used.
        T_map_base: where the base is, shape (4, 4).
        joints: where the joints are, by name [rad or m].
        config: None for the defaults.
        start: the declared space in which the robot was started.
        previous: the instance before: where the arm has been since the base stands is taken over.
        sent: the route along which the robot was sent since then.
        obstacles: what must not be touched and the map does not show, such as other robots.
        sigma: of where the base is, from `infomap_ros.motion.whole_body`; what drives and
            the arm are taken for wider accordingly [m].
        keep_out: where the base must not go. Where it stands there already, its paths begin with
            the shortest one out (`infomap_ros.motion.base.base_planner`).
        camera: in whose image the robot itself must not cover much; None where that is no matter.

    Attributes:
        near: the map as its collision checks see it.

    Raises:
        RobotModelError: a joint of the arm is missing, or the robot has no camera frame or wheels.
    """

    def __init__(
        self,
        robot: RobotModel,
        voxel_map: VoxelMap,
        T_map_base: ArrayLike,
        joints: Mapping[str, float],
        config: ReachingConfig | None = None,
        start: ClearStart | None = None,
        previous: WholeBodyReach | None = None,
        sent: Route | None = None,
        obstacles: Sequence[Obstacle] = (),
        sigma: float = 0.0,
        keep_out: KeepOut | None = None,
        camera: PinholeCamera | None = None,
    ) -> None:
        self.config, self._sigma = config or ReachingConfig(), sigma
        self._keep_out = keep_out or KeepOut()
        self._map, self._base = voxel_map, check_transform(T_map_base, "T_map_base")
        self._whole = WholeBody.of(robot, self.config, joints, camera)
        chain = self._whole.chain
        self._q = np.clip(chain.positions(joints), chain.lower, chain.upper)  # encoders are noisy
        self.near = NearSpace(
            voxel_map,
            self._whole.body,
            self._base,
            joints,
            self._whole.radius,
            self.config.clear_body,
            () if start is None else (start.space(self._whole.body.robot),),
            self._whole.foot,
            [obstacle.solid for obstacle in obstacles],
            widenings_for(self._whole.body.config, sigma)[0],
        )
        self._start, self._obstacles = start, obstacles
        past = ArmTrail.at(self._base, self._q) if previous is None else previous.trail
        trail = past.after(self._base, self._q, sent)
        self._routes = RoutePlanner(self._whole, self.near, self.config, trail).foldable()
        self._whole = self._routes.whole
        self._ik = IkConfig(self.config.position_tolerance, self.config.direction_tolerance)

    @cached_property
    def planner(self) -> BasePlanner:
        """Plans paths of the base in the driving posture."""
        terrain = terrain_of(self._map, self._base[:3, 3])
        if self._start is not None:
            terrain = self._start.ground(terrain, self._whole.vehicle)
        ground = with_obstacles(terrain, self._obstacles)
        closed = self._keep_out.closed_ground(ground)
        terrain = with_closed_ground(ground, closed)
        vehicle = widest_vehicle(self._whole, self.config, terrain, self._base, self._sigma)
        if not vehicle.closed_at(terrain, *self._xyyaw):
            return BasePlanner(terrain, vehicle, self.config.base, self._base)
        left = [
            each
            for each in closed
            if not vehicle.closed_at(with_closed_ground(ground, [each]), *self._xyyaw)
        ]
        opened = with_closed_ground(ground, left)
        return LeavingPlanner(terrain, opened, vehicle, self.config.base, self._base)

    @property
    def stands_wrongly(self) -> str:
        """Where the base stands although it must not, or empty.

        For the end of a sentence: "in or next to keep-out region 'x'".
        """
        if self._keep_out.is_empty:
            return ""
        return self.planner.vehicle.closed_at(self.terrain, *self._xyyaw)

    @property
    def is_wider(self) -> bool:
        """Whether the robot keeps more room than a sure pose would ask for."""
        return self.planner.vehicle.wider > 0.0 or self.near.wider > 0.0

    @property
    def terrain(self) -> Terrain:
        """The ground, with that on which the robot stands."""
        return self.planner.terrain

    @property
    def unseen_ahead(self) -> list[PlacedSolid]:
        """Space near by that the base could drive through, had it been seen; boxes [map]."""
        body = float(self.planner.vehicle.arrays.columns[:, 3].max())
        area = self.planner.reachable_area(self._xyyaw)
        height = min(body + self._whole.origin_height, self._whole.vehicle.config.seen_height)
        return unseen_above(self.terrain, area, height)

    @property
    def trail(self) -> ArmTrail:
        """Where the arm has been since the base stands where it stands."""
        return self._routes.trail

    def may_reach(self, poses: ArrayLike) -> list[str]:
        """Quick test of many views: what speaks against each, or "".

        Args:
            poses: ``T_map_camera``, shape (M, 4, 4).
        """
        views = float_array(poses, "poses").reshape(-1, 4, 4)
        possible = self._arm_may_reach(views)
        if not possible.all():
            possible[~possible] = self._base_may_reach(views[~possible])
        if possible.all():
            return [""] * len(views)
        stuck = self._why_stuck
        reason = f"the base cannot drive: {stuck}" if stuck else _NO_PLACE
        return [
            "" if ok else self._closed_below(view) + reason
            for ok, view in zip(possible, views, strict=True)
        ]

    def reach(self, T_map_camera: ArrayLike) -> ReachResult:
        """Plan the motion to one view.

        Args:
            T_map_camera: shape (4, 4).

        Returns:
            How the camera gets within the tolerances of the view, or why it does not. Where
            `partial` is set there is both a reason and a route, which brings the base nearer.
        """
        view = check_transform(T_map_camera, "T_map_camera")
        here, why_not = self._routes.arm_to_view(view, self._ik)
        if here is not None:
            return here
        finder = StanceFinder(self._whole, self.planner, self.near, self.config, self._xyyaw)
        stances, reason = finder.find(view)
        if stances is not None:
            return self._with_base(view, stances)
        reason = f"{self._closed_below(view)}{reason}; the arm alone: {why_not}"
        return self._approach(view, finder.preferred_places(view), reason)

    def with_arm_alone(
        self,
        T_map_camera: ArrayLike,
        position_tolerance: float,
        angle_tolerance: float,
        planned: FloatArray | None = None,
    ) -> ReachResult:
        """Plan the motion of the arm that brings the camera to a view, or as near as can be.

        To half of the tolerances, where that can be: the rest is for errors of joints and poses.

        Args:
            T_map_camera: shape (4, 4).
            position_tolerance: how near the camera must come [m].
            angle_tolerance: and its viewing direction, the roll being free [rad].
            planned: posture like which the arm is to be, shape (n,).

        Returns:
            The route, with a reason where it ends beside the tolerances; none if nothing is free.
        """
        view = check_transform(T_map_camera, "T_map_camera")
        half = IkConfig(0.5 * position_tolerance, 0.5 * angle_tolerance)
        there, _ = self._routes.arm_to_view(view, half, planned)
        within = position_tolerance, angle_tolerance
        return there or self._routes.arm_near_view(view, *within, planned)

    def route_to(self, base: ArrayLike, joints: Mapping[str, float]) -> ReachResult:
        """Plan the motion to a place of the base and a posture of the arm.

        Args:
            base: x, y [m] and yaw [rad] in the map, shape (3,).
            joints: positions by name [rad or m], brought within the limits; joints of the arm that
                are missing stay.
        """
        goal, chain = float_array(base, "base"), self._whole.chain
        named = {**chain.by_name(self._q), **joints}
        q = np.clip(chain.positions(named), chain.lower, chain.upper)
        turn = math.remainder(goal[2] - self._xyyaw[2], 2.0 * math.pi)
        if np.hypot(*(goal[:2] - self._xyyaw[:2])) < 0.02 and abs(turn) < 0.05:
            arm = self._routes.arm_from_here(q)
            if not arm.converged:
                return ReachResult(f"arm: {arm.reason}")
            return self._routes.with_arm_alone(arm)
        return self._routes.with_base(self.planner.plan(self._xyyaw, goal), q)

    @cached_property
    def _why_stuck(self) -> str:
        """Why the base can drive nowhere, or empty."""
        return why_confined(self.planner, self._xyyaw)

    @property
    def _xyyaw(self) -> FloatArray:
        pose = self._base
        return np.array([pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0])])

    def _closed_below(self, view: FloatArray) -> str:
        """What closes the ground below a view, for the beginning of a reason."""
        where = self.terrain.closed_at(view[:2, 3])
        return f"the ground below is {where}; " if where else ""

    def _arm_may_reach(self, views: FloatArray) -> np.ndarray:
        """Whether the arm reaches views from where the base is, without a path being asked for."""
        T_base_camera = np.linalg.inv(self._base) @ views
        near = np.linalg.norm(T_base_camera[:, :3, 3], axis=1) <= self._whole.arm_reach
        found = np.zeros(len(views), dtype=bool)
        if near.any():
            batch = solve_ik_batch(
                self._whole.chain, T_base_camera[near], direction_only=True, q_start=self._q,
                config=self._ik,
            )  # fmt: skip
            free = self.near.checker_at(self._base).are_free(batch.q, self._base)
            found[near] = batch.converged & free
        return found

    def _base_may_reach(self, views: FloatArray) -> np.ndarray:
        """Whether ground that can be driven on lies within the arm's reach of views."""
        terrain, postures = self.terrain, self._whole.postures
        area = self.planner.reachable_area(self._xyyaw)
        away = distance_transform_edt(~area) * terrain.resolution
        cells = np.clip(terrain.cells_of(views[:, :3, 3]), 0, np.array(area.shape) - 1)
        beside = np.linalg.norm(terrain.centers_of(cells) - views[:, :2, 3], axis=1)
        grounds = np.where(area, terrain.heights, np.nan)
        steepness = np.arcsin(np.clip(views[:, 2, 2], -1.0, 1.0))
        nearest = distance_transform_edt(~area, return_distances=False, return_indices=True)
        ground = grounds[nearest[0][tuple(cells.T)], nearest[1][tuple(cells.T)]]
        heights = views[:, 2, 3] - ground - self._whole.origin_height
        radii = np.max([postures.radius_for(heights + dz, steepness) for dz in _UNEVEN], axis=0)
        gap = away[tuple(cells.T)] + beside - terrain.resolution
        return np.asarray(
            area.any() & (gap <= radii + self.config.position_tolerance) & (radii > 0.0)
        )

    def _with_base(self, view: FloatArray, stances: Stances) -> ReachResult:
        """Drive to one of the places, or as near as can be."""
        path = self.planner.plan(self._xyyaw, stances.places)
        if path.complete:
            return self._routes.with_base(path, stances.q[path.goal])
        return self._approach(view, stances.places, f"base path: {path.reason}", path)

    def _approach(
        self, view: FloatArray, places: FloatArray, reason: str, path: BasePath | None = None
    ) -> ReachResult:
        """The farthest safe approach to places, with the camera as near to the view as can be."""
        if path is None and len(places):
            path = self.planner.plan(self._xyyaw, places)
        if path is None or len(path.poses) < 2 or not self._comes_nearer(view, path):
            return ReachResult(reason)
        q = self._routes.posture_like(view, path.T_map_base[-1])
        result = self._routes.with_base(path, q)
        if result.route is None:
            return ReachResult(f"{reason}; nor nearer: {result.reason}")
        route = replace(result.route, partial=True)
        return replace(result, reason=reason, partial=True, route=route)

    def _comes_nearer(self, view: FloatArray, path: BasePath) -> bool:
        away = np.linalg.norm(path.poses[[0, -1], :2] - view[:2, 3], axis=1)
        return bool(away[1] < away[0] - self.config.min_approach)


def widest_vehicle(
    whole: WholeBody,
    config: ReachingConfig,
    terrain: Terrain,
    T_map_base: FloatArray,
    sigma: float,
) -> Vehicle:
    """The vehicle to plan with where its position is known within a standard deviation.

    What is nearer to the robot already than the margin cannot be kept farther off: the body is
    taken for as wide as it may be where the robot stands.

    Args:
        whole: the robot.
        config: how it reaches.
        terrain: the ground.
        T_map_base: where the robot stands, shape (4, 4).
        sigma: of its position, from `base_sigma` [m].
    """
    wanted = widenings_for(config.vehicle, sigma)
    if len(wanted) == 1:
        return whole.vehicle
    reach = config.base.standing_reach
    ground = with_standing_ground(terrain, whole.vehicle, T_map_base, reach)
    yaw = math.atan2(T_map_base[1, 0], T_map_base[0, 0])
    place = np.array([*T_map_base[:2, 3], yaw])
    vehicles = (whole.wider_vehicle(by) for by in wanted)
    return next((each for each in vehicles if not each.refusal(ground, place)), whole.vehicle)
