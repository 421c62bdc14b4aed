"""Explore with stereo_range, map_fusion, next_best_view and explorer, in simulation or on a robot.

ros2 launch infomap_ros exploration.launch.py world:=cave seed:=3 rviz:=true
ros2 launch infomap_ros exploration.launch.py simulator:=false
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.environment import additions, reliable_inputs
from infomap_ros.nodes.simulated_localisation import IMAGE_RATE, simulated_localisation
from infomap_ros.stereo import StereoConfig
from launch import LaunchDescription

TASK = TaskConfig()
ARGUMENTS = {
    "simulator": ("true", "A simulated rover; false for a real robot."),
    "world": ("mars", "World of the simulator: mars, office or cave."),
    "seed": ("1", "Seed of the world."),
    "namespace": ("", "Namespace of the robot."),
    "localisation": (
        "fiducials",
        "fiducials: fiducial_localization; odometry: dead_reckoning; pose: camera_pose comes from "
        "elsewhere, in simulation from the simulator.",
    ),
    "target": (
        "none",
        "What the map's frame is: tags for a board, none for where odometry begins.",
    ),
    "rectify": ("true", "The images are raw and must be rectified."),
    "voxel_size": ("0.05", "Edge length of a voxel [m]."),
    "strategy": ("largest_information", "How views are ranked; a name or a dotted path."),
    "region_low": (str(list(TASK.region_low)), "Lower corner of the box to be mapped [m]."),
    "region_high": (str(list(TASK.region_high)), "Upper corner of the box to be mapped [m]."),
    "known_fraction": (str(TASK.known_fraction), "Share of the surface that must be known."),
    "mean_sigma": (str(TASK.mean_sigma), "Largest mean standard deviation of the map [m]."),
    "max_views": (str(TASK.max_views), "Budget of views."),
    "max_distance": (str(TASK.max_distance), "Budget of the way of the base [m]."),
    "max_time": (str(TASK.max_time), "Budget of time [s]."),
    "autostart": ("true", "Begin at once, without explorer/start."),
    "plan_only": ("false", "Publish views and ways, and move nothing."),
    "resume": ("false", "Go on with map_file and mission_file."),
    "map_file": ("map.infomap", "File of the map, saved every half minute and at the end."),
    "mission_file": ("mission.json", "File with the account of the mission."),
    "log_file": ("exploration.jsonl", "Log of the run, for the report."),
    "parameters": ("", "Parameter file of your own, which counts for more than all of these."),
    "rviz": ("false", "Start RViz."),
}
AUTOSAVE = 30.0  # [s]
IMAGES = [f"{s}/{kind}" for s in ("left", "right") for kind in ("image_raw", "camera_info")]
STATE = ["camera_pose", "joint_states"]


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_processes)])


def _processes(context) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    simulated = given["simulator"] == "true"
    clock = {"use_sim_time": simulated}

    def node(executable: str, parameters: dict, inputs: list[str]) -> Node:
        # All publishers are our own and reliable in simulation, so nothing need be lost.
        quality = reliable_inputs(inputs, given["namespace"]) if simulated else {}
        defaults = str(find_share(f"config/{executable}.yaml"))
        own = [given["parameters"]] if given["parameters"] else []
        return Node(
            package="infomap_ros",
            executable=executable,
            namespace=given["namespace"],
            parameters=[defaults, parameters | quality | clock, *own],
            additional_env=additions(),
            output="screen",
        )

    settings = _settings(given)
    processes = [
        node("stereo_range", settings["stereo_range"], IMAGES),
        node("map_fusion", settings["map_fusion"], ["points2", *STATE]),
        node("next_best_view", settings["next_best_view"], [*STATE, "left/camera_info"]),
        node("explorer", settings["explorer"], [*STATE, "left/camera_info"]),
    ]
    motion = ["odom", "joint_states"]
    if given["localisation"] == "odometry":
        processes.append(node("dead_reckoning", {}, [*motion, "left/camera_info"]))
    if given["localisation"] == "fiducials":
        name = "fiducial_localization"
        processes.append(node(name, settings[name], [*IMAGES, *motion]))
    if simulated:
        processes.append(node("simulator", settings["simulator"], []))
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=given["namespace"],
        arguments=["-d", str(find_share("config/infomap.rviz"))],
        parameters=[clock],
        additional_env=additions(),
        condition=IfCondition(LaunchConfiguration("rviz")),
        on_exit=Shutdown(),
    )
    return [*processes, rviz]


def _settings(given: dict[str, str]) -> dict[str, dict]:
    """Parameters of each node from the launch arguments."""
    truth = {name: value == "true" for name, value in given.items()}
    task = {
        "task.region_low": _numbers(given["region_low"]),
        "task.region_high": _numbers(given["region_high"]),
        "task.known_fraction": float(given["known_fraction"]),
        "task.mean_sigma": float(given["mean_sigma"]),
        "task.max_views": int(given["max_views"]),
        "task.max_distance": float(given["max_distance"]),
        "task.max_time": float(given["max_time"]),
    }
    return {
        "stereo_range": {"rectify": truth["rectify"]},
        "map_fusion": {
            "map_file": given["map_file"],
            "resume": truth["resume"],
            "autosave_period": AUTOSAVE,
            "voxel_size": float(given["voxel_size"]),
            "error_correlation": StereoConfig().error_correlation,
        },
        "fiducial_localization": {
            "rectify": truth["rectify"],
            "motion": "odometry",
            **(simulated_localisation() if truth["simulator"] else {}),
            "target.kind": given["target"],
        },
        "next_best_view": {"strategy": given["strategy"], **task},
        "explorer": {
            "autostart": truth["autostart"],
            "plan_only": truth["plan_only"],
            "resume": truth["resume"],
            "mission_file": given["mission_file"],
            "log_file": given["log_file"],
            **task,
        },
        "simulator": {
            "image_rate": IMAGE_RATE,
            "world": given["world"],
            "world_seed": int(given["seed"]),
            "publish_camera_pose": given["localisation"] == "pose",
        },
    }


def _numbers(text: str) -> list[float]:
    """Coordinates such as ``[1.0, 2, -3]`` or ``1 2 -3``."""
    return [float(number) for number in text.strip("[] ").replace(",", " ").split()]
