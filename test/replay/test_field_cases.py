"""Files of other people's recorders, cameras and robots, each with one odd thing."""

from __future__ import annotations

import runpy
import tarfile
from pathlib import Path

import pytest

from infomap_ros.errors import CalibrationError, RobotModelError
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.sequences.calibration_files import read_calibration


@pytest.fixture
def cases(real_data: Path) -> Path:
    return real_data / "field_cases"


def unpacked(cases: Path, name: str, folder: Path) -> Path:
    with tarfile.open(cases / f"{name}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    (path,) = folder.iterdir()
    return path


@pytest.mark.parametrize(
    ("name", "frames", "told"),
    [
        ("joints_nan_passive", 4, ""),
        ("mesh_elsewhere", 4, "mesh"),
        ("short_types", 4, ""),
        ("depth_camera_named", 3, ""),
        ("hands_and_depth", 3, "are no stereo pair"),
    ],
)
def test_a_recording_is_mapped(
    cases: Path, tmp_path: Path, name: str, frames: int, told: str
) -> None:
    with BagReader(unpacked(cases, name, tmp_path)) as bag:
        run = MapRun(bag, MapOptions())
        run.run()
        assert told in " ".join(bag.problems)
    summary = run.summary()
    assert (summary["frames"], summary["frames_dropped"]) == (frames, 0)
    assert run.map.known_voxels > 1000


def test_the_folder_gives_what_its_file_gives(cases: Path, tmp_path: Path) -> None:
    folder = unpacked(cases, "rosbag2_talker", tmp_path)
    for path in (folder, *folder.glob("*.db3")):
        with BagReader(path) as bag:
            assert len(list(bag.messages(["/topic"]))) == 10


def test_types_that_are_not_used_need_not_be_understood(cases: Path) -> None:
    with BagReader(cases / "topics_and_services.mcap") as bag:
        assert len(list(bag.messages())) > 0
        told = "definition of example_interfaces/srv/AddTwoInts_Event cannot be read"
        assert [problem.partition(" ")[0] for problem in bag.problems if told in problem] == [
            "/add_two_ints/_service_event",
            "/add_two_ints2/_service_event",
        ]


def test_images_under_a_short_type_are_decoded(cases: Path) -> None:
    with BagReader(cases / "soccer_goal_12.mcap") as bag:
        assert len(list(bag.records(["/camera/image_raw"]))) == 2


def test_a_camera_that_is_no_pinhole_is_named(cases: Path) -> None:
    with pytest.raises(CalibrationError, match="camera_model 'omni' is not supported, pinhole is"):
        read_calibration([cases / "kalibr_omni.yaml"], (640, 480))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("X", "must be positive"),  # a box of no size
        ("G", ""),  # a prefix that nothing binds
        ("M", "base.stl"),
    ],
)
def test_odd_descriptions_are_used_without_what_cannot_be_had(
    cases: Path, text: str, told: str
) -> None:
    robot = RobotModel.from_urdf(runpy.run_path(str(cases / "urdf_texts.py"))[text])
    assert told in " ".join(robot.left_out)


@pytest.mark.parametrize("text", ["E", "F"])
def test_a_limit_that_is_none_names_its_joint(cases: Path, text: str) -> None:
    described = runpy.run_path(str(cases / "urdf_texts.py"))[text]
    with pytest.raises(RobotModelError, match="joint 'j'"):
        RobotModel.from_urdf(described)
