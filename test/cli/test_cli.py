"""The command line: results where they were asked for, one line when it could not."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from types import UnionType
from typing import get_args

import numpy as np
import pytest

import infomap_ros
from infomap_ros import cli
from infomap_ros.cli import study_commands as studies
from infomap_ros.cli.results import results_in
from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap

from ..replay.scenes import START, STEP, depth_frames, fill_after, write


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command; returns exit status, standard output and standard error."""

    def command(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["infomap", *(str(a) for a in arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        error = captured.err
        status = ended.value.code
        if isinstance(status, str):  # what the interpreter prints when it exits with a text
            error, status = error + status + "\n", 1
        return int(status or 0), captured.out, error

    return command


def test_map_leaves_everything_beside_its_summary(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    status, out, _ = run("map", bag, "--out", tmp_path / "out", "--voxel-size", 0.1)
    assert status == 0
    summary = json.loads(out)
    assert summary == json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames"] == 6
    assert summary["seconds"] > 0
    assert summary["memory_bytes"] > 1000
    assert all(not isinstance(value, (dict, list)) for value in summary.values())
    names = {"map.infomap", "map.ply", "map.png", "map.html"}
    names |= {"depth.png", "sigma.png", "summary.json"}
    assert names == {path.name for path in (tmp_path / "out").iterdir()}
    loaded = VoxelMap.load(tmp_path / "out" / "map.infomap")
    assert loaded.known_voxels == summary["known_voxels"]
    assert loaded.config.voxel_size == 0.1


def test_map_with_given_topics_and_settings(tmp_path, run):
    entries = [(f"/rig{topic}", record) for topic, record in depth_frames()]
    bag = write(tmp_path / "bag", entries)
    status, out, _ = run(
        "map", bag, "--out", tmp_path / "out", "--depth", "/rig/depth/image_rect",
        "--pose-topic", "/rig/camera_pose", "--max-range", 1.8, "--set", "map.threads=2",
    )  # fmt: skip
    assert status == 0
    assert json.loads(out)["frames"] == 6


def test_points_that_are_too_far_for_the_map_are_told(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    arguments = ("map", bag, "--out", tmp_path / "out")
    assert "beyond" not in run(*arguments)[2]
    said = run(*arguments, "--overwrite", "--max-range", 1.6)[2]
    assert "of the points are beyond 1.6 m" in said
    again = said.partition("try ")[2].partition(" (")[0].split()
    assert again[::2] == ["--max-range", "--voxel-size"]
    assert "points are beyond" not in run(*arguments, "--overwrite", *again)[2]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["map", "{tmp}/nothing", "--out", "{tmp}/out"], "there is no bag"),
        (["map", "{bag}", "--out", "{tmp}/out", "--voxel-size", "-1"], "--voxel-size is -1.0"),
        (["map", "{bag}", "--out", "{tmp}/out", "--set", "map.size=1"], "map.voxel_size"),
        (
            ["map", "{bag}", "--out", "{tmp}/out", "--set", "map.voxel_sze=1"],
            "--set is 'map.voxel_sze', expected the name of a setting (listed by --settings); did "
            "you mean map.voxel_size",
        ),
        (["map", "{bag}", "--out", "{tmp}/out", "--set", "foo"], "--set is 'foo'"),
        (
            ["map", "{bag}", "--out", "{tmp}/out", "--set", "map.threads=-1"],
            "--set map.threads is -1",
        ),
        (["explore", "--out", "{tmp}/out", "--world", "moon"], "--world is 'moon'"),
        (["explore", "--out", "{tmp}/file"], "--out: cannot write to"),
        (["explore", "--out", "/proc/foo"], "--out: cannot write to /proc/foo"),
        (["explore", "--out", "{tmp}/out", "--strategy", "thrifty"], "--strategy is 'thrifty'"),
        (["map", "{bag}", "--out", "{tmp}/out", "--source", "stereo"], "no stereo pair"),
        (["map", "{bag}", "--out", "{tmp}/out", "--pose-topic", "/x"], "/x"),
        (["map", "{bag}", "--out", "{tmp}/file"], "file"),
        (["show", "{tmp}/file"], "file"),
        (["convert", "nothing", "{tmp}", "{tmp}/out"], "rgbd"),
        (["convert", "rgbd", "{tmp}/nothing", "{tmp}/out"], "no folder"),
        (["calibrate-noise", "{tmp}", "--out", "{tmp}/out"], ""),
    ],
)
def test_failure_is_one_clear_line_and_a_status(tmp_path, run, arguments, said):
    bag = write(tmp_path / "bag", depth_frames(2))
    (tmp_path / "file").write_text("not a map")
    status, out, error = run(*(a.format(tmp=tmp_path, bag=bag) for a in arguments))
    assert status == 1
    assert out == ""
    lines = error.strip().splitlines()
    assert len(lines) == 1, error
    assert lines[0].startswith("infomap: ")
    assert said in lines[0]


def test_damaged_bag_is_mapped_and_told(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    (bag / "metadata.yaml").unlink()
    status, out, error = run("map", bag, "--out", tmp_path / "out")
    assert status == 0
    assert json.loads(out)["frames"] == 6
    assert "metadata.yaml" in error


def test_full_map_is_written_and_the_status_tells(tmp_path, run, monkeypatch):
    fill_after(monkeypatch, frames=2)
    bag = write(tmp_path / "bag", depth_frames())
    status, out, error = run("map", bag, "--out", tmp_path / "out")
    assert status == 1
    assert "the map is full" in error
    assert json.loads(out)["frames"] == 2
    assert (tmp_path / "out" / "map.infomap").exists()


def test_show_prints_and_draws(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    run("map", bag, "--out", tmp_path / "out")
    picture = tmp_path / "picture.png"
    status, out, _ = run("show", tmp_path / "out" / "map.infomap", "--out", picture)
    figures = json.loads(out)
    assert status == 0
    assert picture.stat().st_size > 1000
    low, high = np.array(figures["low"]), np.array(figures["high"])
    assert (low < [2.0, 0.0, 0.0]).all()
    assert (high > [2.0, 0.0, 0.0]).all()


def test_show_draws_what_a_camera_sees(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    run("map", bag, "--out", tmp_path / "out")
    picture, map_file = tmp_path / "picture.png", tmp_path / "out" / "map.infomap"
    pose = "0 0 0 -0.5 0.5 -0.5 0.5"  # along x
    status, out, _ = run("show", map_file, "--out", picture, "--from", pose)
    figures = json.loads(out)
    assert status == 0
    assert (tmp_path / "picture_depth.png").stat().st_size > 1000
    assert figures["depth_picture"] == str(tmp_path / "picture_depth.png")
    assert 0.0 < figures["seen_share"] <= 1.0
    assert figures["median_depth"] == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("pose", ["1 2 3", "0 0 0 0 0 0 north", "0 0 0 0 0 0 0"])
def test_show_refuses_what_is_no_pose(tmp_path, run, pose):
    bag = write(tmp_path / "bag", depth_frames())
    run("map", bag, "--out", tmp_path / "out")
    status, _, error = run("show", tmp_path / "out" / "map.infomap", "--from", pose)
    assert status == 1
    assert len(error.strip().splitlines()) == 1


def test_settings_are_listed(tmp_path, run):
    status, out, _ = run("map", "--settings")
    assert status == 0
    (line,) = [line for line in out.splitlines() if line.startswith("map.voxel_size=")]
    assert line == "map.voxel_size=0.05  [m, 0.0001 to 10]  Edge length of a voxel."


@pytest.mark.parametrize("command", ["localize", "explore", "calibrate-noise"])
def test_settings_of_every_command_are_listed(run, command):
    status, out, _ = run(command, "--settings")
    assert status == 0
    assert all("=" in line for line in out.splitlines())


def test_version_is_said(run):
    status, out, _ = run("--version")
    assert (status, out) == (0, f"infomap_ros {infomap_ros.__version__}\n")


def test_results_of_another_run_are_not_overwritten_unasked(tmp_path, run):
    bag, out = write(tmp_path / "bag", depth_frames(2)), tmp_path / "out"
    assert run("map", bag, "--out", out)[0] == 0
    status, _, error = run("map", bag, "--out", out)
    assert (status, "--overwrite" in error) == (1, True)
    assert run("map", bag, "--out", out, "--overwrite")[0] == 0


def test_two_runs_in_one_folder_are_refused(tmp_path):
    refused = pytest.raises(InvalidInputError, match="another run is at work")
    with results_in(tmp_path), refused, results_in(tmp_path):
        pass


def test_a_failed_run_leaves_no_folder(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames(2))
    assert run("map", bag, "--out", tmp_path / "a" / "b", "--pose-topic", "/x")[0] == 1
    assert not (tmp_path / "a").exists()


def test_most_frames_dropped_is_a_failure_with_its_cause(tmp_path, run):
    entries = [
        (topic, record)
        for topic, record in depth_frames(6)
        if topic != "/camera_pose" or record.stamp <= START + STEP
    ]
    bag = write(tmp_path / "bag", entries)
    status, out, error = run("map", bag, "--out", tmp_path / "out")
    assert status == 1
    assert json.loads(out)["frames"] == 2
    assert "4 of 6 frames dropped" in error
    assert "Likely cause: poses and images have different clocks" in error


def test_a_person_is_told_which_file_to_open(tmp_path, run, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    bag = write(tmp_path / "bag", depth_frames())
    status, out, _ = run("map", bag, "--out", tmp_path / "out")
    assert status == 0
    lines = out.splitlines()
    assert lines[0].startswith("6 of 6 frames mapped in ")
    (first,) = [line for line in lines if "open this first" in line]
    assert str(tmp_path / "out" / "map.html") in first
    assert "{" not in out


@pytest.mark.parametrize(
    "command", [*(n for n in cli.COMMANDS if n != "study"), "record-demo-bag", "doctor"]
)
def test_every_command_explains_itself_with_an_example(run, command):
    status, out, _ = run(command, "--help")
    assert status == 0
    assert "sage" in out
    assert f"infomap {command} " in " ".join(out.partition("Example:")[2].split())


LATE = [*cli.COMMANDS.values(), *studies.COMMANDS.values()]
LATE_FUNCTIONS = [command for command in LATE if command.load() is not studies.app]


@pytest.mark.parametrize("command", LATE, ids=lambda command: command.place)
def test_the_list_of_commands_says_what_they_say_themselves(command):
    loaded = command.load()
    if loaded is studies.app:
        assert command.help == loaded.info.help
    else:
        assert command.help == inspect.getdoc(loaded).splitlines()[0]


@pytest.mark.parametrize("command", LATE_FUNCTIONS, ids=lambda command: command.place)
def test_options_are_written_as_the_oldest_typer_reads_them(command):
    for name, hint in inspect.get_annotations(command.load()).items():
        assert not isinstance(hint, str), "from __future__ import annotations hides Annotated"
        assert not isinstance(next(iter(get_args(hint)), hint), UnionType), (
            f"{name} should be Optional"
        )


@pytest.mark.parametrize("arguments", [["--help"], ["study", "--help"]])
def test_the_list_of_commands_loads_none_of_them(arguments):
    program = (
        "import sys, infomap_ros.cli as cli\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        "print({'numba', 'scipy', 'mujoco', 'matplotlib'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(command, text=True, capture_output=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert "rover" in done.stdout or "localize" in done.stdout


def test_a_command_computes_small_matrices_in_one_thread():
    program = """
import sys
from threadpoolctl import threadpool_info
from infomap_ros.cli import main

sys.argv = ["infomap", "map", "--settings"]
try:
    main()
finally:
    import numpy.linalg, scipy.linalg
    threads = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
    print("threads", *threads)
"""
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, text=True, capture_output=True, check=True, env=free)
    threads = done.stdout.splitlines()[-1].split()
    assert threads[0] == "threads" and set(threads[1:]) == {"1"}


def test_a_study_leaves_its_figure_and_summary(tmp_path, run):
    status, out, _ = run(
        "study", "map-consistency", "--scenes", 2, "--scans", 10, "--out", tmp_path
    )
    summary = json.loads(out.splitlines()[-1])
    assert status in (0, 1), "two scenes decide nothing"
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["scenes"] == 2
    assert "| 2 cm | 2 |" in out
    assert (tmp_path / "map_consistency.png").stat().st_size > 10_000


def test_a_study_that_there_is_not_is_named(run):
    status, _, error = run("study", "alchemy")
    assert status == 2
    assert "alchemy" in error
