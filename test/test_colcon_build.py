"""colcon makes a ROS package of the repository, and pip an installation with a command on PATH."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXECUTABLES = {
    "bag_player",
    "dead_reckoning",
    "explorer",
    "fiducial_localization",
    "infomap",
    "map_fusion",
    "next_best_view",
    "robot_driver",
    "simulator",
    "stereo_range",
}
# Prints where an installed package finds itself and its files.
WHERE = """
import infomap_ros, pathlib
from infomap_ros.geometry.resources import find_share
print(pathlib.Path(infomap_ros.__file__).resolve(), find_share("config/fastdds.xml"), sep="\\n")
"""


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    """Output of a command that has to succeed, in an environment without other ROS packages."""
    hidden = {"AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE"}
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**kept, **variables},
        check=False,
        capture_output=True,
        text=True,
        timeout=120.0,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def in_workspace(workspace: Path, command: str) -> str:
    """Output of a shell command after sourcing the workspace."""
    return run("sh", "-c", f". install/local_setup.sh && {command}", cwd=workspace)


@pytest.fixture
def workspace(package_copy: Path) -> Path:
    """A ROS workspace in which the package is built."""
    workspace = package_copy.parent.parent
    run(sys.executable, "-m", "colcon", "--log-base", "log", "build", cwd=workspace)
    return workspace


def test_colcon_makes_a_ros_package(workspace: Path) -> None:
    prefix = workspace / "install" / "infomap_ros"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages" / "infomap_ros"
    assert index.is_file()
    assert (prefix / "share" / "infomap_ros" / "package.xml").is_file()
    executables = {path.name for path in (prefix / "lib" / "infomap_ros").iterdir()}
    assert executables >= EXECUTABLES


def test_the_workspace_names_the_package_to_ros(workspace: Path) -> None:
    query = "from ament_index_python import get_package_prefix as f; print(f('infomap_ros'))"
    found = in_workspace(workspace, f'"{sys.executable}" -c "{query}"')
    assert Path(found.strip()) == workspace / "install" / "infomap_ros"


def test_executables_of_the_workspace_run_its_own_code(workspace: Path) -> None:
    executable = workspace / "install" / "infomap_ros" / "lib" / "infomap_ros" / "infomap"
    assert "Usage" in in_workspace(workspace, f'"{executable}" --help')
    (workspace / "where.py").write_text(WHERE, encoding="utf-8")
    found = in_workspace(workspace, f'"{sys.executable}" where.py').split()
    prefix = workspace / "install" / "infomap_ros"
    assert [Path(place).is_relative_to(prefix) for place in found] == [True, True]


def test_colcon_links_the_sources_on_request(package_copy: Path) -> None:
    workspace = package_copy.parent.parent
    colcon = (sys.executable, "-m", "colcon", "--log-base", "log", "build", "--symlink-install")
    run(*colcon, cwd=workspace)
    share = workspace / "install" / "infomap_ros" / "share" / "infomap_ros"
    installed = {path.relative_to(share) for path in share.rglob("*") if path.is_symlink()}
    for folder in ("config", "launch", "bags"):
        expected = {path.relative_to(package_copy) for path in (package_copy / folder).rglob("*.*")}
        assert expected <= installed


def test_pip_puts_the_command_on_the_path(package_copy: Path, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--prefix", prefix)
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--ignore-installed")
    run(*pip, *options, package_copy, cwd=tmp_path)
    scripts = {path.name for path in (prefix / "bin").iterdir()}
    assert scripts >= EXECUTABLES
    assert (prefix / "share" / "ament_index/resource_index/packages/infomap_ros").is_file()
    assert (prefix / "share" / "infomap_ros" / "config" / "fastdds.xml").is_file()
