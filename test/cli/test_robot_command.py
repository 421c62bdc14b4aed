"""``infomap robot`` writes a file and a drawing of a robot, and replaces none unasked."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import pytest
import yaml

from infomap_ros import cli
from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.robots.robot_file import RobotFile


def failure_of(*arguments: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Why the command could not be done; empty where it was."""
    monkeypatch.setattr(sys, "argv", ["infomap", "robot", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return str(end.value.code or "")


def test_the_rover_is_understood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf, out = str(find_share("config/rover.urdf")), tmp_path / "new" / "rover.yaml"

    assert failure_of(urdf, "--out", str(out), monkeypatch=monkeypatch) == ""
    said, text = capsys.readouterr().out, out.read_text("utf-8")
    section = yaml.safe_load(text)["/**"]["ros__parameters"]
    drawing = cv2.imread(str(out.with_suffix(".png")))

    assert len(text.splitlines()) <= 15
    assert RobotFile.read(out).setup.arm_joints
    assert all("wheel" in joint for joint in section["robot.left_wheels"])
    assert text.count("GUESSED") == 1, "its description says all but the controllers"
    assert section["controllers"] == [f"arm_controller: {' '.join(section['arm_joints'])}"]
    assert "Understood" in said
    assert drawing is not None
    assert drawing.std() > 10.0
    assert "--overwrite" in failure_of(urdf, "--out", str(out), monkeypatch=monkeypatch)


@pytest.mark.parametrize(
    ("urdf", "out", "named"),
    [
        ("no/such.urdf", "robot.yaml", "no/such.urdf"),
        (str(find_share("config/rover.urdf")), "robot.txt", "--out"),
        ("package://nobody_has_this/a.urdf", "robot.yaml", "nobody_has_this"),
        ("no/such.urdf", "/proc/robot.yaml", "cannot write to /proc"),  # said before any work
    ],
)
def test_what_cannot_be_used_is_named(
    urdf: str,
    out: str,
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert named in failure_of(urdf, "--out", str(tmp_path / out), monkeypatch=monkeypatch)
    assert not list(tmp_path.iterdir())
