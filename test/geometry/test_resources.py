from __future__ import annotations

from pathlib import Path

import pytest

from infomap_ros.errors import ResourceError
from infomap_ros.geometry import resources
from infomap_ros.geometry.resources import find_share


def test_finds_the_robot_description() -> None:
    assert find_share("config/rover.urdf").read_text().startswith("<?xml")


def test_finds_a_file_of_an_installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = tmp_path / "overlay" / "share" / "infomap_ros" / "config" / "only_installed.yaml"
    installed.parent.mkdir(parents=True)
    installed.write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'empty'}:{tmp_path / 'overlay'}")
    assert find_share("config/only_installed.yaml") == installed.resolve()


def test_first_prefix_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("overlay", "underlay"):
        folder = tmp_path / name / "share" / "infomap_ros"
        folder.mkdir(parents=True)
        (folder / "which.txt").write_text(name)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'overlay'}:{tmp_path / 'underlay'}")
    assert find_share("which.txt").read_text() == "overlay"


def test_finds_beside_a_package_installed_under_another_prefix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "lib" / "python3.11" / "site-packages" / "infomap_ros"
    (tmp_path / "share" / "infomap_ros").mkdir(parents=True)
    (tmp_path / "share" / "infomap_ros" / "here.txt").write_text("")
    monkeypatch.setattr(resources.infomap_ros, "__file__", str(package / "__init__.py"))
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert find_share("here.txt") == tmp_path / "share" / "infomap_ros" / "here.txt"


def test_missing_file_names_the_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(ResourceError, match=str(tmp_path)):
        find_share("config/no_such_file.yaml")


def test_absolute_path_is_refused() -> None:
    with pytest.raises(ResourceError, match="/etc is absolute"):
        find_share("/etc")
    with pytest.raises(ResourceError, match=r"there$"):
        find_share("/no/such.urdf")
