"""What the dynamics of a robot need to know and only its compiled model tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from xml.etree import ElementTree

import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.body import CollisionConfig, configurations
from infomap_ros.motion.collision.pair_study import TrueShapes, movable_pairs
from infomap_ros.motion.robot.robot_model import LinkTree, RobotModel
from infomap_ros.motion.robot.urdf import read_followers
from infomap_ros.simulation.body.robot import load_robot
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP

import mujoco  # isort: skip  # after the backend has been chosen

_POSES = 40  # random configurations, to see how far inertia varies
_POSTURES = 100  # random ones of the arm, to see which links only seem to meet
_FEW = 2  # of them: as many may be
_LOCKED_RANGE = 1e-6  # [rad or m]


@dataclass(frozen=True, eq=False)
class Wheel:
    """A driven wheel as a cylinder.

    Attributes:
        joint: its joint.
        body: its link.
        radius: [m].
        width: [m].
        center: of the cylinder in the link's frame, shape (3,) [m].
        axis: of the joint in the link's frame, shape (3,).
        place: of the center in the base frame, shape (3,) [m].
    """

    joint: str
    body: str
    radius: float
    width: float
    center: FloatArray
    axis: FloatArray
    place: FloatArray


@dataclass(frozen=True, eq=False)
class TrialModel:
    """A robot measured alone, at its home configuration.

    Attributes:
        mass: of the whole robot [kg].
        center_of_mass: in the base frame, shape (3,) [m].
        wheels: the driven wheels.
        home: start position of every servo joint [rad or m].
        inertia: largest inertia that each servo joint moves [kg m^2 or kg].
        locked: joints whose limits leave them no travel.
        touching: pairs of links that do not collide: they are joined, or their solids overlap
            at home or at rest.
    """

    mass: float
    center_of_mass: FloatArray
    wheels: tuple[Wheel, ...]
    home: dict[str, float]
    inertia: dict[str, float]
    locked: tuple[str, ...]
    touching: tuple[tuple[str, str], ...]


def measure_robot(description: str, setup: RobotSetupConfig) -> TrialModel:
    """Compile a robot alone and measure it.

    Args:
        description: URDF text.
        setup: names of its parts.

    Raises:
        RobotModelError: MuJoCo refuses the description, or a joint or link of the setup is
            missing.
    """
    try:
        model = load_robot(description).compile()
    except ValueError as error:
        raise RobotModelError(f"robot description: {error}") from error
    names = [model.joint(index).name for index in range(model.njnt)]
    links = [model.body(index).name for index in range(model.nbody)]
    _require("joint", (*setup.wheels, *setup.arm_joints, *setup.held_positions), names)
    _require("link", (setup.base_frame, *setup.casters, *setup.hovering), links)
    fixed = _without_range(description)
    locked = tuple(name for name in names if name in fixed)
    servos = [n for n in names if n not in setup.wheels and n not in locked]
    home = _home(model, servos, setup, description)
    data = mujoco.MjData(model)
    for name, position in home.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    mujoco.mj_forward(model, data)
    base = data.body(setup.base_frame)
    rotation = np.array(base.xmat).reshape(3, 3)
    return TrialModel(
        float(model.body_mass.sum()),
        rotation.T @ (data.subtree_com[0] - base.xpos),
        tuple(_wheel(model, data, name, setup.base_frame) for name in setup.wheels),
        home,
        _inertia(model, servos),
        locked,
        _touching(model, home) + _joined(description, setup, home),
    )


def _require(kind: str, wanted: tuple[str, ...], known: list[str]) -> None:
    missing = [name for name in wanted if name not in known]
    if missing:
        raise RobotModelError(f"the robot has no moving {kind} {', '.join(missing)}")


def _without_range(description: str) -> set[str]:
    """Joints whose limits leave them no travel."""
    found = set()
    for joint in ElementTree.fromstring(description).findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") in ("revolute", "prismatic") and limit is not None:
            low, high = (float(limit.get(end, "0")) for end in ("lower", "upper"))
            if high - low < _LOCKED_RANGE:
                found.add(joint.get("name", ""))
    return found


def _home(
    model: mujoco.MjModel, servos: list[str], setup: RobotSetupConfig, description: str
) -> dict[str, float]:
    """Start positions; joints that follow another are where it has them."""
    wanted = setup.held_positions | dict(zip(setup.arm_joints, setup.home, strict=True))
    followers = read_followers(ElementTree.fromstring(description), setup.leaders)
    home = {name: _clipped(model, name, wanted.get(name, 0.0)) for name in servos}
    for name, follower in followers.items():
        if name in home and name not in wanted and follower.leader in wanted:
            position = follower.factor * home[follower.leader] + follower.offset
            home[name] = _clipped(model, name, position)
    return home


def _clipped(model: mujoco.MjModel, name: str, position: float) -> float:
    """A position within the limits of a joint."""
    joint = model.joint(name)
    low, high = joint.range if model.jnt_limited[joint.id] else (-np.inf, np.inf)
    return float(np.clip(position, low, high))


def _inertia(model: mujoco.MjModel, servos: list[str]) -> dict[str, float]:
    """Largest diagonal element of the mass matrix over random configurations."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    low = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
    high = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
    matrix = np.zeros((model.nv, model.nv))
    largest = np.zeros(model.nv)
    for _ in range(_POSES):
        data.qpos[model.jnt_qposadr] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        largest = np.maximum(largest, np.diag(matrix))
    return {name: float(largest[model.joint(name).dofadr[0]]) for name in servos}


