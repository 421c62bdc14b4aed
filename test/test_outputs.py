"""What is written replaces what is there as a whole or not at all, and goes through no link."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import json
import os
import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

import infomap_ros
from infomap_ros.cli.app import new_app
from infomap_ros.cli.localize_command import write_covariances, write_tum
from infomap_ros.cli.map_file_commands import draw_depth_image
from infomap_ros.cli.tags_command import tags
from infomap_ros.errors import InfomapError
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.records.run_log import RunLogFile
from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.atomic_file import appending
from infomap_ros.localization.target.tag_board import TagBoardConfig, save_board
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import write_distances, write_grid, write_ply, write_stl
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.nodes.live.live_graph import NodeProcesses
from infomap_ros.replay.localize_run import Trajectory
from infomap_ros.simulation.body.saved_robot import SavedRobot
from infomap_ros.studies.figure_style import save
from infomap_ros.studies.runs import Kept, write_rows

ROOT = Path(infomap_ros.__file__).parent
PRECIOUS = b"what somebody else has"
BOARD = TagBoardConfig(columns=2, rows=1)
TRAJECTORY = Trajectory(np.arange(9), np.tile(np.eye(4), (9, 1, 1)), np.tile(np.eye(6), (9, 1, 1)))


@dataclasses.dataclass(frozen=True)
class Twice:
    """A task and its result."""

    number: int = 2
    file_name: str = "twice.npz"

    def fingerprint(self) -> str:
        return "of two"


def voxel_map() -> VoxelMap:
    points = np.random.default_rng(0).uniform(1.0, 2.0, (500, 3)).astype(np.float32)
    made = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    made.integrate(points, np.eye(4))
    return made


def figure() -> Figure:
    drawn = Figure(figsize=(2.0, 2.0))
    drawn.subplots().plot([1, 2, 3])
    return drawn


def find_tags(folder: Path) -> None:
    photo = folder.with_name("photo.png")
    save_board(BOARD, photo, 100)
    app = new_app("")
    app.command()(tags)
    done = CliRunner().invoke(app, [str(photo), "--out", str(folder)])
    if done.exception is not None:
        raise done.exception


def depth_image(folder: Path) -> None:
    camera = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
    draw_depth_image(voxel_map().render_depth(camera, np.eye(4)), folder / "depth.png")


WRITERS: dict[str, Callable[[Path], object]] = {
    "map.infomap": lambda folder: voxel_map().save(folder / "map.infomap"),
    "map.ply": lambda folder: write_ply(voxel_map(), folder / "map.ply"),
    "map.stl": lambda folder: write_stl(voxel_map(), folder / "map.stl"),
    "map.yaml map.pgm": lambda folder: write_grid(voxel_map(), folder / "map.yaml"),
    "map.npz": lambda folder: write_distances(voxel_map(), folder / "map.npz"),
    "map.bt": lambda folder: write_bt(voxel_map(), folder / "map.bt"),
    "map.ot": lambda folder: write_ot(voxel_map(), folder / "map.ot"),
    "map.html": lambda folder: write_map_report(folder / "map.html", voxel_map(), "a map"),
    "map.png": lambda folder: draw_map_views(voxel_map(), folder / "map.png"),
    "depth.png": depth_image,
    "trajectory.txt": lambda folder: write_tum(TRAJECTORY, folder / "trajectory.txt"),
    "covariances.txt": lambda folder: write_covariances(TRAJECTORY, folder / "covariances.txt"),
    "rows.csv": lambda folder: write_rows([Twice()], folder / "rows.csv"),
    "twice.npz": lambda folder: Kept(folder, Twice).save(Twice(), Twice()),  # type: ignore[arg-type]
    "study.png study.svg": lambda folder: save(figure(), folder / "study"),
    "board.png": lambda folder: save_board(BOARD, folder / "board.png", 100),
    "board.pdf": lambda folder: save_board(BOARD, folder / "board.pdf", 100),
    "photo_tags.png tags.csv": find_tags,
    "mission.json": lambda folder: Mission().save(folder / "mission.json"),
    "robot.json": lambda folder: SavedRobot(1.0, 0, {}, {}).save(folder / "robot.json"),
}


@contextlib.contextmanager
def full_disk() -> Iterator[None]:
    """No file grows beyond 16 bytes: what the kernel then does is what it does on a full disk."""
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("names", WRITERS)
def test_an_output_replaces_a_planted_link_and_is_left_by_a_full_disk(
    names: str, tmp_path: Path
) -> None:
    victim, folder = tmp_path / "victim", tmp_path / "out"
    victim.write_bytes(PRECIOUS)
    folder.mkdir()
    files = [folder / name for name in names.split()]
    for file in files:
        file.symlink_to(victim)

    WRITERS[names](folder)

    assert victim.read_bytes() == PRECIOUS
    assert sorted(folder.iterdir()) == sorted(files)
    assert not any(file.is_symlink() for file in files)
    written = [file.read_bytes() for file in files]
    assert min(map(len, written)) > 16
    with pytest.raises((OSError, InfomapError)), full_disk():
        WRITERS[names](folder)
    assert [file.read_bytes() for file in files] == written
    assert sorted(folder.iterdir()) == sorted(files)


def test_the_log_of_a_run_goes_through_no_link(tmp_path: Path) -> None:
    victim, path = tmp_path / "victim", tmp_path / "run.jsonl"
    victim.write_bytes(PRECIOUS)
    path.symlink_to(victim)
    with pytest.raises(OSError, match="symbolic links"):
        RunLogFile(path, append=True)

    log = RunLogFile(path)
    log.write("message", text="one")

    assert not path.is_symlink()
    path.rename(tmp_path / "moved.jsonl")
    path.symlink_to(victim)
    with pytest.raises(OSError, match="symbolic links"):
        log.write("message", text="two")
    assert victim.read_bytes() == PRECIOUS
    assert json.loads((tmp_path / "moved.jsonl").read_text())["text"] == "one"


def test_a_log_of_a_run_that_was_interrupted_is_added_to(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    RunLogFile(path).write("message", text="one")
    with appending(path) as file:
        file.write(b'{"t": 1.0, "ki')  # killed within a line
    RunLogFile(path, append=True).write("message", text="two")
    lines = path.read_text().splitlines()
    assert [json.loads(lines[k])["text"] for k in (0, 2)] == ["one", "two"]


def test_a_log_is_not_continued_in_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.jsonl")
    with pytest.raises(OSError, match="No such device"):  # nobody reads it
        RunLogFile(tmp_path / "run.jsonl", append=True)
    reader = os.open(tmp_path / "run.jsonl", os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(OSError, match="pipe"):
        RunLogFile(tmp_path / "run.jsonl", append=True)
    os.close(reader)


def test_the_log_of_a_node_goes_through_no_link(tmp_path: Path) -> None:
    victim, log = tmp_path / "victim", tmp_path / "logs" / "tool.log"
    victim.write_bytes(PRECIOUS)
    processes = NodeProcesses(tmp_path / "logs")
    log.symlink_to(victim)
    for _ in range(2):
        processes.start("tool", {}, module="json.tool")
        processes.wait("tool", 20.0)
    assert victim.read_bytes() == PRECIOUS
    assert not log.is_symlink()
    assert log.read_bytes().count(b"usage:") == 2


WRITES = {"savefig", "imsave", "save", "savez", "savez_compressed", "savetxt"}
ALWAYS_IN_PLACE = {"write_text", "write_bytes", "imwrite", "tofile", "to_csv", "copyfile"}
MODULES_OF_WRITES = {"np", "numpy", "figure", "page", "plt"}
BY_THEMSELVES = {
    "geometry/atomic_file.py": 1,  # what all others use
    "replay/bags/reader.py": 3,  # in a folder of its own that it has just made
    "nodes/common/message_packages.py": 2,  # as there, and in the Python environment
    "nodes/parameter_docs.py": 1,  # the pages of a checkout
}


def writes_in_place(source: str) -> list[int]:
    """Lines on which a file is opened to be written, other than by `replacing` or `appending`."""
    tree, found = ast.parse(source), []
    safe = {
        item.optional_vars.id
        for node in ast.walk(tree)
        if isinstance(node, ast.With)
        for item in node.items
        if isinstance(item.context_expr, ast.Call)
        and ast.unparse(item.context_expr.func) in {"replacing", "appending"}
        and isinstance(item.optional_vars, ast.Name)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        owner, _, last = name.rpartition(".")
        modes = [w.value for w in [*node.args, *(k.value for k in node.keywords)] if _is_text(w)]
        opens = last == "open" and any(
            set(m) <= set("rwaxbt+") and set(m) & set("wax+") for m in modes
        )
        saves = last in WRITES and (owner in MODULES_OF_WRITES or last in {"savefig", "imsave"})
        to_file = node.args and isinstance(node.args[0], ast.Name) and node.args[0].id in safe
        in_place = last in ALWAYS_IN_PLACE and bool(owner)
        if opens or in_place or (saves and not to_file):
            found.append(node.lineno)
    return found


def _is_text(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("path.open('w')", 1),
        ("open(path, mode='ab')", 1),
        ("path.open('r+b')", 1),
        ("path.open('rb')", 0),
        ("path.open(encoding='utf-8')", 0),
        ("path.write_text('a')", 1),
        ("write_text(path, 'a')", 0),
        ("np.savez(path, a=a)", 1),
        ("with replacing(path) as file:\n    np.savez(file, a=a)", 0),
        ("with path.open('wb') as file:\n    np.savez(file, a=a)", 2),
        ("cv2.imwrite(str(path), image)", 1),
        ("mission.save(path)", 0),
    ],
)
def test_what_is_looked_for_is_found(source: str, count: int) -> None:
    assert len(writes_in_place(source)) == count


def test_no_module_writes_in_place() -> None:
    found = {
        str(file.relative_to(ROOT)): len(writes_in_place(file.read_text("utf-8")))
        for file in sorted(ROOT.rglob("*.py"))
    }
    assert len(found) > 300
    assert {name: count for name, count in found.items() if count} == BY_THEMSELVES
