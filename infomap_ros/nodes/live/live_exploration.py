"""An exploration as processes over DDS: simulator, driver, localization, range, map, choice, loop.

The robot is driven by actions where their packages are installed, else by topics.

Robots that explore one simulated world together, each node of each robot a process.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.environment import reliable_inputs
from infomap_ros.nodes.common.parameters import parameter_values
from infomap_ros.nodes.live.live_graph import LiveGraph, NodeProcesses
from infomap_ros.nodes.simulated.simulated_driver import (
    driven_simulator,
    has_actions,
    simulated_driver,
    simulated_localization,
    simulated_motion_noise,
)
from infomap_ros.nodes.team.team_topics import SHARED
from infomap_ros.replay.map_files import MAP_FILE
from infomap_ros.simulation.body.robot import find_description, read_description
from infomap_ros.simulation.cameras.stereo_camera import DRAWN_FAST
from infomap_ros.simulation.exploring.simulated_robot import IMAGE_RATE
from infomap_ros.simulation.team_world import TeamStart, rover_tags, with_plates

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
        localized: by fiducial_localization; else the simulator publishes the camera's pose.
        lockstep: simulated time waits for the nodes, and the robot is driven by topics.
    """

    def reliable(*topics: str) -> dict[str, str]:
        return reliable_inputs(topics, namespace)

    poses = "camera_pose", "camera_pose_uncertainty"
    updates = reliable("map_updates", *poses, "joint_states", "odom", *_IMAGES[1::2])
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
        localized: by fiducial_localization; else the simulator publishes the camera's pose.
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


_SHARING = ("map_fusion", "next_best_view")
_IN_TEAM = (*_SHARING, "explorer", "fiducial_localization")
_CLEARANCE = ViewPlannerConfig().start_clearance
_CORES = 2
"""That a robot's nodes need for all of its images. Where there are fewer, each node leaves out
others than the next one does, and few scans have a pose: fewer images, all of them used, are more.
"""
_AGREEING = 2.0  # [s] between two comparisons of the maps


def robot_names(robots: int) -> tuple[str, ...]:
    """Names of the robots of a team, which are their namespaces too."""
    return tuple(f"rover{number}" for number in range(1, robots + 1))


def member_parameters(
    names: Sequence[str],
    number: int,
    start: TeamStart,
    folder: Path,
    *,
    has_board: bool = True,
) -> dict[str, dict[str, object]]:
    """Parameters of the nodes of one robot of a simulated team, by node name.

    Args:
        names: of all robots.
        number: of this one among them, from 0 on.
        start: where it starts.
        folder: of its files, an absolute path; exists where there is no board.
        has_board: whether the world has a board that gives the map its frame; else each robot
            begins a map of its own, and tags on the robots align them.
    """
    name = names[number]
    nodes = robot_parameters(folder, f"/{name}")
    nodes["simulator"] |= {
        "teammates": [other for other in names if other != name],
        "start": list(start.place),
        "seed": 1 + number,
        "publish_clock": number == 0,
        "image_rate": IMAGE_RATE * min(1.0, (os.cpu_count() or 1) / (_CORES * len(names))),
    }
    member = {"robot_id": number + 1, "team": list(range(1, len(names) + 1))}
    for node in _IN_TEAM:
        nodes[node] |= member
    nodes["next_best_view"]["start_clearance"] = min(_CLEARANCE, start.clearance)
    if not has_board:
        _know_each_other(nodes, names, number, folder)
    return nodes


def _know_each_other(
    nodes: dict[str, dict[str, object]], names: Sequence[str], number: int, folder: Path
) -> None:
    """Have a robot begin its own map, carry tags, and look for those of its teammates."""
    path = folder / "rover.urdf"
    write_text(path, with_plates(read_description(find_description("config/rover.urdf"))))
    tags = parameter_values(rover_tags(len(names)), "team_tags.")
    tags = {key: list(value) if isinstance(value, tuple) else value for key, value in tags.items()}
    others = [place + 1 for place in range(len(names)) if place != number]
    more = {"description": path, "world_target": False, "teammate_ids": others}
    nodes["simulator"] |= {**more, **tags}
    located = nodes["fiducial_localization"]
    for key in [key for key in located if key.startswith("target.")]:
        del located[key]
    located |= {"target.kind": "none", "follow_alignment": True, **tags}


