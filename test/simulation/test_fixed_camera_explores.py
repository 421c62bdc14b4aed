"""A robot whose camera is fixed on its base explores by the file that `infomap robot` writes."""

from __future__ import annotations

from pathlib import Path

from infomap_ros.cli.command_options import with_settings
from infomap_ros.cli.robot_command import robot
from infomap_ros.exploration.loop import EndReason
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_log import Progress
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.robots.robot_file import RobotFile
from test.motion.test_fixed_camera import fixed_rover

SETTINGS = (
    "world.name=office",
    "world.size=5",
    "task.max_views=3",
    "robot.pose_source=simulator",
    "robot.images_while_moving=false",
)


def test_it_drives_to_its_views(tmp_path: Path) -> None:
    (tmp_path / "fixed.urdf").write_text(fixed_rover())
    robot(str(tmp_path / "fixed.urdf"), tmp_path / "fixed.yaml")
    own = RobotFile.read(tmp_path / "fixed.yaml").settings
    run = ExplorationRun(with_settings(ExplorationOptions(), (*own, *SETTINGS)), tmp_path)
    ending = run.run()
    run.close()
    assert ending.reason is EndReason.BUDGET_SPENT, ending.detail
    assert run.simulator.contact_events == ()
    log = read_run(tmp_path / "exploration.jsonl")
    assert log.problems == ()
    progress = log.of(Progress)
    assert progress[-1].distance > 0.3
    assert progress[-1].known_fraction > progress[0].known_fraction + 0.2