def _wheel(model: mujoco.MjModel, data: mujoco.MjData, name: str, base_frame: str) -> Wheel:
    """Cylinder about the joint axis that holds the wheel's collision solids."""
    joint = model.joint(name)
    body = model.body(int(joint.bodyid[0]))
    axis = np.array(joint.axis)
    points = [
        _outline(model, geom)
        for geom in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0]))
        if model.geom_group[geom] == COLLISION_GROUP
    ]
    if not points:
        raise RobotModelError(f"the wheel of joint '{name}' has no collision solid")
    local = np.concatenate(points) - joint.pos
    along = local @ axis
    across = local @ np.linalg.svd(axis[None])[2][1:].T  # two directions across the axis
    radius = float(0.5 * np.ptp(across, axis=0).max())  # some are drawn as the box about them
    center = np.asarray(joint.pos + 0.5 * (along.min() + along.max()) * axis)
    base, link = data.body(base_frame), data.body(body.name)
    world = link.xpos + np.array(link.xmat).reshape(3, 3) @ center
    place = np.array(base.xmat).reshape(3, 3).T @ (world - base.xpos)
    return Wheel(name, body.name, radius, float(np.ptp(along)), center, axis, place)


def _outline(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Points on the outline of a geom in its body's frame, shape (N, 3)."""
    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(64)])
    if kind == int(mujoco.mjtGeom.mjGEOM_MESH):
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        points = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
    elif kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        points = np.concatenate([ring * size[0] + (0, 0, z) for z in (-size[1], size[1])])
    else:  # sphere, capsule, box: the sphere or box about it
        points = np.concatenate([ring * size[0], ring[:, [0, 2, 1]] * size[0]])
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return np.asarray(points @ rotation.reshape(3, 3).T + model.geom_pos[geom])


def _touching(model: mujoco.MjModel, home: dict[str, float]) -> tuple[tuple[str, str], ...]:
    """Pairs of links whose solids overlap at home, or where all joints rest as near zero as can."""
    data = mujoco.MjData(model)
    pairs = set()
    for wanted in (home, dict.fromkeys(home, 0.0)):
        for name, position in wanted.items():
            index = model.joint(name).id
            low, high = model.jnt_range[index] if model.jnt_limited[index] else (-np.inf, np.inf)
            data.qpos[model.jnt_qposadr[index]] = np.clip(position, low, high)
        mujoco.mj_forward(model, data)
        for first, second in data.contact.geom[: data.ncon]:
            bodies = sorted(model.body(int(model.geom_bodyid[g])).name for g in (first, second))
            pairs.add((bodies[0], bodies[1]))
    return tuple(sorted(pairs))


def _joined(
    description: str, setup: RobotSetupConfig, home: dict[str, float]
) -> tuple[tuple[str, str], ...]:
    """Pairs of links that the collision checks of planning take to be joined, as they do.

    And those whose convex hulls, which are what MuJoCo lets collide, often meet where the links
    themselves do not: a forearm that folds into the hollow of an upper arm would jam there. And
    those whose meshes meet in most postures, which are too coarse to tell a touch.
    """
    robot = RobotModel.from_urdf(
        description, setup.left_camera_frame, setup.base_frame, mimics=setup.leaders
    )
    links = robot.links_with_solids
    positions = {joint.name: home.get(joint.name, 0.0) for joint in robot.joints}
    tree = LinkTree.of(robot, positions)
    movable = {(int(i), int(j)) for i, j in movable_pairs(robot, tree)}
    colliding = movable - set(_seem_to_meet(robot, tree, sorted(movable)))
    pairs = combinations(range(len(links)), 2)
    return tuple((links[i], links[j]) for i, j in pairs if (i, j) not in colliding)


def _seem_to_meet(
    robot: RobotModel, tree: LinkTree, pairs: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Pairs of links whose hulls meet in most postures, or in some in which they do not."""
    qs = configurations(robot, _POSTURES)[1:]  # how it rests was looked at
    true, hulls = TrueShapes(robot, tree, qs), TrueShapes(robot, tree, qs, convex=True)
    links = robot.links_with_solids
    hollow = {shape.link for shape in robot.shapes if shape.vertices is not None}
    for first, second in pairs:
        if hollow.isdisjoint((links[first], links[second])):
            continue
        met = [k for k in range(_POSTURES) if hulls.touch(first, second, k)]
        is_usual = len(met) >= CollisionConfig.always_share * _POSTURES
        if is_usual or sum(not true.touch(first, second, k) for k in met) > _FEW:
            yield first, second
