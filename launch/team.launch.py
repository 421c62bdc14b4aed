"""Explore one simulated world with several robots that share a map.

ros2 launch infomap_ros team.launch.py robots:=3
ros2 launch infomap_ros team.launch.py robots:=2 world:=office max_views:=10 out:=$HOME/team

A team of real robots: robot.launch.py on each, with namespace, robot_id and team.
"""

from pathlib import Path

from infomap_ros.exploration.task import TaskConfig
from infomap_ros.nodes.live.demo_command import demo_world, task_parameters
from infomap_ros.nodes.live.launching import ROBOT_ARGUMENTS, RobotLaunch, launch_description
from infomap_ros.nodes.live.live_exploration import member_parameters, robot_names
from infomap_ros.simulation.team_world import ABREAST, APART, team_starts
from launch import LaunchDescription

TASK = TaskConfig()
ARGUMENTS = {
    "robots": ("2", "How many robots."),
    "world": ("mars", "World of the simulators: mars, office or cave."),
    "seed": ("1", "Seed of the world."),
    "board": ("true", "Whether there is a board; false: tags on the robots join their maps."),
    "size": ("0", "Edge length of the world [m]; 0 for its usual size."),
    "voxel_size": ("0.05", "Edge length of a voxel [m]."),
    "known_fraction": (str(TASK.known_fraction), "Share of the surface that must be known."),
    "max_views": (str(TASK.max_views), "Budget of views of each robot."),
    "out": ("team", "Folder with a folder for the files of each robot, which go on from them."),
    **{name: ROBOT_ARGUMENTS[name] for name in ("team_key", "respawn", "log_level", "parameters")},
}


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _processes)


def _processes(given: dict[str, str]) -> list:
    seed, size = int(given["seed"]), float(given["size"])
    has_board = given["board"].lower() == "true"
    world = demo_world(given["world"], seed, size, has_board=has_board)
    names, processes = robot_names(int(given["robots"])), []
    starts = team_starts(world, len(names), ABREAST if has_board else APART)
    for number, start in enumerate(starts):
        folder = Path(given["out"]).absolute() / names[number]
        folder.mkdir(parents=True, exist_ok=True)
        nodes = member_parameters(names, number, start, folder, has_board=has_board)
        nodes["simulator"] |= {"world": given["world"], "world_seed": seed, "world_size": size}
        nodes["map_fusion"]["voxel_size"] = float(given["voxel_size"])
        limits = {
            "max_views": int(given["max_views"]),
            "known_fraction": float(given["known_fraction"]),
        }
        for name in ("next_best_view", "explorer"):
            nodes[name] |= task_parameters(world, limits, () if has_board else starts)
        usual = {name: default for name, (default, _) in ROBOT_ARGUMENTS.items()}
        identity = {"namespace": names[number], "robot_id": str(number + 1)}
        robot = RobotLaunch({**usual, **given, **identity}, simulated=True)
        processes += [robot.node(name, _as_given(values)) for name, values in nodes.items()]
    return processes


def _as_given(values: dict) -> dict:
    """Parameters as launch takes them."""
    return {
        name: str(value) if isinstance(value, Path) else value for name, value in values.items()
    }
