"""One file per robot: what simulator, planner and ``infomap explore`` must know of it.

It is a ROS parameter file whose section for all nodes, ``/**``, holds the robot. Each node takes
what it knows of it.

Names of the parameters that a robot's file may hold for all nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml

from infomap_ros.errors import ConfigError, ResourceError
from infomap_ros.geometry.config import build_config
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.base.vehicle import VehicleConfig
from infomap_ros.simulation.body.base_motion import DriveTrainConfig
from infomap_ros.simulation.body.robot import find_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig

_SHARED = ("base_frame", "arm_joints")  # of planning and simulation, by the same name

SECTIONS = ("/**", "/**/simulator")
"""Sections of a parameter file in which a robot may stand."""
SETUP = {
    one.name if one.name in _SHARED else f"robot.{one.name}": one.name
    for one in fields(RobotSetupConfig)
}
"""Field of `RobotSetupConfig` by its parameter."""
OTHERS = {
    "description": "world.description",
    "drive.turn_gain": "simulator.drive.turn_gain",
    "reaching.vehicle.wheel_links": "planner.reaching.vehicle.wheel_links",
    "reaching.vehicle.footprint": "planner.reaching.vehicle.footprint",
    "reaching.vehicle.ground_height": "planner.reaching.vehicle.ground_height",
    "reaching.vehicle.max_step": "planner.reaching.vehicle.max_step",
    "reaching.collision.ground_links": "planner.reaching.collision.ground_links",
}
"""Setting of ``infomap explore`` by the parameter, of those that are not of the setup."""
_OF_NODES = ("robot.assumed_joints", "robot.mesh_folders", "controllers", "arm")
PARAMETERS = frozenset({*SETUP, *OTHERS, *_OF_NODES})
"""All of them. A node leaves those alone that it does not have."""


_BASE_FRAME = "base_link"  # of the nodes, where none is given
_OF_CART = ("left_wheels", "right_wheels", "casters")
_WIDTH = 100  # of a line
_MEANINGS = {
    "base_frame": "root link, whose pose is the robot's",
    "arm_joints": "all between base and camera; those left out are held",
    "robot.left_wheels": "driven",
    "robot.right_wheels": "driven",
    "robot.casters": "on the ground, and not driven",
    "robot.left_camera_frame": "optical frame that most joints move",
    "robot.right_camera_frame": "beside it, along its x axis",
    "robot.assumed_joints": "joint_states may lack them",
    "reaching.vehicle.wheel_links": "it stands on these",
    "reaching.vehicle.footprint": "x y of the corners on which it stands [m]",
    "reaching.vehicle.ground_height": "in the base frame [m]",
    "reaching.vehicle.max_step": "three quarters of the radius of its smallest wheel [m]",
    "reaching.collision.ground_links": "the ground is no obstacle to these",
    "controllers": "of ros2_control, each with its joints",
}


@dataclass(frozen=True)
class RobotFile:
    """A robot, as its file has it.

    Attributes:
        description: path of the URDF, or its ``package://`` address.
        setup: what the simulator must know of it; what is empty is read from the description.
        turn_gain: see `DriveTrainConfig`; 0 for the one by geometry.
        wheel_links: patterns of the links that planning takes for wheels; empty for its default.
        ground_links: patterns of the links that planning lets touch the ground; likewise.
        assumed_joints: joints whose position real robots often do not report.
        footprint: corners x0, y0, x1, y1, ... on which planning takes it to stand [m]; empty for
            the wheels. With `ground_height` and `max_step`, see `VehicleConfig`.
        ground_height: of level ground in the base frame, for a footprint [m].
        max_step: highest step [m]; 0 for the one by the wheels.
        arm: how robot_driver moves the arm; empty for its default, ``none`` where there is none.
        controllers: that move the real arm, ``name: joint joint``, for robot_driver.
        reasons: why a parameter has its value, by name; written as comments.
        folder: of the file, where a relative description is looked for first.

    Raises:
        ConfigError: there is no description, or a value is out of its range.
    """

    description: str
    setup: RobotSetupConfig = field(default_factory=RobotSetupConfig)
    turn_gain: float = 0.0
    wheel_links: tuple[str, ...] = ()
    ground_links: tuple[str, ...] = ()
    assumed_joints: tuple[str, ...] = ()
    footprint: tuple[float, ...] = ()
    ground_height: float = 0.0
    max_step: float = 0.0
    arm: str = ""
    controllers: tuple[str, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None

    def __post_init__(self) -> None:
        if not self.description:
            raise ConfigError("description", self.description, "the path of a URDF")
        DriveTrainConfig(turn_gain=self.turn_gain)
        VehicleConfig(
            footprint=self.footprint, ground_height=self.ground_height, max_step=self.max_step
        )

    @property
    def parameters(self) -> dict[str, Any]:
        """ROS parameters that are not at their defaults, by name."""
        default = RobotSetupConfig(base_frame=_BASE_FRAME)
        values: dict[str, Any] = {"description": self.description}
        for name, own in SETUP.items():
            value = getattr(self.setup, own)
            if value != getattr(default, own) and not (self.setup.cart and own in _OF_CART):
                values[name] = value
        others = {
            "drive.turn_gain": self.turn_gain,
            "reaching.vehicle.wheel_links": ",".join(self.wheel_links),
            "reaching.vehicle.footprint": self.footprint,
            "reaching.vehicle.ground_height": self.ground_height,
            "reaching.vehicle.max_step": self.max_step,
            "reaching.collision.ground_links": self.ground_links,
            "robot.assumed_joints": self.assumed_joints,
            "arm": self.arm,
            "controllers": self.controllers,
        }
        return values | {name: value for name, value in others.items() if value}

    def text(self, title: str) -> str:
        """The file, one line per parameter.

        Args:
            title: its first line, without the comment sign.
        """
        lines = [f"# {title}"[:_WIDTH], "/**:", "  ros__parameters:"]
        for name, value in self.parameters.items():
            line = f"    {name}: {_as_yaml(value)}"
            comment = self.reasons.get(name, _MEANINGS.get(name, ""))
            lines.append(f"{line}  # {comment}" if comment else line)
        return "\n".join(lines) + "\n"

    @property
    def settings(self) -> list[str]:
        """The robot as settings of `infomap explore`, ``name=value`` each."""
        names = {name: f"simulator.robot.{own}" for name, own in SETUP.items()} | OTHERS
        frame = {"base_frame": self.setup.base_frame}
        values = self.parameters | frame | {"description": str(self.description_path)}
        return [f"{names[k]}={_as_setting(v)}" for k, v in values.items() if k in names]

    @property
    def description_path(self) -> Path:
        """Where the URDF is.

        Raises:
            ResourceError: it is nowhere; names the places.
        """
        return find_description(self.description, self.folder)

    @classmethod
    def read(cls, path: str | Path) -> RobotFile:
        """Read a file, or one of ``config/robots`` by its name.

        What only the simulator has besides, and sections of other nodes, are left alone.

        Args:
            path: of the file; ``tiago`` for ``config/robots/tiago.yaml``.

        Raises:
            ResourceError: there is no such file.
            ConfigError: it is no parameter file, a name in the section for all nodes is unknown,
                or a value is refused.
        """
        found = robot_path(path)
        try:
            content = yaml.safe_load(found.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
            problem = " ".join(str(error).split())
            raise ConfigError("--robot", str(found), f"a parameter file ({problem})") from error
        values: dict[str, Any] = {}
        for section in SECTIONS:
            part = (content or {}).get(section, {}) if isinstance(content, dict | None) else None
            if not isinstance(part, dict):
                raise ConfigError("--robot", str(found), "a parameter file of ROS")
            own = part.get("ros__parameters") or {}
            if section == SECTIONS[0]:
                _refuse_unknown(own, found.name)
            values |= {name: value for name, value in own.items() if name in PARAMETERS}
        return cls._of(values, found.resolve())

    @classmethod
    def _of(cls, values: Mapping[str, Any], path: Path) -> RobotFile:
        kept = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
        own = {own: _number(kept[name]) for name, own in SETUP.items() if name in kept}
        try:
            setup = build_config(RobotSetupConfig, {"base_frame": _BASE_FRAME, **own})
            return cls(
                str(kept.get("description", "")),
                setup,
                float(values.get("drive.turn_gain", 0.0)),
                tuple(filter(None, str(kept.get("reaching.vehicle.wheel_links", "")).split(","))),
                tuple(kept.get("reaching.collision.ground_links", ())),
                tuple(kept.get("robot.assumed_joints", ())),
                _number(kept.get("reaching.vehicle.footprint", ())),
                float(values.get("reaching.vehicle.ground_height", 0.0)),
                float(values.get("reaching.vehicle.max_step", 0.0)),
                str(kept.get("arm", "")),
                tuple(kept.get("controllers", ())),
                folder=path.parent,
            )
        except (ConfigError, TypeError, ValueError) as error:
            if isinstance(error, ConfigError):
                name = next((k for k, v in SETUP.items() if v == error.parameter), "")
                option = f"--robot {path.name}: {name or error.parameter}"
                raise ConfigError(option, error.value, error.expected) from error
            raise ConfigError(f"--robot {path.name}", str(error), "numbers and names") from error


def _refuse_unknown(names: Iterable[str], file: str) -> None:
    """See `RobotFile.read`; a misspelt name would have no effect."""
    for name in names:
        if name not in PARAMETERS:
            near = get_close_matches(name, PARAMETERS, n=1)
            expected = f"{near[0]}?" if near else f"one of {', '.join(sorted(PARAMETERS))}"
            raise ConfigError(f"--robot {file}", name, expected)


def robot_path(path: str | Path) -> Path:
    """Where a robot's file is.

    Args:
        path: of the file; ``tiago`` for ``config/robots/tiago.yaml``.

    Raises:
        ResourceError: there is no such file; names those that come with the package.
    """
    given = Path(path)
    if given.is_file():
        return given
    if given.suffix or len(given.parts) > 1:
        raise ResourceError(f"there is no robot file {given}")
    try:
        return find_share(f"config/robots/{given}.yaml")
    except ResourceError as error:
        known = ", ".join(sorted(p.stem for p in find_share("config/robots").glob("*.yaml")))
        raise ResourceError(f"there is no robot file '{given}'; ready ones: {known}") from error


def _number(value: Any) -> Any:
    """Whole numbers fit where others stand."""
    if isinstance(value, tuple):
        return tuple(map(_number, value))
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _as_yaml(value: Any) -> str:
    text: str = yaml.safe_dump(
        list(value) if isinstance(value, tuple) else value, default_flow_style=True, width=10**6
    )
    return text.strip().removesuffix("...").strip()


def _as_setting(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
