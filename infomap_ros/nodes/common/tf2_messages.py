"""Builds ``tf2_msgs/msg/TFMessage`` where ROS 2 comes from wheels, which lack that package.

``python -m infomap_ros.nodes.common.tf2_messages`` does nothing where tf2_msgs can be imported: a
ROS installation brings its own, and a second run finds the first one's. Else it generates the
package with the interface generators of ROS, compiles it (about 25 s on one core) and installs it
into the virtual environment that runs it. The nodes work without it, except that they publish no
tf.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from importlib.util import find_spec
from pathlib import Path

from infomap_ros.errors import ResourceError

_SOURCES = {
    "msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n",
    "CMakeLists.txt": """\
cmake_minimum_required(VERSION 3.12)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(tf2_msgs "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
""",
    "package.xml": """\
<?xml version="1.0"?>
<package format="3">
  <name>tf2_msgs</name>
  <version>0.36.0</version>
  <description>The message of /tf and /tf_static.</description>
  <maintainer email="maintainers@infomap-ros.example.org">infomap_ros maintainers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
""",
}
# The wheels' CMake files name the include folders of the machine that built them.
_BUILD_MACHINE_NUMPY = re.compile(r"/opt/python/[^/;\"]+/lib/[^;\"]*/numpy/(?:_core|core)/include")
_BUILD_MACHINE_PYTHON = re.compile(r"/opt/python/[^/;\"]+/include/python[0-9.]+")


def missing_tools() -> list[str]:
    """What has to be installed before tf2_msgs can be built: Debian packages and extras."""
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


def build() -> None:
    """Generate, compile and install tf2_msgs into the virtual environment of this process.

    Raises:
        ResourceError: this is no virtual environment, a tool is missing, or a step failed, with
            the end of its output.
    """
    if sys.prefix == sys.base_prefix:
        raise ResourceError("tf2_msgs is built into virtual environments only, and this is none")
    if missing := missing_tools():
        raise ResourceError(f"tf2_msgs cannot be built without: {', '.join(missing)}")
    print("building tf2_msgs, about half a minute", flush=True)
    _point_wheels_here(Path(sys.prefix))
    with tempfile.TemporaryDirectory(prefix="tf2_msgs-") as folder:
        for name, text in _SOURCES.items():
            path = Path(folder, name)
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        _run("cmake", "-S", folder, "-B", f"{folder}/build", *_settings())
        _run("cmake", "--build", f"{folder}/build", "--parallel", str(os.cpu_count() or 1))
        _run("cmake", "--install", f"{folder}/build")


def main() -> None:
    """Build tf2_msgs unless it is there; ends with status 1 and one line where it cannot."""
    if find_spec("tf2_msgs") is not None:
        return
    try:
        build()
    except ResourceError as error:
        sys.exit(str(error))


def _settings() -> tuple[str, ...]:
    site_packages = Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
    return (
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DCMAKE_INSTALL_PREFIX={sys.prefix}",
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
        raise ResourceError(f"tf2_msgs: {' '.join(command[:2])} failed:\n{end}")


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
