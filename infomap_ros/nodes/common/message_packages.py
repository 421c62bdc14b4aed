"""Builds the message packages that the wheels of ROS 2 lack, where ROS 2 comes from wheels.

``python -m infomap_ros.nodes.common.message_packages`` builds those of `PACKAGES` that cannot be
imported: a ROS installation brings its own, and a second run finds the first one's. It generates
each with the interface generators of ROS, compiles it (about half a minute on one core) and
installs it into the virtual environment that runs it. The nodes work without them, but for tf
(tf2_msgs), for the actions of robot_driver (control_msgs, nav2_msgs), for detections of tags
(apriltag_msgs) and for OctoMap (octomap_msgs). The interfaces are those of ROS 2 Jazzy, and of each
package those that this one uses.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from infomap_ros.errors import ResourceError


@dataclass(frozen=True)
class MessagePackage:
    """A package of ROS interfaces.

    Attributes:
        name: of the package.
        version: the one whose interfaces these are.
        depends: packages whose messages it uses.
        interfaces: file below the package: definition.
    """

    name: str
    version: str
    depends: tuple[str, ...]
    interfaces: dict[str, str]


PACKAGES = (
    MessagePackage(
        "tf2_msgs",
        "0.36.0",
        ("geometry_msgs",),
        {"msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"},
    ),
    MessagePackage(
        "control_msgs",
        "5.8.0",
        ("action_msgs", "builtin_interfaces", "std_msgs", "trajectory_msgs"),
        {
            "msg/JointTolerance.msg": """\
string name
float64 position
float64 velocity
float64 acceleration
""",
            "msg/JointComponentTolerance.msg": """\
uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
""",
            "action/FollowJointTrajectory.action": """\
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
        },
    ),
    MessagePackage(
        "nav2_msgs",
        "1.3.13",
        ("action_msgs", "builtin_interfaces", "geometry_msgs", "nav_msgs", "std_msgs"),
        {
            "action/FollowPath.action": """\
nav_msgs/Path path
string controller_id
string goal_checker_id
string progress_checker_id
---
uint16 NONE=0
uint16 UNKNOWN=100
uint16 INVALID_CONTROLLER=101
uint16 TF_ERROR=102
uint16 INVALID_PATH=103
uint16 PATIENCE_EXCEEDED=104
uint16 FAILED_TO_MAKE_PROGRESS=105
uint16 NO_VALID_CONTROL=106
uint16 CONTROLLER_TIMED_OUT=107
std_msgs/Empty result
uint16 error_code
string error_msg
---
float32 distance_to_goal
float32 speed
""",
            "action/NavigateThroughPoses.action": """\
geometry_msgs/PoseStamped[] poses
string behavior_tree
---
uint16 NONE=0
uint16 error_code
string error_msg
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
int16 number_of_poses_remaining
""",
        },
    ),
    MessagePackage(
        "apriltag_msgs",
        "2.0.1",
        ("std_msgs",),
        {
            "msg/Point.msg": "float64 x\nfloat64 y\n",
            "msg/AprilTagDetection.msg": """\
string family
int32 id
int32 hamming
float32 goodness
float32 decision_margin
Point centre
Point[4] corners
float64[9] homography
""",
            "msg/AprilTagDetectionArray.msg": """\
std_msgs/Header header
AprilTagDetection[] detections
""",
        },
    ),
    MessagePackage(
        "octomap_msgs",
        "2.0.1",
        ("geometry_msgs", "std_msgs"),
        {
            "msg/Octomap.msg": """\
std_msgs/Header header
bool binary
string id
float64 resolution
int8[] data
""",
            "srv/GetOctomap.srv": "---\noctomap_msgs/Octomap map\n",
            "srv/BoundingBoxQuery.srv": """\
geometry_msgs/Point min
geometry_msgs/Point max
---
""",
        },
    ),
)
_CMAKE = """\
cmake_minimum_required(VERSION 3.12)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
foreach(dependency {depends})
  find_package(${{dependency}} REQUIRED)
endforeach()
rosidl_generate_interfaces({name} {files} DEPENDENCIES {depends})
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
_PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>{version}</version>
  <description>Interfaces of {name} that infomap_ros uses.</description>
  <maintainer email="maintainers@infomap-ros.example.org">infomap_ros maintainers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  {depends}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
# The wheels' CMake files name the include folders of the machine that built them.
_BUILD_MACHINE_NUMPY = re.compile(r"/opt/python/[^/;\"]+/lib/[^;\"]*/numpy/(?:_core|core)/include")
_BUILD_MACHINE_PYTHON = re.compile(r"/opt/python/[^/;\"]+/include/python[0-9.]+")


def missing_tools() -> list[str]:
    """What has to be installed before a package can be built: Debian packages and extras."""
    missing = []
    if shutil.which("c++") is None or shutil.which("cc") is None:
        missing.append("g++")
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        missing.append("python3-dev")
    if shutil.which("make") is None:
        missing.append("make")
    if shutil.which("cmake", path=_search_path()) is None:
        missing.append("cmake")
    if not Path(sys.prefix, "share", "rosidl_default_generators").is_dir():
        missing.append("infomap_ros[tf2] (with pip)")
    return missing


def build(packages: Sequence[MessagePackage], prefix: Path | None = None) -> None:
    """Generate, compile and install packages.

    Args:
        packages: which.
        prefix: where to; the virtual environment of this process where not given.

    Raises:
        ResourceError: this is no virtual environment, a tool is missing, or a step failed, with
            the end of its output.
    """
    names = ", ".join(package.name for package in packages)
    if sys.prefix == sys.base_prefix:
        raise ResourceError(f"{names}: built into virtual environments only, and this is none")
    if missing := missing_tools():
        raise ResourceError(f"{names}: cannot be built without {', '.join(missing)}")
    _point_wheels_here(Path(sys.prefix))
    for package in packages:
        print(f"building {package.name}, about half a minute", flush=True)
        _build(package, prefix or Path(sys.prefix))


def main() -> None:
    """Build what is not there; ends with status 1 and one line where it cannot."""
    absent = [package for package in PACKAGES if find_spec(package.name) is None]
    try:
        if absent:
            build(absent)
    except ResourceError as error:
        sys.exit(str(error))


def _build(package: MessagePackage, prefix: Path) -> None:
    with tempfile.TemporaryDirectory(prefix=f"{package.name}-") as folder:
        for name, text in _sources(package).items():
            path = Path(folder, name)
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        _run("cmake", "-S", folder, "-B", f"{folder}/build", *_settings(prefix))
        _run("cmake", "--build", f"{folder}/build", "--parallel", str(os.cpu_count() or 1))
        _run("cmake", "--install", f"{folder}/build")


def _sources(package: MessagePackage) -> dict[str, str]:
    """Files of the package: path below its folder: text."""
    files = " ".join(f'"{name}"' for name in package.interfaces)
    depends = "\n  ".join(f"<depend>{name}</depend>" for name in package.depends)
    return {
        **package.interfaces,
        "CMakeLists.txt": _CMAKE.format(
            name=package.name, files=files, depends=" ".join(package.depends)
        ),
        "package.xml": _PACKAGE_XML.format(
            name=package.name, version=package.version, depends=depends
        ),
    }


def _settings(prefix: Path) -> tuple[str, ...]:
    site_packages = Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
    return (
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DCMAKE_INSTALL_PREFIX={prefix}",
        f"-DPYTHON_INSTALL_DIR={site_packages}",
        f"-DPython3_EXECUTABLE={sys.executable}",
        "-DBUILD_TESTING=OFF",
    )


def _search_path() -> str:
    """The environment's own programs first."""
    return os.pathsep.join((str(Path(sys.prefix, "bin")), os.environ.get("PATH", os.defpath)))


def _run(*command: str) -> None:
    prefixes = dict.fromkeys(("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"), sys.prefix)
    environment = {**os.environ, **prefixes, "PATH": _search_path()}
    program = shutil.which(command[0], path=environment["PATH"])
    done = subprocess.run(
        [program or command[0], *command[1:]],
        env=environment,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode != 0:
        end = "\n".join(done.stdout.splitlines()[-30:])
        raise ResourceError(f"{' '.join(command[:2])} failed:\n{end}")


def _point_wheels_here(prefix: Path) -> None:
    """Replace the include folders of the wheels' build machine by those of this Python."""
    import numpy as np

    python_include = sysconfig.get_path("include")
    for path in prefix.glob("share/*/cmake/*.cmake"):
        text = path.read_text(encoding="utf-8")
        if "/opt/python/" in text:
            text = _BUILD_MACHINE_NUMPY.sub(np.get_include(), text)
            path.write_text(_BUILD_MACHINE_PYTHON.sub(python_include, text), encoding="utf-8")


if __name__ == "__main__":
    main()
