"""What the launch files have in common: how the nodes of one robot are started.

ROS's launch is imported when it is needed, as the wheels have none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.common.environment import additions, reliable_inputs
from infomap_ros.nodes.team.team_topics import OWN_FRAMES, SHARED

ROBOT_ARGUMENTS = {
    "namespace": ("", "Namespace of the robot."),
    "robot_id": ("0", "Id of the robot in its team, from 1 on; 0: it works alone."),
    "team": ("", "Ids of all robots of the team, as 1,2,3; empty: whoever writes belongs to it."),
    "team_key": ("", "File with the secret of the team; empty: none."),
    "parameters": ("", "Parameter file of your own, which counts for more than all arguments."),
    "rviz": ("false", "Start RViz."),
}
_MEMBERS = ("map_fusion", "next_best_view", "fiducial_localization", "explorer")


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
        settings = {"use_sim_time": self._simulated, **parameters, **quality}
        if executable in _MEMBERS:
            settings |= self._membership()
        own = [given["parameters"]] if given["parameters"] else []
        return Node(
            package="infomap_ros",
            executable=executable,
            namespace=given["namespace"],
            parameters=[str(find_share(f"config/{executable}.yaml")), settings, *own],
            remappings=[*OWN_FRAMES.items(), *(SHARED.items() if self._is_member else ())],
            additional_env=additions(),
            output="screen",
        )

    def rviz(self) -> Any:
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
            remappings=list(OWN_FRAMES.items()),
            parameters=[{"use_sim_time": self._simulated}],
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


def numbers(text: str) -> list[float]:
    """Numbers of a launch argument such as ``[1.0, 2, -3]`` or ``1 2 -3``."""
    return [float(number) for number in text.strip("[] ").replace(",", " ").split()]
