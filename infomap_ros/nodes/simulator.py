"""Node ``simulator``: the hardware's stand-in, a robot in a simulated world.

It publishes what the hardware would and moves on cmd_vel, base_path and arm_trajectory; what is
true and a robot cannot know goes to ground_truth/* alone. Simulation and drawing run in the worker
thread; callbacks only pass commands on. Other robots in the same world have simulators of their
own (`infomap_ros.nodes.simulated.simulator_teammates`). On a machine that is too slow for the
wanted pace, simulated time passes more slowly, and /clock says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConductor, LockstepConfig
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.simulated.simulator_actions import SimulatorActions
from infomap_ros.nodes.simulated.simulator_inputs import SimulatorInputs, SimulatorInputsConfig
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorOutputs, SimulatorOutputsConfig
from infomap_ros.nodes.simulated.simulator_teammates import (
    SimulatorTeammates,
    TeammatesConfig,
    teammate_names,
)
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.body.robot_account import RobotAccount
from infomap_ros.simulation.robots.robot_file import find_description
from infomap_ros.simulation.sensor_schedule import TICK, SensorScheduleConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.scenes import build_scene, describe_scene, scene_of

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
        scene = describe_scene(*scene_of(config.world, config.world_seed, **size))
        world = build_scene(scene)
        if world.note:
            self.get_logger().info(world.note)
        description = read_description(find_description(config.description))
        others = dict.fromkeys(teammate_names(self.config(TeammatesConfig)), description)
        simulator = Simulator(world, description, self._simulator_config(), others)
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
                self._inputs.tell_problem()
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
