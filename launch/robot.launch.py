"""A robot that maps, and explores when it is asked to; a simulated one explores at once.

ros2 launch infomap_ros robot.launch.py robot:=robot.yaml
ros2 launch infomap_ros robot.launch.py robot:=robot.yaml camera:=realsense_depth autostart:=true
ros2 launch infomap_ros robot.launch.py namespace:=robot1 robot_id:=1
ros2 launch infomap_ros robot.launch.py simulator:=true world:=cave seed:=3 rviz:=true
ros2 launch infomap_ros robot.launch.py simulator:=true world:=office robot:=tiago driver:=true
"""

from infomap_ros.exploration.task import TaskConfig
from infomap_ros.nodes.live.launching import (
    ROBOT_ARGUMENTS,
    RobotLaunch,
    launch_description,
    numbers,
)
from infomap_ros.nodes.simulated.simulated_driver import (
    driven_simulator,
    simulated_driver,
    simulated_localization,
    simulated_motion_noise,
)
from infomap_ros.simulation.exploring.simulated_robot import IMAGE_RATE
from launch import LaunchDescription

TASK = TaskConfig()
ARGUMENTS = {
    "simulator": ("false", "The robot is simulated, and its world."),
    "world": ("mars", "World of the simulator: mars, office, cave, or a file."),
    "seed": ("1", "Seed of the world."),
    "target": (
        "none",
        "What the map's frame is: tags for a board, none for where odometry begins.",
    ),
    "voxel_size": ("0.05", "Edge length of a voxel [m]."),
    "strategy": ("largest_information", "How views are ranked; a name or a dotted path."),
    "region_low": (str(list(TASK.region_low)), "Lower corner of the box to be mapped [m]."),
    "region_high": (str(list(TASK.region_high)), "Upper corner of the box to be mapped [m]."),
    "known_fraction": (str(TASK.known_fraction), "Share of the surface that must be known."),
    "surface_sigma": (str(TASK.surface_sigma), "Standard deviation that is precise enough [m]."),
    "max_views": (str(TASK.max_views), "Budget of views."),
    "max_distance": (str(TASK.max_distance), "Budget of the distance driven [m]."),
    "max_time": (str(TASK.max_time), "Budget of time [s]."),
    "autostart": (
        "auto",
        "true: explore at once; false: when ~/start of the explorer is called. auto: a simulated "
        "robot at once.",
    ),
    "driver": (
        "auto",
        "Start robot_driver, which moves the robot by the controllers that its file names; without "
        "it the robot must obey base_path and arm_trajectory itself. auto: for a real robot.",
    ),
    "plan_only": ("false", "Publish views and paths, and move nothing."),
    "resume": ("false", "Go on with map_file and mission_file."),
    "map_file": ("map.infomap", "File of the map, saved from time to time and at the end."),
    "mission_file": ("mission.json", "File with the account of the mission."),
    "log_file": ("exploration.jsonl", "Log of the run, for the report."),
    **ROBOT_ARGUMENTS,
}
STATE = ["camera_pose", "joint_states"]


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _processes)


def _processes(given: dict[str, str]) -> list:
    simulated = given["simulator"] == "true"
    choices = {"autostart": str(simulated).lower(), "driver": str(not simulated).lower()}
    given |= {name: value for name, value in choices.items() if given[name] == "auto"}
    robot = RobotLaunch(given, simulated)
    inputs = {
        **robot.sensing(),
        "map_fusion": ["points2", *STATE],
        "next_best_view": [*STATE, "left/camera_info"],
        "explorer": [*STATE, "left/camera_info"],
    }
    if given["driver"] == "true":
        inputs["robot_driver"] = [*STATE, "odom", "left/camera_info"]
    if simulated:
        inputs["simulator"] = []
    settings = _settings(given, robot)
    nodes = [robot.node(name, settings.get(name, {}), topics) for name, topics in inputs.items()]
    return [*nodes, *robot.viewers()]


def _settings(given: dict[str, str], robot: RobotLaunch) -> dict[str, dict]:
    """Parameters of each node from the launch arguments."""
    truth = {name: value == "true" for name, value in given.items()}
    driven = truth["simulator"] and truth["driver"]
    task = {
        "task.region_low": numbers(given["region_low"]),
        "task.region_high": numbers(given["region_high"]),
        "task.known_fraction": float(given["known_fraction"]),
        "task.surface_sigma": float(given["surface_sigma"]),
        "task.max_views": int(given["max_views"]),
        "task.max_distance": float(given["max_distance"]),
        "task.max_time": float(given["max_time"]),
    }
    return {
        "stereo_range": robot.seeing,
        "map_fusion": {
            "map_file": given["map_file"],
            "resume": truth["resume"],
            "autosave_period": float(given["autosave"]),
            "voxel_size": float(given["voxel_size"]),
        },
        "fiducial_localization": {
            **robot.seeing,
            "motion": "odometry",
            **(simulated_localization(given["robot"]) if truth["simulator"] else {}),
            "target.kind": given["target"],
        },
        "next_best_view": {
            "source": "depth" if robot.source == "depth" else "stereo",
            "strategy": given["strategy"],
            **(simulated_motion_noise(given["robot"]) if truth["simulator"] else {}),
            **task,
        },
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
            "publish_camera_pose": given["localization"] == "pose",
            **(driven_simulator() if driven else {}),
        },
        "robot_driver": simulated_driver(given["robot"]) if driven else {},
    }
