"""The wheel holds all that a user needs: the tutorial's bag maps from it, elsewhere than here."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
SOURCES = ("setup.py", "setup.cfg", "package.xml", "pyproject.toml", "README.md")
FOLDERS = ("infomap_ros", "config", "launch", "bags", "resource")


def run(*command: object, folder: Path) -> str:
    # where it points to this checkout, nothing would be learned of the wheel
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([*map(str, command)], cwd=folder, env=env, text=True, capture_output=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel; other packages are those of this one, this checkout is not."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in SOURCES:
        shutil.copy(REPOSITORY / name, source)
    for name in FOLDERS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / name, source / name, ignore=ignored)
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    run(*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", folder, source, folder=folder)
    (wheel,) = folder.glob("infomap_ros-*.whl")
    venv.create(folder / "env", symlinks=True)
    python = folder / "env" / "bin" / "python"
    own = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))",
                   folder=folder).strip())  # fmt: skip
    # the paths without the .pth files in them, of which one would lead to this checkout
    shared = [path for path in sys.path if path.startswith(sysconfig.get_path("purelib"))]
    (own / "shared.pth").write_text("\n".join(shared) + "\n")
    run(*pip, "--python", python, "install", "--no-deps", "--no-index", wheel, folder=folder)
    return folder


def test_the_tutorials_bag_maps_from_the_wheel(installed: Path) -> None:
    env, out = installed / "env", installed / "out"
    place = run(env / "bin" / "python", "-c", "import infomap_ros; print(infomap_ros.__file__)",
                folder=installed)  # fmt: skip
    assert place.startswith(str(env))
    bag = env / "share" / "infomap_ros" / "bags" / "rover_rocks"
    printed = run(env / "bin" / "infomap", "map", bag, "--out", out, "--voxel-size", 0.2,
                  folder=installed)  # fmt: skip
    assert json.loads(printed)["frames"] == 34
    assert (out / "map.html").stat().st_size > 50_000


def test_the_wheel_holds_what_is_read_at_run_time(installed: Path) -> None:
    share = installed / "env" / "share" / "infomap_ros"
    assert (share / "config" / "rover.urdf").is_file()
    assert list((share / "launch").glob("*.launch.py"))
    said = run(installed / "env" / "bin" / "infomap", "--version", folder=installed)
    assert said.startswith("infomap_ros ")
