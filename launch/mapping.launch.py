"""Map with stereo_range and map_fusion, live or from a bag.

ros2 launch infomap_ros mapping.launch.py bag:=bags/rover_rocks
ros2 launch infomap_ros mapping.launch.py namespace:=robot1 rectify:=true map_file:=/tmp/map.infomap
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.environment import additions, reliable_inputs
from infomap_ros.stereo import DepthCameraConfig, StereoConfig
from launch import LaunchDescription

ARGUMENTS = {
    "bag": ("", "Bag to play; empty for live topics."),
    "rate": ("1.0", "Speed of the replay."),
    "acknowledged": ("false", "Play as fast as the nodes follow, whatever the rate."),
    "loop": ("false", "Play the bag again and again."),
    "namespace": ("", "Namespace of the robot."),
    "source": ("stereo", "stereo: a pair of cameras; depth: a depth camera."),
    "localisation": (
        "fiducials",
        "fiducials: fiducial_localization; odometry: dead_reckoning; pose: camera_pose comes from "
        "elsewhere, as from the bag.",
    ),
    "rectify": ("true", "The images are raw and must be rectified."),
    "map_file": ("map.infomap", "File of ~/save, ~/load and autosave."),
    "resume": ("false", "Load map_file at the start."),
    "voxel_size": ("0.05", "Edge length of a voxel [m]."),
    "rviz": ("false", "Start RViz."),
}


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_processes)])


def _processes(context) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    truth = {name: value == "true" for name, value in given.items()}
    bag = given["bag"]
    if bag and not Path(bag).exists():
        bag = str(find_share(bag))

    def node(executable: str, parameters: dict, **options) -> Node:
        return Node(
            package="infomap_ros",
            executable=executable,
            namespace=given["namespace"],
            parameters=[str(find_share(f"config/{executable}.yaml")), parameters],
            additional_env=additions(),
            output="screen",
            **options,
        )

    sensor = DepthCameraConfig() if given["source"] == "depth" else StereoConfig()
    range_parameters = {"source": given["source"], "rectify": truth["rectify"]}
    fusion_parameters = {
        "map_file": given["map_file"],
        "resume": truth["resume"],
        "voxel_size": float(given["voxel_size"]),
        "error_correlation": sensor.error_correlation,
    }
    locating = _locating(given)
    left_image = "left/image_raw" if truth["rectify"] else "left/image_rect"
    image = "depth/image_rect" if given["source"] == "depth" else left_image
    watching = 1 + ("fiducial_localization" in locating)  # nodes that listen to the images
    player_parameters = {
        "bag": bag,
        "rate": float(given["rate"]),
        "loop": truth["loop"],
        "acknowledged": truth["acknowledged"],
        # One of each node: the first start compiles, and nothing should be played before.
        "wait_for_subscribers": [*[image] * watching, "camera_pose"],
        "wait_for_publishers": ["camera_pose"] if locating else [],
        "left_out": ["/camera_pose"] if locating else [],
    }
    clock = {"use_sim_time": bool(bag)}
    if bag:  # all publishers are our own and reliable, so nothing need be lost
        images = [f"{s}/{kind}" for s in ("left", "right") for kind in ("image_raw", "camera_info")]
        range_parameters |= reliable_inputs(images, given["namespace"])
        clouds = ("points2", "camera_pose", "joint_states")
        fusion_parameters |= reliable_inputs(clouds, given["namespace"])
        inputs = reliable_inputs([*images, "odom", "joint_states"], given["namespace"])
        locating = {name: parameters | inputs for name, parameters in locating.items()}
    processes = [
        node("stereo_range", range_parameters | clock),
        node("map_fusion", fusion_parameters | clock),
    ]
    processes += [node(name, parameters | clock) for name, parameters in locating.items()]
    if bag:
        processes.append(node("bag_player", player_parameters))
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


def _locating(given: dict[str, str]) -> dict[str, dict]:
    """The node that locates the camera, with its parameters; none where others do."""
    seeing = {"source": given["source"], "rectify": given["rectify"] == "true"}
    choices = {"fiducials": {"fiducial_localization": seeing}, "odometry": {"dead_reckoning": {}}}
    return choices.get(given["localisation"], {})
