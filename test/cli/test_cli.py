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
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import PLY_VERTEX

from ..replay.scenes import START, STEP, depth_frames, fill_after, stereo_frames, write
from ..team import test_map_changes as map_changes


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
    assert "most of the points are beyond 1.6 m" in said
    assert "points are beyond" not in run(*arguments, "--overwrite", "--max-range", 3.0)[2]
    far = write(tmp_path / "far", stereo_frames(scale=20.0))
    said = run("map", far, "--out", tmp_path / "street")[2]
    assert "most of the scene is beyond 5 m: it is mapped up to 50 m with voxels of" in said


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


def test_show_leaves_the_pictures_of_the_run_and_of_others(tmp_path, run):
    bag = write(tmp_path / "bag", depth_frames())
    run("map", bag, "--out", tmp_path / "out")
    picture, map_file = tmp_path / "out" / "map.png", tmp_path / "out" / "map.infomap"
    before = picture.read_bytes()
    status, out, _ = run("show", map_file)
    assert status == 0
    assert json.loads(out)["picture"] == str(tmp_path / "out" / "map_shown.png")
    status, _, error = run("show", map_file, "--out", picture)
    assert status == 1
    assert "--overwrite" in error
    assert picture.read_bytes() == before
    assert run("show", map_file, "--out", picture, "--overwrite")[0] == 0
    assert picture.read_bytes() != before


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


def test_merge_joins_maps_in_any_order(tmp_path, run):
    a, b = maps_of_two_sessions(tmp_path)
    status, out, _ = run("merge", a, b, "--out", tmp_path / "ab.infomap")
    assert status == 0
    figures = json.loads(out)
    joined = VoxelMap.load(tmp_path / "ab.infomap")
    assert figures["known_voxels"] == joined.known_voxels
    assert figures["sessions"] == 2
    run("merge", b, a, "--out", tmp_path / "ba.infomap")
    assert (tmp_path / "ab.infomap").read_bytes() == (tmp_path / "ba.infomap").read_bytes()


def test_merge_refuses_what_would_count_twice_or_be_replaced(tmp_path, run):
    a, b = maps_of_two_sessions(tmp_path)
    before = b.read_bytes()
    for arguments, said in (
        ([a, b, a, "--out", tmp_path / "c.infomap"], "the same session"),
        ([a, "--out", tmp_path / "c.infomap"], "expected two or more"),
        ([a, b, "--out", b], "exists; give another file"),
        ([a, tmp_path / "none", "--out", tmp_path / "c.infomap"], "none"),
    ):
        status, out, error = run("merge", *arguments)
        assert (status, out) == (1, "")
        assert said in error
    assert b.read_bytes() == before
    assert not (tmp_path / "c.infomap").exists()


def test_merge_says_when_nothing_tells_that_the_frames_are_one(tmp_path, run):
    a, _ = maps_of_two_sessions(tmp_path)
    far = _wall_map(tmp_path / "far.infomap", 50.0)
    status, _, error = run("merge", a, far, "--out", tmp_path / "c.infomap")
    assert status == 0
    assert "0 surface voxels in common" in error


def test_changes_are_said_counted_and_drawn(tmp_path, run):
    old, new, out = (tmp_path / name for name in ("old.infomap", "new.infomap", "changes.ply"))
    map_changes.monday().save(old)
    map_changes.tuesday().save(new)
    status, stdout, error = run("changes", old, new, "--out", out)
    assert status == 0
    figures = json.loads(stdout)
    lines = error.splitlines()
    assert sorted(line.split(":")[0] for line in lines[:3]) == ["appeared", "vanished", "vanished"]
    for line, each in zip(lines[:3], figures["objects"], strict=True):
        for low, high in zip(each["low"], each["high"], strict=True):
            assert f"{low:.2f} to {high:.2f}" in line
        assert f"{each['voxels']} voxels" in line
    (box,) = (each for each in figures["objects"] if each["what"] == "appeared")
    middle, sides = np.array(map_changes.MOVED_BOX).reshape(2, 3)
    np.testing.assert_allclose(box["low"][:2], (middle - sides / 2)[:2], atol=0.06)
    np.testing.assert_allclose(box["high"], middle + sides / 2, atol=0.06)
    for line, share in zip(lines[3:], ("old_seen_share", "new_seen_share"), strict=True):
        assert f"could see {figures[share]:.1%} of" in line
        assert 0.8 < figures[share] < 1.0
    head, _, data = out.read_bytes().partition(b"end_header\n")
    vertices = np.frombuffer(data, PLY_VERTEX)
    assert f"element vertex {len(vertices)}\n".encode() in head
    red = vertices[vertices["red"] > vertices["blue"]]
    assert len(red) == figures["appeared_voxels"] == len(vertices) - figures["vanished_voxels"]
    away = np.stack([red[axis] for axis in "xyz"], axis=1) - middle
    assert (np.abs(away) < sides / 2 + 0.02).all()
    assert (vertices["probability"] >= 0.95).all()
    assert ((vertices["sigma"] > 0.0) & (vertices["sigma"] < 0.02)).all()
    assert run("changes", old, new, "--out", out)[0] == 1  # is there


def test_changes_does_not_say_that_nothing_changed_where_nothing_was_compared(tmp_path, run):
    a, far = (_wall_map(tmp_path / f"{x}.infomap", x) for x in (0.0, 50.0))
    status, stdout, error = run("changes", a, far)
    assert status == 0
    assert json.loads(stdout)["objects"] == []
    assert json.loads(stdout)["old_seen_share"] == 0.0
    assert error.count("could see 0.0% of the") == 2
    assert error.count("of the rest nothing is said") == 2


