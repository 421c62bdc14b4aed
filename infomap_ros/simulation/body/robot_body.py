"""The moving robot: a compiled world with its state, in the words of the robot description."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import mujoco
import numpy as np

from infomap_ros.errors import RobotModelError, SimulationError
from infomap_ros.geometry import invert_transform, make_transform, quaternion_from_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig, cells, draw_board
from infomap_ros.simulation.body.dynamics import DynamicsConfig, add_dynamics
from infomap_ros.simulation.body.robot import add_robot, attach_robot, load_robot
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.trial import TrialModel, measure_robot
from infomap_ros.simulation.worlds.builder import World, add_cube_material
from infomap_ros.simulation.worlds.textures import Image

# Tags on a simulated robot, by which its teammates find it.
#
# They are seen, and neither touched nor heavy: what they hang on is the robot's description.

_THICKNESS = 0.005  # [m]
_TEXTURE = 256  # [px]
_WHITE = 230  # paper does not reflect all light
_FACE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # of the plate, x out of it


def add_tag_plates(spec: mujoco.MjSpec, link: str, tags: TagBoardConfig) -> None:
    """Hang a plate for each tag on a robot in a world that is being built.

    Args:
        spec: the world.
        link: name of the robot's base in it.
        tags: where they are in the frame of the base (`localization.target.robot_tags.tag_pose`).

    Raises:
        RobotModelError: there is no such link.
    """
    body = spec.body(link)
    if body is None:
        raise RobotModelError(f"there is no link '{link}' for tags")
    board = TagBoard(tags)
    cell = tags.side / cells(tags.family)
    edge = tags.side + 2.0 * cell
    back = make_transform(_FACE, (0.0, 0.0, -0.5 * _THICKNESS))
    for tag, pose in zip(board.ids, board.tag_poses, strict=True):
        name, place = f"{link}/tag_{tag}", pose @ back
        add_cube_material(spec, name, _faces(tags, tag, cell))
        x, y, z, w = quaternion_from_transform(place)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(0.5 * _THICKNESS, 0.5 * edge, 0.5 * edge),
            pos=place[:3, 3],
            quat=(w, x, y, z),
            material=name,
            mass=0.0,
            contype=0,
            conaffinity=0,
        )


def _faces(tags: TagBoardConfig, tag: int, cell: float) -> tuple[Image, ...]:
    """The print on the face +x, with a white rim of one cell; the others are gray."""
    one = TagBoardConfig(
        family=tags.family, side=tags.side, columns=1, rows=1, margin=cell, first_id=tag
    )
    width, _ = TagBoard(one).size
    drawn = cv2.resize(
        draw_board(one, 2.0 * _TEXTURE / width), (_TEXTURE, _TEXTURE), interpolation=cv2.INTER_AREA
    )
    pixels = (drawn.astype(np.float64) * (_WHITE / 255.0)).astype(np.uint8)
    gray = np.full((_TEXTURE, _TEXTURE, 3), 128, np.uint8)
    return (np.rot90(np.repeat(pixels[..., None], 3, axis=-1)), *[gray] * 5)


PREFIX = "robot/"

_DROP = 0.004  # [m] above the ground at the start

_NO_SLIP = 2
"""Iterations that take from contacts what friction would not let slip, while the wheels hold.
Without them the friction of MuJoCo yields: 30 motions of the arm shift a rover that stands in the
cave by 51 mm and 3.5 degrees, with them by 2 mm and 0.1."""
_STAYS = 1e-9  # [rad]

_ROLLING_FRICTION = 0.6  # of rollers on the ground, along their axes
_GRIP = 0.1  # [s] in which rollers bring the base to the velocity of the wheels
_MOST_BEHIND = 0.05  # [m, rad] that a base on rollers still makes up when it is told to stand


class RobotBody:
    """A robot with springs and servos in a copy of a world.

    Holds the state; `advance` is the only thing that changes it over time.

    Args:
        world: where it is put; left alone.
        description: URDF text.
        setup: names of the robot's parts.
        config: parameters of the forces.
        teammates: URDF texts of the other robots in the world, by name.
        tags: that hang on their bases, by name.

    Attributes:
        model: the compiled world with the robot.
        data: its state.
        trial: the robot, measured alone.
        servos: names of the joints with position servos, the order of `targets`.
        teammates: the other robots, by name.

    Raises:
        RobotModelError: the description is malformed or lacks a part.
        SimulationError: MuJoCo refuses the world with the robot.
    """

    def __init__(
        self,
        world: World,
        description: str,
        setup: RobotSetupConfig,
        config: DynamicsConfig,
        teammates: Mapping[str, str] | None = None,
        tags: Mapping[str, TagBoardConfig] | None = None,
    ) -> None:
        others = {f"{name}/": text for name, text in (teammates or {}).items()}
        self.trial: TrialModel = measure_robot(description, setup)
        self.setup, self.config = setup, config
        spec = world.spec.copy()
        material = "paint" if spec.material("paint") else ""
        add_robot(spec, description, PREFIX, material)
        add_dynamics(spec, PREFIX, setup, self.trial, config)
        for prefix, text in others.items():
            add_teammate(spec, text, prefix, material)
        for name, board in (tags or {}).items():
            add_tag_plates(spec, f"{name}/{setup.base_frame}", board)
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise SimulationError(f"MuJoCo refuses the world: {error}") from error
        self.data = mujoco.MjData(self.model)
        self.servos = tuple(self.trial.home)
        self._q, self._v = self._addresses(self.servos)
        self._wheel_q, self._wheel_v = self._addresses(setup.wheels)
        self._servo_inputs = self._inputs(self.servos)
        self._wheel_inputs = self._inputs(setup.wheels)
        self._base_q = int(self.model.joint(f"{PREFIX}base").qposadr[0])
        self._base_v = int(self.model.joint(f"{PREFIX}base").dofadr[0])
        self._base = self._body(setup.base_frame)
        self._wanted, self._behind = np.zeros(3), np.zeros(3)
        self.teammates = {
            prefix[:-1]: TeammateBody(self.model, self.data, text, prefix, setup.base_frame)
            for prefix, text in others.items()
        }
        self._place(world)
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, inertia)
        along = self._base_v + np.array([0, 1, 5])
        self._inertia = inertia[along, along]  # against the wheels: twice [kg], and [kg m^2]
        weight = float(self._inertia[0] * np.linalg.norm(self.model.opt.gravity))
        self._grip = _ROLLING_FRICTION * weight  # [N], of all rollers
        lever = float(np.hypot(*self.trial.wheels[0].place[:2]))  # [m]
        self._most = self._grip * np.array([1.0, 1.0, lever])  # [N, N, Nm]

    def _addresses(self, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        found = [self.model.joint(PREFIX + name) for name in joints]
        return (
            np.array([joint.qposadr[0] for joint in found], dtype=np.intp),
            np.array([joint.dofadr[0] for joint in found], dtype=np.intp),
        )

    def _inputs(self, joints: tuple[str, ...]) -> np.ndarray:
        return np.array([self.model.actuator(PREFIX + name).id for name in joints], dtype=np.intp)

    def _body(self, link: str) -> int:
        try:
            return int(self.model.body(PREFIX + link).id)
        except KeyError as error:
            raise RobotModelError(f"the robot has no frame '{link}'") from error

    def _place(self, world: World) -> None:
        """Put the robot just above the highest ground below its wheels, arm at home."""
        x, y, yaw = world.start
        places = np.array([wheel.place for wheel in self.trial.wheels])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        ground = world.terrain.height(places[:, :2] @ turn.T + (x, y))
        lowest = np.array([wheel.radius for wheel in self.trial.wheels]) - places[:, 2]
        base = self._base_q
        self.data.qpos[base : base + 3] = x, y, float((ground + lowest).max()) + _DROP
        self.data.qpos[base + 3 : base + 7] = np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)
        home = np.array([self.trial.home[name] for name in self.servos])
        self.data.qpos[self._q] = home
        self.data.ctrl[self._servo_inputs] = home
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> dict[str, FloatArray]:
        """Where everything is and what the motors are told: arrays ``positions``, ``targets``."""
        return {"positions": np.array(self.data.qpos), "targets": np.array(self.data.ctrl)}

    def restore(self, state: Mapping[str, FloatArray]) -> None:
        """Stand at rest as `state` says.

        Raises:
            SimulationError: it is the state of another robot or world.
        """
        nothing = np.zeros(0)
        positions, targets = state.get("positions", nothing), state.get("targets", nothing)
        if positions.shape != self.data.qpos.shape or targets.shape != self.data.ctrl.shape:
            raise SimulationError("the saved state is that of another robot or world")
        self.data.qpos[:], self.data.ctrl[:] = positions, targets
        self.data.qvel[:] = 0.0
        self._wanted, self._behind = np.zeros(3), np.zeros(3)
        mujoco.mj_forward(self.model, self.data)

    def advance(self) -> None:
        """Simulate one control period; the weight of the arm is held by its servos."""
        self.data.qfrc_applied[self._v] = self.data.qfrc_bias[self._v]
        if self.setup.rollers:
            self._roll()
        mujoco.mj_step(self.model, self.data, self.config.steps)

    def appearance(self) -> FloatArray:
        """Changes when anything in the world has moved, shape (K,)."""
        others = [mate.placement for mate in self.teammates.values()]
        return np.concatenate([self.data.qpos, *others])

    def command_servos(self, positions: FloatArray) -> None:
        """Set the servos' targets [rad or m], in the order of `servos`."""
        self.data.ctrl[self._servo_inputs] = positions

    def command_wheels(self, angles: FloatArray) -> None:
        """Set the wheels' targets [rad], left wheels first; where they stay, the wheels hold."""
        stay = np.abs(angles - self.data.ctrl[self._wheel_inputs]).max(initial=0.0) < _STAYS
        self.model.opt.noslip_iterations = _NO_SLIP if stay else 0
        self.data.ctrl[self._wheel_inputs] = angles

    def command_rollers(self, speed: float, turn_rate: float) -> None:
        """Set how fast wheels with rollers move the base ahead [m/s] and turn it [rad/s]."""
        wanted = np.array([speed, 0.0, turn_rate])
        if self._wanted.any() and not wanted.any():  # who stops lets go of what is in the way
            self._behind = np.clip(self._behind, -_MOST_BEHIND, _MOST_BEHIND)
        self._wanted = wanted

    def _roll(self) -> None:
        """Push the base as its rollers do together.

        The rollers of four mecanum wheels touch the ground in two directions, so that their forces
        add up to any push along the ground and about the vertical. Their contacts are not simulated
        one by one: the wheels slide, and the base feels the sum, up to what friction allows. With
        less their drag would hold it in slow turns.
        """
        data, base = self.data, self._base_v
        axes = data.xmat[self._base].reshape(3, 3)
        now = np.append(axes[:, :2].T @ data.qvel[base : base + 3], data.qvel[base + 5])
        lag, period = self._wanted - now, self.config.control_period
        most = 4.0 * _GRIP**2 * self._most / self._inertia  # farther behind the wheels slip
        self._behind = np.clip(self._behind + lag * period, -most, most)
        wanted = (lag + self._behind / (4.0 * _GRIP)) / _GRIP  # critically damped
        push = self._inertia * wanted
        push[:2] *= min(1.0, self._grip / max(float(np.hypot(*push[:2])), 1e-9))
        data.qfrc_applied[base : base + 3] = axes[:, :2] @ push[:2]
        data.qfrc_applied[base + 5] = float(np.clip(push[2], -self._most[2], self._most[2]))

    @property
    def targets(self) -> FloatArray:
        """What the servos are told to hold [rad or m], in the order of `servos`."""
        return np.array(self.data.ctrl[self._servo_inputs])

    @property
    def positions(self) -> FloatArray:
        """Positions of the servo joints [rad or m]."""
        return np.array(self.data.qpos[self._q])

    @property
    def wheel_angles(self) -> FloatArray:
        """Angles of the wheels [rad], left wheels first."""
        return np.array(self.data.qpos[self._wheel_q])

    @property
    def base_velocity(self) -> FloatArray:
        """Linear (world frame, [m/s]) and angular (base frame, [rad/s]) velocity, shape (6,)."""
        return np.array(self.data.qvel[self._base_v : self._base_v + 6])

    def joint_positions(self) -> Mapping[str, float]:
        """All joints of the description that can move, by name [rad or m]; locked ones are 0."""
        servos = dict(zip(self.servos, self.positions.tolist(), strict=True))
        wheels = dict(zip(self.setup.wheels, self.wheel_angles.tolist(), strict=True))
        return {**servos, **wheels, **dict.fromkeys(self.trial.locked, 0.0)}

    def joint_speed(self) -> float:
        """Speed of the fastest servo joint or wheel [rad/s or m/s]."""
        return float(np.abs(self.data.qvel[np.concatenate([self._v, self._wheel_v])]).max())

    def base_pose(self) -> FloatArray:
        """``T_world_base``, shape (4, 4)."""
        return self._pose(self._base)

    def frame(self, link: str) -> FloatArray:
        """``T_world_frame`` of a link, shape (4, 4).

        Raises:
            RobotModelError: the robot has no such link.
        """
        return self._pose(self._body(link))

    def _pose(self, body: int) -> FloatArray:
        return make_transform(self.data.xmat[body].reshape(3, 3), self.data.xpos[body])


