"""Map with stereo_range and map_fusion, live or from a bag.

ros2 launch infomap_ros mapping.launch.py bag:=bags/rover_rocks
ros2 launch infomap_ros mapping.launch.py namespace:=robot1 rectify:=true map_file:=/tmp/map.infomap
"""

from pathlib import Path

from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.live.launching import ROBOT_ARGUMENTS, RobotLaunch, launch_description
from launch import LaunchDescription

ARGUMENTS = {
    "bag": ("", "Bag to play; empty for live topics."),
    "rate": ("1.0", "Speed of the replay."),
    "acknowledged": ("false", "Play as fast as the nodes follow, whatever the rate."),
    "loop": ("false", "Play the bag again and again."),
    "map_file": ("map.infomap", "File of the map, saved from time to time and at the end."),
    "resume": ("false", "Load map_file at the start."),
    "voxel_size": ("0.05", "Edge length of a voxel [m]."),
    **ROBOT_ARGUMENTS,
}


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _processes)


def _processes(given: dict[str, str]) -> list:
    bag = given["bag"]
    if bag and not Path(bag).exists():
        bag = str(find_share(bag))
    robot = RobotLaunch(given, simulated=bool(bag))
    fusion = {
        "map_file": given["map_file"],
        "resume": given["resume"] == "true",
        "autosave_period": float(given["autosave"]),
        "voxel_size": float(given["voxel_size"]),
    }
    nodes = [
        robot.node(name, {} if name == "dead_reckoning" else robot.seeing, topics)
        for name, topics in robot.sensing().items()
    ]
    nodes.append(robot.node("map_fusion", fusion, ["points2", "camera_pose", "joint_states"]))
    if bag:
        nodes.append(robot.node("bag_player", _player(bag, given, robot)))
    return [*nodes, *robot.viewers()]


def _player(bag: str, given: dict[str, str], robot: RobotLaunch) -> dict:
    """Parameters of bag_player. It waits for one of each node: the first start compiles."""
    left_image = "left/image_raw" if robot.rectify else "left/image_rect"
    image = "depth/image_rect" if robot.source == "depth" else left_image
    watching = 1 + (given["localization"] == "fiducials")  # nodes that listen to the images
    located = given["localization"] != "pose"
    return {
        "bag": bag,
        "rate": float(given["rate"]),
        "loop": given["loop"] == "true",
        "acknowledged": given["acknowledged"] == "true",
        "paced_topic": f"/{image}",
        "wait_for_subscribers": [*[image] * watching, "points2", "camera_pose"],
        "wait_for_publishers": ["camera_pose"] if located else [],
        "left_out": ["/camera_pose"] if located else [],
        "use_sim_time": False,
    }
