"""What the launch files have in common: how the nodes of one robot are started.

ROS's launch is imported when it is needed, as the wheels have none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.common.environment import additions, reliable_inputs
from infomap_ros.nodes.robot.image_inputs import (
    COMPRESSED,
    COMPRESSED_DEPTH,
    depth_topics,
    stereo_topics,
)
from infomap_ros.nodes.team.team_topics import OWN_FRAMES, SHARED
from infomap_ros.pipeline.perception import ImageSources

# The topics of common camera drivers, so that a launch argument takes the place of remaps.
#
# Names are those under which a driver publishes with its own launch file, relative to the robot's
# namespace.


@dataclass(frozen=True)
class CameraPreset:
    """How a driver's images are used.

    Attributes:
        source: stereo or depth, as parameter of stereo_range and fiducial_localization.
        rectify: whether images are raw.
        topics: those of the nodes, and those of the driver in their place.
    """

    source: str
    rectify: bool
    topics: Mapping[str, str]


def _pair(left: str, right: str, image: str) -> CameraPreset:
    """A pair of rectified images, each below a topic of its own."""
    topics: dict[str, str] = {}
    for side, place in (("left", left), ("right", right)):
        topics |= {f"{side}/image_rect": f"{place}/{image}"}
        topics |= {f"{side}/camera_info": f"{place}/camera_info"}
    return CameraPreset("stereo", False, topics)


_REALSENSE = "camera/camera"

PRESETS: Mapping[str, CameraPreset] = {
    "realsense": _pair(f"{_REALSENSE}/infra1", f"{_REALSENSE}/infra2", "image_rect_raw"),
    "realsense_depth": CameraPreset(
        "depth",
        False,
        {
            "depth/image_rect": f"{_REALSENSE}/aligned_depth_to_color/image_raw",
            "depth/camera_info": f"{_REALSENSE}/aligned_depth_to_color/camera_info",
            "rgb/image_rect": f"{_REALSENSE}/color/image_raw",
        },
    ),
    "zed": _pair("zed/zed_node/left", "zed/zed_node/right", "image_rect_color"),
    "oak": _pair("oak/left", "oak/right", "image_rect"),
}
"""By the value of the launch argument ``camera``."""


def camera_preset(name: str) -> CameraPreset | None:
    """The preset of that name, None for an empty one.

    Raises:
        ConfigError: there is none.
    """
    if name and name not in PRESETS:
        raise ConfigError("camera", name, f"one of {', '.join(PRESETS)}")
    return PRESETS.get(name)


ROBOT_ARGUMENTS = {
    "namespace": ("", "Namespace of the robot."),
    "robot_id": ("0", "Id of the robot in its team, from 1 on; 0: it works alone."),
    "team": ("", "Ids of all robots of the team, as 1,2,3; empty: whoever writes belongs to it."),
    "team_key": ("", "File with the secret of the team; empty: none."),
    "frame_prefix": (
        "",
        "Put before the names of the robot's frames, as robot_state_publisher does. /tf is common "
        "to all robots then; without it each namespace has a tf of its own.",
    ),
    "use_sim_time": (
        "auto",
        "true: time is that of /clock, as of Gazebo or a bag that others play. auto: where this "
        "launch file starts what publishes it.",
    ),
    "autosave": ("30.0", "Time between two saves of the map [s]; 0: at the end alone."),
    "source": (
        "stereo",
        "stereo: a pair of cameras; depth: a depth camera; points: points2 comes from elsewhere, "
        "as from a lidar, and localization is odometry or pose.",
    ),
    "rectify": ("true", "The images are raw and must be rectified."),
    "localization": (
        "fiducials",
        "fiducials: fiducial_localization; odometry: dead_reckoning; pose: camera_pose comes from "
        "elsewhere, as from the bag or the simulator.",
    ),
    "camera": (
        "",
        f"Driver whose topics are used: {', '.join(PRESETS)}. It counts for more than source and "
        "rectify. Empty: left/image_raw and so on, remapped by you.",
    ),
    "image_transport": (
        "raw",
        "raw or compressed: whether images come as they are or as image_transport compresses "
        "them, below the names of their topics.",
    ),
    "respawn": ("false", "Start a node that died anew, two seconds later."),
    "log_level": ("info", "Least severity that is logged: debug, info, warn, error."),
    "robot": (
        "",
        "File of the robot, as infomap robot writes it, or the name of one of config/robots; the "
        "other arguments count for more than what it holds.",
    ),
    "parameters": ("", "Parameter file of your own, which counts for more than all arguments."),
    "rviz": ("false", "Start RViz."),
    "web": ("false", "Start web_viewer, a page in the browser; its address is in the log."),
}
_MOTION = ("odom", "joint_states")
_TIME_TO_END = "20.0"
"""After SIGINT, until a node is told a second time [s]: a map of 50 million voxels is saved by
then, on a busy machine too."""
_TIME_TO_DIE = "10.0"  # after that, until it is killed [s]
_RESPAWN_DELAY = 2.0  # [s]
_BASE, _ODOM = "base_link", "odom"
_FRAMES = (
    "map_fusion",
    "next_best_view",
    "fiducial_localization",
    "explorer",
    "dead_reckoning",
    "robot_driver",
    "web_viewer",
)
_MEMBERS = ("map_fusion", "next_best_view", "fiducial_localization", "explorer", "web_viewer")


def launch_description(
    arguments: Mapping[str, tuple[str, str]], start: Callable[[dict[str, str]], list[Any]]
) -> Any:
    """What a launch file describes: its arguments, and what it starts with their values.

    Args:
        arguments: default and description by name.
        start: given the values by name; returns the actions.
    """
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    from launch.substitutions import LaunchConfiguration

    from launch import LaunchDescription

    def begin(context: Any) -> list[Any]:
        return start({name: LaunchConfiguration(name).perform(context) for name in arguments})

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=begin)])


class RobotLaunch:
    """Starts the nodes of one robot.

    Args:
        given: values of the launch file's arguments, `ROBOT_ARGUMENTS` among them.
        simulated: time is that of a bag or a simulator. All publishers are our own then, and
            reliable, so nothing need be lost.
    """

    def __init__(self, given: Mapping[str, str], simulated: bool) -> None:
        self._given = given
        self._simulated = simulated
        self._use_sim_time = {"true": True, "false": False}.get(given["use_sim_time"], simulated)
        self._camera = camera_preset(given["camera"])
        self._robot = self._base = ""
        if given["robot"]:
            self._robot, self._base = _robot(given["robot"])

    @property
    def source(self) -> str:
        """What the points come from: that of the camera's preset, or as it is given."""
        return self._camera.source if self._camera else self._given["source"]

    @property
    def rectify(self) -> bool:
        """Whether images are raw: as for the camera's preset, or as it is given."""
        return self._camera.rectify if self._camera else self._given["rectify"] == "true"

    @property
    def seeing(self) -> dict[str, object]:
        """Parameters of the nodes that look with the camera."""
        return {"source": self.source, "rectify": self.rectify}

    def sensing(self) -> dict[str, list[str]]:
        """The nodes that measure and locate, each with its topics of sensor data.

        Raises:
            ConfigError: nothing can be located by images, as there are none.
        """
        images = self._images()
        topics = [*images.images, *images.infos]
        nodes = {} if self.source == "points" else {"stereo_range": topics}
        localization = self._given["localization"]
        if localization == "fiducials":
            if self.source == "points":
                raise ConfigError(
                    "localization", localization, "odometry or pose where source is points"
                )
            nodes["fiducial_localization"] = [*topics, *_MOTION]
        if localization == "odometry":
            nodes["dead_reckoning"] = [*_MOTION, "left/camera_info"]
        return nodes

    def _images(self) -> ImageSources:
        if self.source == "depth":
            return depth_topics(color=True)
        return stereo_topics(rectify=self.rectify)

    def node(
        self, executable: str, parameters: Mapping[str, object], inputs: Iterable[str] = ()
    ) -> Any:
        """The action that starts a node of this package.

        Args:
            executable: name of the node.
            parameters: those that differ from its parameter file.
            inputs: its topics that carry sensor data.
        """
        from launch_ros.actions import Node

        given = self._given
        quality = reliable_inputs(inputs, given["namespace"]) if self._simulated else {}
        settings = {"use_sim_time": self._use_sim_time, **parameters, **quality}
        if executable in _MEMBERS:
            settings |= self._membership()
        if executable in _FRAMES and given["frame_prefix"]:
            settings |= self._frames(executable)
        own = [given["parameters"]] if given["parameters"] else []
        robot = [self._robot] if self._robot else []
        return Node(
            package="infomap_ros",
            executable=executable,
            namespace=given["namespace"],
            parameters=[str(find_share(f"config/{executable}.yaml")), *robot, settings, *own],
            remappings=self._remappings,
            additional_env=additions(),
            output="screen",
            ros_arguments=["--log-level", given["log_level"]],
            respawn=given["respawn"] == "true" and executable != "bag_player",
            respawn_delay=_RESPAWN_DELAY,
            sigterm_timeout=_TIME_TO_END,
            sigkill_timeout=_TIME_TO_DIE,
        )

    @property
    def _remappings(self) -> list[tuple[str, str]]:
        """Topics of the robot that have other names."""
        frames = {} if self._given["frame_prefix"] else OWN_FRAMES
        shared = SHARED if self._is_member else {}
        return [*frames.items(), *shared.items(), *self._camera_topics().items()]

    def _camera_topics(self) -> dict[str, str]:
        """Names of the camera's topics, where they are others."""
        topics = dict(self._camera.topics) if self._camera else {}
        if self.source == "depth":  # those who only ask for the camera's frame
            topics["left/camera_info"] = topics.get("depth/camera_info", "depth/camera_info")
        if self._given["image_transport"] != COMPRESSED:
            return topics
        for topic in self._images().images:
            transport = COMPRESSED_DEPTH if topic.startswith("depth/") else COMPRESSED
            topics[topic] = f"{topics.get(topic, topic)}/{transport}"
        return topics

    def _frames(self, executable: str) -> dict[str, object]:
        """Parameters that name the robot's frames."""
        prefix = self._given["frame_prefix"]
        if executable == "map_fusion":
            return {"frame_prefix": prefix}
        names = {"base_frame": prefix + (self._base or _BASE), "odom_frame": prefix + _ODOM}
        return {**names, "frame_prefix": prefix}

    def viewers(self) -> list[Any]:
        """The actions that start what shows the run, where it is wanted."""
        is_wanted = self._given["web"] == "true"
        return [self._rviz(), *([self.node("web_viewer", {})] if is_wanted else [])]

    def _rviz(self) -> Any:
        """The action that starts RViz, where it is wanted."""
        from launch.actions import Shutdown
        from launch.conditions import IfCondition
        from launch.substitutions import LaunchConfiguration
        from launch_ros.actions import Node

        return Node(
            package="rviz2",
            executable="rviz2",
            namespace=self._given["namespace"],
            arguments=["-d", str(find_share("config/infomap.rviz"))],
            remappings=[] if self._given["frame_prefix"] else list(OWN_FRAMES.items()),
            parameters=[{"use_sim_time": self._use_sim_time}],
            additional_env=additions(),
            condition=IfCondition(LaunchConfiguration("rviz")),
            on_exit=Shutdown(),
        )

    @property
    def _is_member(self) -> bool:
        return int(self._given["robot_id"]) > 0

    def _membership(self) -> dict[str, object]:
        given = self._given
        if not self._is_member:
            return {}
        team = [int(number) for number in numbers(given["team"])]
        membership: dict[str, object] = {"robot_id": int(given["robot_id"])}
        membership |= {"team": team} if team else {}
        return membership | ({"team_key": given["team_key"]} if given["team_key"] else {})


def _robot(name: str) -> tuple[str, str]:
    """Where a robot's file is, and the base frame in it.

    Raises:
        InfomapError: there is no such file, or it cannot be used.
    """
    # Imported here, as it brings the simulation, which a launch without it need not wait for.
    from infomap_ros.simulation.robots.robot_file import RobotFile, robot_path

    return str(robot_path(name)), RobotFile.read(name).setup.base_frame


def numbers(text: str) -> list[float]:
    """Numbers of a launch argument such as ``[1.0, 2, -3]`` or ``1 2 -3``."""
    return [float(number) for number in text.strip("[] ").replace(",", " ").split()]