_NOWHERE = (0.0, 0.0, -1000.0)  # [m] until it is placed


def add_teammate(spec: mujoco.MjSpec, description: str, prefix: str, material: str = "") -> None:
    """Put another robot into a world that is being built, moved by nothing but `TeammateBody`.

    Args:
        spec: the world.
        description: URDF text of the other robot.
        prefix: of its names.
        material: name of a material of `spec` that textures it.

    Raises:
        RobotModelError: MuJoCo cannot read the description.
    """
    robot = load_robot(description)
    for joint in list(robot.joints):
        robot.delete(joint)
    root = attach_robot(spec, robot, prefix, material)
    root.mocap = True
    root.pos = _NOWHERE


class TeammateBody:
    """Places another robot in a compiled world.

    Args:
        model: the world, to which `add_teammate` has added it.
        data: state of the world.
        description: URDF text of the other robot.
        prefix: of its names.
        base_frame: link whose pose is its pose.

    Attributes:
        placement: all that `place` was told, to see whether it has moved, shape (K,).

    Raises:
        RobotModelError: it has no link `base_frame`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        description: str,
        prefix: str,
        base_frame: str,
    ) -> None:
        self._model, self._data = model, data
        self._alone = load_robot(description).compile()
        self._posture = mujoco.MjData(self._alone)
        links = [self._alone.body(index).name for index in range(1, self._alone.nbody)]
        if base_frame not in links:
            raise RobotModelError(f"the robot '{prefix}' has no frame '{base_frame}'")
        self._base = 1 + links.index(base_frame)
        self._bodies = [0] + [int(model.body(prefix + link).id) for link in links]
        self._mocap = int(model.body_mocapid[self._bodies[1]])
        self._joints = {
            self._alone.joint(index).name: int(self._alone.joint(index).qposadr[0])
            for index in range(self._alone.njnt)
        }
        self.placement: FloatArray = np.zeros(0)

    def place(self, T_world_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Put it somewhere, in a posture.

        Args:
            T_world_base: pose of its base, shape (4, 4).
            joints: positions by name [rad or m]; of joints that are not named, the last ones.

        Raises:
            RobotModelError: a joint is unknown.
        """
        for name, position in joints.items():
            if name not in self._joints:
                raise RobotModelError(f"unknown joint: {name}")
            self._posture.qpos[self._joints[name]] = position
        placement = np.concatenate([np.ravel(T_world_base), self._posture.qpos])
        if np.array_equal(placement, self.placement):
            return
        self.placement = placement
        mujoco.mj_kinematics(self._alone, self._posture)
        root = T_world_base @ invert_transform(self._link(self._base)) @ self._link(1)
        x, y, z, w = quaternion_from_transform(root)
        self._data.mocap_pos[self._mocap] = root[:3, 3]
        self._data.mocap_quat[self._mocap] = w, x, y, z
        self._bend()
        mujoco.mj_kinematics(self._model, self._data)

    def _bend(self) -> None:
        """Put every link where it is relative to the one that carries it."""
        inverse, turn = np.zeros(4), np.zeros(4)
        posture = self._posture
        for link in range(2, self._alone.nbody):
            carrier, body = int(self._alone.body_parentid[link]), self._bodies[link]
            offset = posture.xpos[link] - posture.xpos[carrier]
            mujoco.mju_negQuat(inverse, posture.xquat[carrier])
            mujoco.mju_mulQuat(turn, inverse, posture.xquat[link])
            self._model.body_pos[body] = posture.xmat[carrier].reshape(3, 3).T @ offset
            self._model.body_quat[body] = turn

    def _link(self, link: int) -> FloatArray:
        posture = self._posture
        return make_transform(posture.xmat[link].reshape(3, 3), posture.xpos[link])
