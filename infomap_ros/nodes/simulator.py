"""Node ``simulator``: the hardware's stand-in, a robot in a simulated world.

It publishes what the hardware would and moves on cmd_vel, base_path and arm_trajectory; what is
true and a robot cannot know goes to ground_truth/* alone. Simulation and drawing run in the worker
thread; callbacks only pass commands on. Other robots in the same world have simulators of their
own (`infomap_ros.nodes.simulator`). On a machine that is too slow for the
wanted pace, simulated time passes more slowly, and /clock says so.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import JointState

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.team_alignment import TeamTagsConfig
from infomap_ros.messages import decode_joint_state, decode_pose_with_covariance
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConductor, LockstepConfig
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.simulated.simulator_actions import (
    SimulatorActions,
    SimulatorInputs,
    SimulatorInputsConfig,
)
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorOutputs, SimulatorOutputsConfig
from infomap_ros.simulation.body.robot import find_description, read_description
from infomap_ros.simulation.body.robot_account import RobotAccount
from infomap_ros.simulation.sensor_schedule import TICK, SensorScheduleConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.turns import SharedTime
from infomap_ros.simulation.worlds.scenes import (
    build_scene,
    describe_scene,
    scene_of,
    without_target,
)

# Other robots in the world of the simulated one, each simulated by a node of its own.
#
# Their ground_truth topics say where each truly is, its joints, and what time it is
# there. All simulations of one world keep together in time.

_JOINING = 2.0  # [s] in which others are received before time begins
_PAUSE = 0.002  # [s] between two looks at whether the others have come
# By how much simulated time may be ahead of that of another robot, at least two periods of its
# state [s].
_TIME_WINDOW = 0.1
# A simulator that has sent nothing for so long is not waited for: its robot stays where it stood.
# When it is back, it goes on at the time of the others [s].
_SILENCE = 8.0
_REPEAT = 0.2  # [s] after which the own state is sent again while waiting


@dataclass(frozen=True)
class TeammatesConfig:
    """Other robots in the same world.

    Raises:
        ConfigError: a value is out of its range.
    """

    teammates: tuple[str, ...] = parameter(
        (),
        "Namespaces of the other robots in this world, each with a simulator of its own; the same "
        "world, seed and start_time must be given to all.",
    )
    teammate_ids: tuple[int, ...] = parameter(
        (), "For each teammate its robot_id, by which it carries tags of team_tags; none if empty."
    )

    def __post_init__(self) -> None:
        check_config(self)
        names = [name.strip("/") for name in self.teammates]
        if len(set(names)) < len(names) or not all(names):
            raise ConfigError("teammates", self.teammates, "different namespaces")
        if len(self.teammate_ids) not in (0, len(names)):
            raise ConfigError(
                "teammate_ids", self.teammate_ids, f"one for each of {names}, or none"
            )

    def boards(self, tags: TeamTagsConfig) -> dict[str, TagBoardConfig]:
        """The tags that teammates carry, by their names."""
        carried = {one.robot: one.tags.board for one in tags.carried()}
        pairs = zip(teammate_names(self), map(str, self.teammate_ids), strict=False)
        return {name: carried[robot] for name, robot in pairs if robot in carried}


class SimulatorTeammates:
    """Puts teammates where they are, and keeps time with them.

    Callbacks queue; the thread that simulates does the rest.

    Args:
        node: that listens.
        simulator: in whose world they are; was made with their `names`.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator) -> None:
        config = node.config(TeammatesConfig)
        self._node, self._simulator = node, simulator
        self._time = SharedTime(_TIME_WINDOW, _SILENCE)
        self._received: queue.SimpleQueue[tuple[str, Callable[[], None]]] = queue.SimpleQueue()
        self._poses: dict[str, FloatArray] = {}
        self._joints: dict[str, dict[str, float]] = {}
        self._names = teammate_names(config)
        self._announced = 0.0
        for name in self._names:
            for kind, topic, receive in (
                (PoseWithCovarianceStamped, "base_pose", self._on_pose),
                (JointState, "joint_states", self._on_joints),
            ):
                topic = f"/{name}/ground_truth/{topic}"
                handle = partial(self._queue, topic, partial(receive, name))
                node.listen(kind, topic, handle, qos.stream(), required=False)

    def join(self, publish: Callable[[], None]) -> None:
        """Begin at the time of the others, as far as they are there.

        Args:
            publish: sends the own state.
        """
        end = time.monotonic() + _JOINING
        while self._names and time.monotonic() < end:
            publish()
            time.sleep(0.05)
            self.update()
            if self._time.running(time.monotonic()).keys() >= set(self._names):
                break

    def update(self) -> None:
        """Put teammates where they last were; skip time that was missed."""
        while not self._received.empty():
            topic, take = self._received.get()
            self._node.guard(topic, take)
        for name in self._poses.keys() & self._joints.keys():
            place = partial(
                self._simulator.place_teammate, name, self._poses[name], self._joints[name]
            )
            self._node.guard(f"/{name}", place)
        missed = self._time.missed(self._simulator.time, time.monotonic())
        if missed > 0.0:
            self._node.get_logger().info(f"time goes on {missed:.1f} s later, with the others")
            self._simulator.skip(missed)

    def wait(self, publish: Callable[[], None]) -> bool:
        """Wait a moment where others are behind; whether that was so.

        Args:
            publish: sends the own state again, in case that another one has missed it.
        """
        now = time.monotonic()
        if self._time.may_step(self._simulator.time, now):
            return False
        if now - self._announced > _REPEAT:
            self._announced = now
            publish()
        time.sleep(_PAUSE)
        return True

    def _queue(self, topic: str, receive: Callable[[Any], None], message: Any) -> None:
        self._received.put((topic, partial(receive, message)))

    def _on_pose(self, name: str, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        self._poses[name] = pose.transform
        elapsed = pose.stamp * 1e-9 - self._simulator.config.start_time
        self._time.receive(name, elapsed, time.monotonic())

    def _on_joints(self, name: str, message: JointState) -> None:
        record = decode_joint_state(message)
        self._joints[name] = dict(zip(record.names, map(float, record.positions), strict=True))


def teammate_names(config: TeammatesConfig) -> tuple[str, ...]:
    """Names of the teammates: their namespaces without slashes at the ends."""
    return tuple(name.strip("/") for name in config.teammates)


_LONGEST_LAG = 0.2  # [s] that is caught up; what is more is lost
_IDLE = 0.002  # [s] that others get between two ticks


@dataclass(frozen=True)
class SimulatorNodeConfig:
    """Which world the robot is in, which robot it is, and how fast time passes.

    Raises:
        ConfigError: a value is out of its range.
    """

    world: str = parameter(
        "mars", "mars, office or cave; or a mesh, or the .yaml of a floor plan of map_server."
    )
    world_seed: int = parameter(1, "Seed of everything random in the world.", low=0)
    world_size: float = parameter(
        0.0, "Size of the world; 0 for its usual size.", unit="m", low=0.0, high=100.0
    )
    world_target: bool = parameter(
        True, "Whether the world has a board with tags, where it can do without."
    )
    description: str = parameter(
        "config/rover.urdf",
        "Robot description: a path, one below the package's share folder, or package://.",
    )
    base_frame: str = parameter(
        "", "Link whose pose is the robot's, as other nodes have it; robot.base_frame where empty."
    )
    arm_joints: tuple[str, ...] = parameter(
        (), "Joints that robot.home is for, as planning has them; robot.arm_joints where empty."
    )
    pace: float = parameter(
        1.0,
        "Simulated seconds per second. 0: as fast as possible while the robot moves, and 1 while "
        "it stands and others think.",
        low=0.0,
        high=100.0,
    )
    state_file: str = parameter(
        "",
        "Where the robot stands is written here once per simulated second, so that it can go on "
        "from there after a restart; empty for no file.",
    )
    resume: bool = parameter(
        False, "Go on from where the robot of state_file stood, where there is one."
    )
    lockstep_nodes: tuple[str, ...] = setting(
        (),
        "Nodes for which time waits: it goes on when each has used all that it was sent, so that "
        "a run does not depend on the machine. They and this node have lockstep set.",
    )

    def __post_init__(self) -> None:
        check_config(self)


class SimulatorNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (SimulatorNodeConfig, ""),
        (SimulatorOutputsConfig, ""),
        (SimulatorInputsConfig, ""),
        (SensorScheduleConfig, ""),
        (TeammatesConfig, ""),
        (TeamTagsConfig, "team_tags."),
        (SimulatorConfig, ""),
        (LockstepConfig, ""),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("simulator", **node_arguments)
        self._config = self.config(SimulatorNodeConfig)
        self._simulator, scene = self._build()
        self._outputs = SimulatorOutputs(self, self._simulator, scene)
        self._inputs = SimulatorInputs(self, self._simulator)
        self._actions = None
        if self.config(SimulatorInputsConfig).commands == "actions":
            self._actions = SimulatorActions(self, self._simulator, self._inputs)
        self._teammates = SimulatorTeammates(self, self._simulator)
        self._stopping, names = False, self._config.lockstep_nodes
        self._conductor = None
        if names:
            if self.lockstep is None:
                raise ConfigError("lockstep_nodes", names, "none, as lockstep is not set")
            self._conductor = LockstepConductor(self, self.lockstep, names, lambda: self._stopping)
        self.start_worker(1).submit(self._run)

    def _build(self) -> tuple[Simulator, str]:
        """The robot in its world, and the description of the world."""
        config = self._config
        size: dict[str, Any] = {"size": config.world_size} if config.world_size else {}
        given = size if config.world_target else {**size, **without_target(config.world)}
        scene = describe_scene(*scene_of(config.world, config.world_seed, **given))
        world = build_scene(scene)
        if world.note:
            self.get_logger().info(world.note)
        description = read_description(find_description(config.description))
        mates = self.config(TeammatesConfig)
        others = dict.fromkeys(teammate_names(mates), description)
        tags = mates.boards(self.config(TeamTagsConfig))
        simulator = Simulator(world, description, self._simulator_config(), others, tags)
        for part in simulator.mended:
            self.get_logger().warning(part)
        self.get_logger().info(f"world '{config.world}', seed {config.world_seed}")
        self._account = RobotAccount(simulator, config.state_file, scene)
        if config.resume and self._account.resume():
            self.get_logger().info(f"the robot goes on from where {config.state_file} says")
        return simulator, scene

    def _simulator_config(self) -> SimulatorConfig:
        """With what other nodes have by the same name."""
        own, config = self._config, self.config(SimulatorConfig)
        setup = replace(
            config.robot,
            base_frame=own.base_frame or config.robot.base_frame,
            arm_joints=own.arm_joints or config.robot.arm_joints,
        )
        return replace(config, robot=setup)

    def _run(self) -> None:
        """Simulate until the end; in the worker thread, to which drawing is bound."""
        self._outputs.begin()
        self._teammates.join(self._outputs.publish_state)
        pace = _Pace(self._config.pace, lambda: self._simulator.is_moving)
        try:
            if self._conductor is not None:
                self._conductor.begin()
            while not self._stopping:
                self._inputs.carry_out()
                if self._actions is not None:
                    self._actions.update()
                self._teammates.update()
                if self._teammates.wait(self._outputs.publish_state):
                    continue
                self._simulator.step(TICK)
                self.guard("simulation", self._outputs.publish_due)
                if self._conductor is not None and self._outputs.has_measured:
                    self._conductor.settle(self._simulator.stamp)
                self.guard("state_file", self._account.save_when_due)
                self._inputs.report_problem()
                if self._conductor is None:
                    time.sleep(pace.wait(TICK))
        finally:
            self._simulator.close()

    def destroy_node(self) -> None:
        """Stop simulating, then the node."""
        self._stopping = True
        super().destroy_node()


class _Pace:
    """How long to wait so that simulated time passes at the wanted pace.

    Args:
        pace: simulated seconds per second; 0 for as fast as possible while moving.
        is_moving: whether the robot moves.
    """

    def __init__(self, pace: float, is_moving: Callable[[], bool]) -> None:
        self._pace, self._is_moving = pace, is_moving
        self._due = time.monotonic()

    def wait(self, tick: float) -> float:
        """Time to wait after a tick of simulated time [s]."""
        now = time.monotonic()
        if self._pace == 0.0 and self._is_moving():
            self._due = now
            return 0.0
        self._due = max(self._due + tick / (self._pace or 1.0), now - _LONGEST_LAG)
        return max(self._due - now, _IDLE)


def main() -> int:
    """Run the node."""
    return run_node(SimulatorNode)


if __name__ == "__main__":
    raise SystemExit(main())