class LiveTeam(LiveGraph):
    """A team of simulated robots in namespaces ``rover1``, ``rover2``, ...

    Topics below ``/team`` are common to all; each robot has its own simulator, in which the others
    stand as well.

    Args:
        out: folder with a folder for each robot.
        starts: of the robots in the world.
        parameters: further parameters by node name, for all robots.
        loss: share of the team's messages that are lost on arrival.
        has_board: as of `member_parameters`.

    Attributes:
        names: of the robots.
        figures: what exploration_status says, by robot and name.
        folders: of the robots' files.
    """

    def __init__(
        self,
        out: Path,
        starts: Sequence[TeamStart],
        parameters: Mapping[str, Parameters] | None = None,
        loss: float = 0.0,
        *,
        has_board: bool = True,
    ) -> None:
        super().__init__(out)
        self.names = robot_names(len(starts))
        self.figures: dict[str, dict[str, str]] = {name: {} for name in self.names}
        self.folders = {name: out.absolute() / name for name in self.names}
        self._team = {
            name: NodeProcesses(folder / "log", f"/{name}", self._environment)
            for name, folder in self.folders.items()
        }
        self._down: set[str] = set()
        self._may_end: tuple[str, ...] = ()
        given, self._parameters = parameters or {}, {}
        for number, name in enumerate(self.names):
            folder = self.folders[name]
            folder.mkdir(parents=True, exist_ok=True)
            about = self.names, number, starts[number], folder
            nodes = member_parameters(*about, has_board=has_board)
            for node in _SHARING:
                nodes[node]["team_map.simulated_loss"] = loss
            self._parameters[name] = {
                node: {**values, **given.get(node, {})} for node, values in nodes.items()
            }

    def start(self) -> None:
        """Start all nodes of all robots; the explorers begin when the other nodes are there."""
        for name in self.names:
            self.subscribe(
                DiagnosticStatus,
                f"/{name}/exploration_status",
                partial(self._on_status, name),
                qos.latched(),
            )
            self.start_robot(name)

    def start_robot(self, name: str) -> None:
        """Start all nodes of a robot, the first time or again."""
        self._down.discard(name)
        for node, values in self._parameters[name].items():
            remaps = SHARED if node in _IN_TEAM else {}
            self.pids[f"{name}/{node}"] = self._team[name].start(node, values, remaps)

    def kill_robot(self, name: str) -> None:
        """End all processes of a robot at once, as a loss of power would.

        Raises:
            ProcessError: one does not end.
        """
        self._down.add(name)
        for node in self._parameters[name]:
            self._team[name].kill(node)

    def open_team_page(self) -> str:
        """As `open_page`, as the first robot sees its team."""
        team: dict[str, object] = {"robot_id": 1, "team": list(range(1, len(self.names) + 1))}
        return self.open_page(f"/{self.names[0]}", team, SHARED)

    def views(self, name: str) -> int:
        """Views that a robot has taken, as far as it was reported."""
        return int(self.figures[name].get("views", "0"))

    @property
    def ended(self) -> bool:
        """Whether all explorations have come to their ends."""
        states = [figures.get("state", "") for figures in self.figures.values()]
        return all(state.startswith("ended") for state in states)

    def stop_looking(self) -> None:
        """Let no robot take scans any more, so that their maps come to rest.

        Raises:
            ProcessError: a process does not end.
        """
        self._may_end = ("stereo_range",)
        for processes in self._team.values():
            processes.end("stereo_range")

    def agree(self, timeout: float, tick: Callable[[], None]) -> str:
        """Wait until all robots hold the same map; returns its hash.

        Raises:
            ProcessError: they do not within `timeout` [s].
        """
        end = time.monotonic() + timeout
        while True:
            accounts = {name: json.loads(self.call(_hash_service(name))) for name in self.names}
            hashes = {account["hash"] for account in accounts.values()}
            everybody = all(len(a["robots"]) == len(self.names) for a in accounts.values())
            if len(hashes) == 1 and everybody:
                return str(hashes.pop())
            if time.monotonic() > end:
                raise ProcessError(f"the maps are not the same after {timeout:.0f} s: {accounts}")
            self.spin_for(_AGREEING, tick)

    def __exit__(self, *how: object) -> None:
        for processes in self._team.values():
            processes.stop()
        super().__exit__(*how)

    def check(self) -> None:
        """Make sure that all processes live, but for those that were killed on purpose.

        Raises:
            ProcessError: one has ended.
        """
        for name in self.names:
            if name in self._down:
                continue
            try:
                self._team[name].check(may_end=self._may_end)
            except ProcessError as error:
                raise ProcessError(f"{name}: {error}") from error

    def _on_status(self, name: str, message: DiagnosticStatus) -> None:
        self.figures[name] = {pair.key: pair.value for pair in message.values}


def _hash_service(name: str) -> str:
    return f"/{name}/map_fusion/team_hash"