def maps_of_two_sessions(folder):
    return _wall_map(folder / "a.infomap", 0.0), _wall_map(folder / "b.infomap", 0.3)


def _wall_map(path, shift):
    """A map of a wall at x = 2.02 m, seen from y = `shift`."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    y, z = np.meshgrid(np.arange(-0.5, 0.5, 0.02), np.arange(0.0, 1.0, 0.02))
    pose = np.eye(4)
    pose[1, 3] = shift
    points = np.stack([np.full(y.shape, 2.02), y - 0.1 * shift, z], axis=-1)
    voxel_map.integrate(points.reshape(-1, 3), pose)
    voxel_map.save(path)
    return path


def leaves_of_octomap(path):
    """The leaves of an OctoMap file by the definition of its format: (x, y, z, edge) -> evidence.

    Nodes come depth first. In .ot each is a float and a byte with a bit per child; in .bt each
    inner node is two bits per child: 01 and 10 for leaves that are free and occupied (the lower
    bit first), 11 for a child that is an inner node itself.
    """
    head, _, data = path.read_bytes().partition(b"\ndata\n")
    lines = head.decode().splitlines()
    fields = dict(line.split() for line in lines if line and line[0] != "#")
    assert fields["id"] == "OcTree"
    is_binary, place, nodes, leaves = "binary" in lines[0], 0, 1, {}
    assert lines[0] == f"# Octomap OcTree {'binary ' * is_binary}file"

    def read(x, y, z, edge):
        nonlocal place, nodes
        half, size, inner = edge // 2, 2 if is_binary else 5, []
        word = data[place : place + size]
        place += size
        if not is_binary and word[4] == 0:
            leaves[x, y, z, edge] = np.frombuffer(word[:4], "<f4")[0]
        for child in range(8):
            if is_binary:
                state = word[child // 4] >> (2 * (child % 4)) & 3
            else:
                state = 3 * (word[4] >> child & 1)
            corner = x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2)
            nodes += state != 0
            if state in (1, 2):
                leaves[*corner, half] = {1: -1.0, 2: 1.0}[state]
            if state == 3:
                inner.append((*corner, half))
        for each in inner:
            read(*each)

    read(-(2**15), -(2**15), -(2**15), 2**16)
    assert place == len(data)
    assert nodes == int(fields["size"])
    return leaves, float(fields["res"])


@pytest.mark.parametrize("format", ["ot", "bt"])
def test_export_writes_what_octomap_reads(tmp_path, run, format):
    map_file = _wall_map(tmp_path / "a.infomap", 0.0)
    assert run("export", map_file, "--format", format)[0] == 0
    leaves, resolution = leaves_of_octomap(tmp_path / f"a.{format}")
    assert resolution == 0.05
    found = {}
    for (x, y, z, edge), evidence in leaves.items():
        for step in np.ndindex(edge, edge, edge):
            found[x + step[0], y + step[1], z + step[2]] = evidence
    indices, log_odds = VoxelMap.load(map_file).voxels()
    if format == "bt":
        log_odds = np.where(log_odds > 0.0, 1.0, -1.0)
    assert found == dict(zip(map(tuple, indices.tolist()), log_odds.tolist(), strict=True))
    assert max(edge for *_, edge in leaves) > 1


def test_export_writes_each_format_beside_the_map_and_replaces_nothing_unasked(tmp_path, run):
    map_file = _wall_map(tmp_path / "a.infomap", 0.0)
    expected = {"a.infomap"}
    for name, files in (
        ("ply", {"ply": "a.ply"}),
        ("grid", {"yaml": "a.yaml", "pgm": "a.pgm"}),
        ("mesh", {"stl": "a.stl"}),
        ("distance", {"npz": "a.npz"}),
    ):
        status, out, _ = run("export", map_file, "--format", name)
        assert status == 0
        assert json.loads(out) == {key: str(tmp_path / file) for key, file in files.items()}
        expected |= set(files.values())
        status, _, error = run("export", map_file, "--format", name)
        assert status == 1
        assert "exists; give another file, or --overwrite" in error
        assert run("export", map_file, "--format", name, "--overwrite")[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == expected


def test_export_takes_the_heights_of_a_grid(tmp_path, run):
    map_file = _wall_map(tmp_path / "a.infomap", 0.0)
    sizes = []
    for low, high in ((0.1, 0.9), (5.0, 6.0)):
        out = tmp_path / f"{low}.yaml"
        run("export", map_file, "--format", "grid", "--out", out, "--low", low, "--high", high)
        sizes.append(out.with_suffix(".pgm").read_bytes().split(b"\n")[1])
    assert sizes[0] != sizes[1] == b"1 1"  # nothing is known so far up


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--format", "pcd"], "expected one of ply, ot, bt, grid, mesh, distance"),
        (["--format", "grid", "--low", 2.0, "--high", 1.0], "high"),
        (["--format", "ply", "--out", "/proc/none.ply"], "/proc"),
    ],
)
def test_export_refuses_with_the_reason(tmp_path, run, arguments, said):
    map_file = _wall_map(tmp_path / "a.infomap", 0.0)
    status, out, error = run("export", map_file, *arguments)
    assert (status, out) == (1, "")
    assert said in error


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
