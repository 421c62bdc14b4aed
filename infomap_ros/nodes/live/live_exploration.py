"""An exploration as processes over DDS: simulator, driver, localization, range, map, choice, loop.

The robot is driven by actions where their packages are installed, else by topics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.environment import reliable_inputs
from infomap_ros.nodes.live.live_graph import LiveGraph
from infomap_ros.nodes.simulated.simulated_driver import (
    driven_simulator,
    has_actions,
    simulated_driver,
)
from infomap_ros.nodes.simulated.simulated_localization import (
    simulated_localization,
    simulated_motion_noise,
)
from infomap_ros.replay.mapping.map_files import MAP_FILE
from infomap_ros.simulation.cameras.stereo_camera import DRAWN_FAST
from infomap_ros.simulation.exploring.simulated_robot import IMAGE_RATE

MISSION_FILE, LOG_FILE, ROBOT_FILE = "mission.json", "exploration.jsonl", "robot.json"
LOCALIZATION_FILE = "localization.infomap"
_IMAGES = tuple(
    f"{side}/{kind}" for side in ("left", "right") for kind in ("image_raw", "camera_info")
)
_PLANNING = ("next_best_view", "explorer")
_AUTOSAVE = 30.0  # [s]
_MAX_WAIT = 5.0  # [s] of simulated time, which may run fast

Parameters = Mapping[str, object]


def robot_parameters(
    out: Path, namespace: str = "/", *, localized: bool = True, lockstep: bool = False
) -> dict[str, dict[str, object]]:
    """Parameters of the nodes of one simulated robot that explores, by node name.

    It keeps map, mission, localization and its place in files, and goes on from them.

    Args:
        out: folder of its files, an absolute path.
        namespace: of the robot.
        localized: by fiducial_localization; else the simulator tells the camera's pose.
        lockstep: simulated time waits for the nodes, and the robot is driven by topics.
    """

    def reliable(*topics: str) -> dict[str, str]:
        return reliable_inputs(topics, namespace)

    updates = reliable("map_updates", "camera_pose", "joint_states", "odom", *_IMAGES[1::2])
    nodes: dict[str, dict[str, object]] = {
        "simulator": {
            "pace": 0.0,
            "image_rate": IMAGE_RATE,
            **{f"camera.{name}": value for name, value in DRAWN_FAST.items()},
            "state_file": out / ROBOT_FILE,
            "resume": True,
            "publish_camera_pose": not localized,
        },
        "fiducial_localization": {
            "rectify": True,
            "motion": "odometry",
            "state_file": out / LOCALIZATION_FILE,
            "resume": True,
            **simulated_localization(),
            **reliable(*_IMAGES, "odom", "joint_states"),
        },
        "stereo_range": {"rectify": True, **reliable(*_IMAGES)},
        "map_fusion": {
            "map_file": out / MAP_FILE,
            "resume": True,
            "autosave_period": _AUTOSAVE,
            "waiting.max_wait": _MAX_WAIT,
            **reliable("points2", "camera_pose", "camera_pose_uncertainty", "joint_states"),
        },
        "next_best_view": {**simulated_motion_noise(), **updates},
        "explorer": {
            "autostart": True,
            "resume": True,
            "mission_file": out / MISSION_FILE,
            "log_file": out / LOG_FILE,
            **updates,
        },
    }
    if has_actions() and not lockstep:
        nodes["simulator"] |= driven_simulator()
        # A motion is late by the time of the robot that carries it out.
        driver = {"use_sim_time": True, **simulated_driver()}
        nodes["robot_driver"] = {**driver, **reliable("joint_states")}
    if not localized:
        del nodes["fiducial_localization"]
    if lockstep:
        nodes["simulator"]["lockstep_nodes"] = [name for name in nodes if name != "simulator"]
        nodes = {name: {**values, "lockstep": True} for name, values in nodes.items()}
    return nodes


class LiveExploration(LiveGraph):
    """A simulated robot that explores, every node a process of its own.

    Args:
        out: folder for map, mission, log of the run and logs of the nodes.
        parameters: further parameters by node name; ``/**`` has those of all nodes.
        localized: by fiducial_localization; else the simulator tells the camera's pose.
        lockstep: simulated time waits for the nodes.

    Attributes:
        figures: what exploration_status says, by name.
        map_file: where map_fusion saves.
        log_file: log of the run.
    """

    def __init__(
        self,
        out: Path,
        parameters: Mapping[str, Parameters] | None = None,
        *,
        localized: bool = True,
        lockstep: bool = False,
    ) -> None:
        super().__init__(out)
        out = out.absolute()
        self.figures: dict[str, str] = {}
        self.map_file, self.log_file = out / MAP_FILE, out / LOG_FILE
        own = robot_parameters(out, localized=localized, lockstep=lockstep)
        given = parameters or {}
        shared = given.get("/**", {})
        self._parameters = {name: {**shared, **own[name], **given.get(name, {})} for name in own}
        self._page_parameters = {**shared, **given.get("web_viewer", {})}

    def open_own_page(self) -> str:
        """As `open_page`, of this robot."""
        return self.open_page(parameters=self._page_parameters)

    def start(self) -> None:
        """Start all nodes; the explorer begins by itself when the others are there."""
        self.start_sensing()
        self.start_planning()

    def start_sensing(self) -> None:
        """Start the nodes that make a map of where the robot stands."""
        for name in self._parameters:
            if name not in _PLANNING:
                self.start_node(name)

    def start_planning(self) -> None:
        """Start the nodes that choose views and move the robot there, after the others."""
        self.subscribe(
            DiagnosticStatus, "exploration_status", self._on_status, qos.latched(depth=1)
        )
        for name in _PLANNING:
            self.start_node(name)

    def start_node(self, name: str) -> None:
        """Start one of the nodes, the first time or again."""
        self.pids[name] = self._processes.start(name, self._parameters[name])

    def kill_node(self, name: str) -> None:
        """End one of the nodes at once, as a defect or a lack of memory would; start it again.

        Raises:
            ProcessError: it does not end.
        """
        self._processes.kill(name)
        self.start_node(name)

    @property
    def ended(self) -> bool:
        """Whether the exploration has come to its end."""
        return self.figures.get("state", "").startswith("ended")

    def follow(self, tick: Callable[[], None], timeout: float) -> None:
        """Watch until the exploration ends.

        Raises:
            ProcessError: a node failed, or it takes longer than `timeout` [s].
        """
        self.spin_until(lambda: self.ended, "the exploration to end", timeout, tick)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self.figures = {pair.key: pair.value for pair in message.values}
