"""A robot as spheres on its links, for collision checks; it depends on no map.

A whole link is in its spheres, and they stick out by a bounded length. A sphere about a point at
depth d inside a solid may have the radius d + tolerance, as it then stays within the solid grown by
the tolerance. The solid is cut into cells, small ones near its surface and larger ones in its
depth, so that the sphere about each cell's own center would hold the cell. Of these spheres, and
those of the larger cells that were cut, enough are chosen that each cell is wholly in one, greedily
the sphere that holds most cells not yet held (set cover); each is then shrunk to what it must hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.geometry import PlacedSolid, Solid, Sphere, invert_transform, transform_points
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision import kernels
from infomap_ros.motion.collision.kernels import BodyArrays
from infomap_ros.motion.collision.pair_study import (
    TrueShapes,
    allowed_pairs,
    is_any_of,
    movable_pairs,
    study_pairs,
)
from infomap_ros.motion.robot.body_shapes import BodyShape
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.robot_model import LinkTree, RobotModel
from infomap_ros.motion.robot.solid_extent import solid_extent


@dataclass(frozen=True)
class CollisionConfig:
    """How the body is modeled and what counts as in its way.

    Raises:
        ConfigError: a value is out of its range.
    """

    tolerance: float = setting(
        0.015,
        "How far the spheres that cover the body may stick out of its collision shapes.",
        unit="m",
        low=0.001,
        high=0.5,
    )
    margin: float = parameter(
        0.01,
        "Distance that is kept to everything where the pose is known exactly. A motion is checked "
        "in steps in which no point of the body goes farther than twice this, so that all of it is "
        "known to be free.",
        unit="m",
        low=0.0005,
        high=0.5,
    )
    free_probability: ClassVar[float] = 0.05
    """The arm may enter voxels that are less likely occupied than this: what is free for the choice
    of views, after two looks of the map's default model.
    """
    ground_links: tuple[str, ...] = setting(
        ("*wheel*", "*caster*"),
        "Links (patterns) that stand on the ground: they are not compared with the map, as the "
        "planner of the base answers for where they stand.",
    )
    always_share: ClassVar[float] = 0.5
    """Links whose collision meshes touch in at least this share of random configurations touch by
    design, or their meshes are too coarse to tell, and are not compared.
    """
    alarm_share: ClassVar[float] = 0.3
    """Where the spheres of two links come too near in more than this share of random
    configurations although the links do not touch, their distance is adapted until they mostly do
    not.
    """
    allowed_contacts: tuple[str, ...] = parameter(
        (), "Pairs of links (patterns) that may touch, as 'first:second'."
    )

    def __post_init__(self) -> None:
        check_config(self)
        for pair in self.allowed_contacts:
            if pair.count(":") != 1:
                raise ConfigError("allowed_contacts", pair, "two patterns, as 'first:second'")


_CELLS = 4000
_SAMPLES = 500  # random configurations from which is learnt which links touch
_GROWTH = 1.25
_SHARE = 0.5  # a cell's half diagonal in radii of the sphere about its center
_SLACK = 1e-7  # [m]; for what the extent of a polytope and rounding leave open


def cover_by_spheres(solid: Solid, tolerance: float) -> FloatArray:
    """Spheres whose union holds a solid.

    Args:
        solid: a convex body.
        tolerance: how far the spheres may stick out of the solid [m]. A solid that would need too
            many cells for this is covered with the least larger tolerance that needs fewer.

    Returns:
        Centers in the solid's frame and radii, shape (K, 4) [m].

    Raises:
        InvalidInputError: the tolerance is not positive.
    """
    if not tolerance > 0.0:
        raise InvalidInputError("tolerance", f"is {tolerance}, expected more than 0 m")
    if isinstance(solid, Sphere):
        return np.array([[0.0, 0.0, 0.0, solid.radius]])
    extent = solid_extent(PlacedSolid(solid, np.eye(4)))
    while True:
        cut = _cut(solid, extent, tolerance)
        if cut is not None:
            return np.asarray(_chosen(*cut))
        tolerance *= _GROWTH


def _cut(
    solid: Solid, extent: tuple[FloatArray, FloatArray], tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Cells (center and half diagonal, shape (N, 4)), and centers (M, 3) and radii (M,) of spheres.

    None where there are too many cells.
    """
    low, high = extent
    size = np.maximum(high - low, 1e-3 * tolerance) + _SLACK
    counts = np.maximum(np.round(size / max(size.min(), tolerance)), 1).astype(int)
    axes = [a + w * (np.arange(n) + 0.5) / n for a, w, n in zip(low, size, counts, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    edges, cells, candidates, radii = size / counts, [], [], []
    while len(centers):
        half = 0.5 * float(np.linalg.norm(edges)) + _SLACK
        allowed = tolerance - solid.signed_distance(centers)
        centers, allowed = (
            centers[allowed >= tolerance - half],
            allowed[allowed >= tolerance - half],
        )
        candidates.append(centers[allowed > 0.0])
        radii.append(allowed[allowed > 0.0])
        done = half <= _SHARE * allowed
        cells.append(np.column_stack([centers[done], np.full(np.count_nonzero(done), half)]))
        if sum(map(len, cells)) + np.count_nonzero(~done) > _CELLS:
            return None
        centers, edges = _halved(centers[~done], edges)
    return np.concatenate(cells), np.concatenate(candidates), np.concatenate(radii)


def _halved(centers: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cut boxes in half along their long axes; new centers, shape (N, 3), and edges, (3,)."""
    long = edges > 0.6 * edges.max()
    edges = np.where(long, 0.5 * edges, edges)
    signs = [(-0.5, 0.5) if is_long else (0.0,) for is_long in long]
    offsets = np.array(list(product(*signs))) * edges
    return (centers[:, None] + offsets).reshape(-1, 3), edges


@njit(cache=True, nogil=True)
def _chosen(cells: Any, centers: Any, radii: Any) -> Any:
    """Greedy set cover of the cells, shape (N, 4), by spheres, (M, 3) and (M,); shape (K, 4).

    Of spheres that hold equally many cells, the smallest is taken.
    """
    count, left = len(cells), len(cells)
    held, gains = np.zeros(count, np.bool_), np.zeros(len(radii), np.int64)
    for m in range(len(radii)):
        for n in range(count):
            gains[m] += _radius_to_hold(centers[m], cells[n]) <= radii[m] + _SLACK
    spheres = np.empty((count, 4))
    chosen = 0
    while left > 0:
        best = 0
        for m in range(1, len(radii)):
            if gains[m] > gains[best] or (gains[m] == gains[best] and radii[m] < radii[best]):
                best = m
        spheres[chosen, :3], spheres[chosen, 3] = centers[best], 0.0
        for n in range(count):
            needed = _radius_to_hold(centers[best], cells[n])
            if held[n] or needed > radii[best] + _SLACK:
                continue
            held[n] = True
            left -= 1
            spheres[chosen, 3] = max(spheres[chosen, 3], needed)
            for m in range(len(radii)):
                gains[m] -= _radius_to_hold(centers[m], cells[n]) <= radii[m] + _SLACK
        chosen += 1
    return spheres[:chosen].copy()


@njit(cache=True, nogil=True, inline="always")
def _radius_to_hold(center: Any, cell: Any) -> float:
    x, y, z = center[0] - cell[0], center[1] - cell[1], center[2] - cell[2]
    return math.sqrt(x * x + y * y + z * z) + cell[3]


_REFINEMENTS = 2
_LOST = 0.002  # [m]


@dataclass(frozen=True, eq=False)
class CollisionBody:
    """The spheres of a robot's links and the pairs of links that must not touch.

    Attributes:
        robot: whose body it is.
        chain: the joints that move it, ``robot.arm``.
        config: how it was made.
        links: names of the links with shapes.
        tree: kinematics.
        arrays: for kernels.
        gaps: distance below which the links of each pair count as touching, shape (P,) [m];
            negative where their spheres overlap without harm.
        moving_links: numbers of the links that the arm moves and the map may block.
    """

    robot: RobotModel
    chain: KinematicChain
    config: CollisionConfig
    links: tuple[str, ...]
    tree: LinkTree
    arrays: BodyArrays
    gaps: FloatArray
    moving_links: NDArray[np.int64]

    @classmethod
    def from_robot(
        cls,
        robot: RobotModel,
        config: CollisionConfig | None = None,
        joint_positions: Mapping[str, float] | None = None,
    ) -> CollisionBody:
        """Cover a robot's links by spheres.

        Links never compared with each other: those that do not move against each other, those
        joined by a joint, those that `allowed_contacts` names, and those that touch with all joints
        at rest or in nearly all configurations. Where spheres come too near to each other too often
        although the links do not touch, the pair's gap is adapted, and if that does not help the
        spheres are made finer (see `pair_study`).

        Args:
            robot: with a camera frame.
            config: how.
            joint_positions: of the other joints [rad or m]; at rest where not given.

        Raises:
            RobotModelError: the robot has no camera frame, its arm moves its own base, or the mesh
                of a link is missing.
        """
        if robot.missing:
            raise RobotModelError(f"no motion can be planned without {'; '.join(robot.missing)}")
        settings, robot = config or CollisionConfig(), robot.holding(joint_positions or {})
        tree, links = LinkTree.of(robot, joint_positions), robot.links_with_solids
        pairs = movable_pairs(robot, tree)
        pairs = pairs[~allowed_pairs(links, pairs, settings.allowed_contacts)]
        qs = configurations(robot, _SAMPLES)
        shapes = TrueShapes(robot, tree, qs)
        tolerances = np.full(len(links), settings.tolerance)
        covers: dict[tuple[str, float], FloatArray] = {}
        for _ in range(_REFINEMENTS + 1):
            arrays = _body_arrays(robot, tree, tolerances, pairs, covers)
            gaps = _wanted_gaps(arrays, settings.margin)
            shares = settings.always_share, settings.alarm_share
            study = study_pairs(shapes, tree, arrays, qs, gaps, *shares)
            noisy = study.compared & (study.false_alarms > settings.alarm_share)
            if not noisy.any():
                break
            tolerances[np.unique(pairs[noisy])] *= 0.5
        arrays = arrays._replace(pairs=np.ascontiguousarray(pairs[study.compared]))
        ground = np.array([is_any_of(link, settings.ground_links) for link in links], dtype=bool)
        moving = np.flatnonzero((arrays.bodies > 0) & ~ground)
        gaps = study.gaps[study.compared]
        return cls(robot, robot.arm, settings, links, tree, arrays, gaps, moving)

    @cached_property
    def foot(self) -> NDArray[np.bool_]:
        """Which links the first joint of the arm carries and turns in place, shape (links,)."""
        prismatic, parents = self.tree.arrays.prismatic, self.tree.arrays.parents
        turning = np.flatnonzero((parents == 0) & ~prismatic.astype(bool)) + 1
        return np.isin(self.arrays.bodies, turning)

    @cached_property
    def protrusions(self) -> dict[str, float]:
        """How far the spheres of each link stick out of its shapes [m].

        More than the tolerance where a link is large: see `cover_by_spheres`.
        """
        found = {}
        for row, link in enumerate(self.links):
            cover = self.arrays.spheres[self.arrays.starts[row] : self.arrays.starts[row + 1]]
            gaps = [
                shape.solid.signed_distance(
                    transform_points(
                        invert_transform(self.tree.placements[shape.joint] @ shape.placement),
                        cover[:, :3],
                    )
                )
                for shape in _shapes(self.robot, link)
            ]
            found[link] = float((np.min(gaps, axis=0) + cover[:, 3]).max())
        return found

    @cached_property
    def kept(self) -> FloatArray:
        """Part of each pair's gap that may be lost between two checks of a segment, shape (P,) [m].

        All of the margin, but little where the gap was adapted to what the true shapes allow.
        """
        wanted = _wanted_gaps(self.arrays, self.config.margin)
        return np.where(self.gaps < wanted, np.minimum(wanted, _LOST), wanted)

    @cached_property
    def pair_reach(self) -> FloatArray:
        """Bound of the motion of any point of one link of a pair against the other.

        Per unit of each of the arm's positions, shape (P, n) [m/rad or 1]; joints that move both
        links alike do not count.
        """
        arrays, tree = self.arrays, self.tree
        reach = np.zeros((len(arrays.pairs), len(self.chain)))
        for row, (a, b) in enumerate(arrays.pairs):
            up, down = (set(tree.bodies_up_from(int(arrays.bodies[link]))) for link in (a, b))
            columns = np.unique(tree.arrays.columns[[body - 1 for body in up ^ down]])
            reach[row, columns] = arrays.reach[a, columns] + arrays.reach[b, columns]
        return reach

    def scratch(self) -> FloatArray:
        """Room for the poses of all bodies, as the kernels need it."""
        return np.empty((len(self.tree.arrays.parents) + 1, 3, 4))

    def spheres(self, q: FloatArray, T_map_base: FloatArray) -> FloatArray:
        """Centers in the map and radii of all spheres, shape (S, 4) [m].

        Args:
            q: positions of the arm, shape (n,).
            T_map_base: shape (4, 4).
        """
        placed = np.empty_like(self.arrays.spheres)
        base = np.ascontiguousarray(T_map_base[:3])
        kernels.place_spheres(self.tree.arrays, self.arrays, q, base, placed)
        return placed


def _wanted_gaps(arrays: BodyArrays, margin: float) -> FloatArray:
    """Distance that the links of each pair keep, shape (P,) [m]: the margin for each that moves."""
    return margin * (arrays.bodies > 0)[arrays.pairs].sum(axis=1).astype(np.float64)


def configurations(robot: RobotModel, count: int) -> FloatArray:
    """The one at rest, then random ones within the limits; always the same."""
    chain = robot.arm
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    rest = [robot.joint(name).rest for name in chain.joint_names]
    return np.vstack([rest, np.random.default_rng(0).uniform(low, high, (count, len(chain)))])


def _body_arrays(
    robot: RobotModel,
    tree: LinkTree,
    tolerances: FloatArray,
    pairs: NDArray[np.int64],
    known: dict[tuple[str, float], FloatArray],
) -> BodyArrays:
    """Arrays of all links, each with its tolerance [m]; known covers are not made again."""
    links = robot.links_with_solids
    wanted = list(zip(links, tolerances.tolist(), strict=True))
    for link, tolerance in wanted:
        if (link, tolerance) not in known:
            known[link, tolerance] = _link_cover(robot, tree, link, tolerance)
    covers = [known[item] for item in wanted]
    bodies = np.array([tree.bodies[_shapes(robot, link)[0].joint] for link in links])
    balls = np.array([_ball(cover) for cover in covers]).reshape(-1, 4)
    return BodyArrays(
        bodies=bodies.astype(np.int64),
        balls=balls,
        starts=np.cumsum([0, *(len(cover) for cover in covers)]),
        spheres=np.concatenate([np.zeros((0, 4)), *covers]),
        pairs=np.ascontiguousarray(pairs),
        reach=np.array([_reach(robot, tree, *item) for item in zip(bodies, covers, strict=True)]),
    )


def _shapes(robot: RobotModel, link: str) -> list[BodyShape]:
    return [shape for shape in robot.shapes if shape.link == link]


def _link_cover(robot: RobotModel, tree: LinkTree, link: str, tolerance: float) -> FloatArray:
    """Spheres of all shapes of a link, in the frame of its body."""
    covers = []
    for shape in _shapes(robot, link):
        cover = cover_by_spheres(shape.solid, tolerance)
        T_body_solid = tree.placements[shape.joint] @ shape.placement
        cover[:, :3] = cover[:, :3] @ T_body_solid[:3, :3].T + T_body_solid[:3, 3]
        covers.append(cover)
    return np.concatenate(covers)


def _ball(cover: FloatArray) -> FloatArray:
    """A sphere that holds spheres, shape (K, 4): about the middle of their extent."""
    low, high = (cover[:, :3] - cover[:, 3:]).min(axis=0), (cover[:, :3] + cover[:, 3:]).max(axis=0)
    middle = 0.5 * (low + high)
    radius = (np.linalg.norm(cover[:, :3] - middle, axis=1) + cover[:, 3]).max()
    return np.array([*middle, radius])


def _reach(robot: RobotModel, tree: LinkTree, body: int, cover: FloatArray) -> FloatArray:
    """Bound of the motion of any point of a link, per unit of each position, shape (n,)."""
    chain, arrays = robot.arm, tree.arrays
    reach = np.zeros(len(chain))
    off_axis = float((np.linalg.norm(cover[:, :2], axis=1) + cover[:, 3]).max())
    radius = float((np.linalg.norm(cover[:, :3], axis=1) + cover[:, 3]).max())
    for number, joint in enumerate(b - 1 for b in tree.bodies_up_from(int(body))):
        column, scale = int(arrays.columns[joint]), abs(float(arrays.scales[joint]))
        if arrays.prismatic[joint]:
            reach[column] += scale
            ends = np.array([chain.lower[column], chain.upper[column]]) * arrays.scales[joint]
            radius += float(np.abs(ends + arrays.offsets[joint]).max())
        else:
            reach[column] += scale * (radius if number else off_axis)
        radius += float(np.linalg.norm(arrays.placements[joint][:, 3]))
    return reach
