from __future__ import annotations

import sys

import mujoco
import pytest

from infomap_ros import simulation as backend
from infomap_ros.errors import SimulationError
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.worlds.builder import World


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """An environment in which nothing has been chosen and MuJoCo is not imported yet."""
    monkeypatch.setenv("MUJOCO_GL", "")
    monkeypatch.delitem(sys.modules, "mujoco")
    monkeypatch.setattr(sys, "platform", "linux")
    return monkeypatch


@pytest.mark.parametrize(
    ("egl", "osmesa", "chosen"),
    [(True, True, "egl"), (False, True, "osmesa"), (False, False, "")],
)
def test_prefers_egl_then_osmesa(
    fresh: pytest.MonkeyPatch, egl: bool, osmesa: bool, chosen: str
) -> None:
    fresh.setattr(backend, "egl_works", lambda: egl)
    fresh.setattr(backend, "osmesa_works", lambda: osmesa)
    assert backend.select_backend() == chosen
    assert backend.os.environ["MUJOCO_GL"] == chosen


def test_the_users_choice_stays(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("MUJOCO_GL", "glfw")
    assert backend.select_backend() == "glfw"


def test_a_missing_library_is_not_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_load", lambda name: None)
    assert not backend.egl_works()
    assert not backend.osmesa_works()


def test_failure_names_the_debian_packages(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise ImportError("Cannot initialize a EGL device display")

    monkeypatch.setattr(mujoco, "Renderer", fail)
    with pytest.raises(SimulationError, match=r"libegl1 libegl-mesa0.*libosmesa6"):
        Renderer(world.model, 64, 48)


def test_warnings_of_mujoco_leave_no_file_behind(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    description = """<robot name="r"><link name="a"/><link name="b"/>
        <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="0.5" upper="0.5" effort="1" velocity="1"/></joint></robot>"""
    with caplog.at_level("DEBUG"):
        mujoco.MjSpec.from_string(description)
    assert "equal lower and upper limits" in caplog.text
    assert list(tmp_path.iterdir()) == []
