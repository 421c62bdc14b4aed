"""A file is replaced as a whole, by whoever writes it, or not at all."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from infomap_ros.geometry.atomic_file import replacing, write_json


def names_in(folder: Path) -> list[str]:
    return [file.name for file in folder.iterdir()]


def test_what_is_written_is_read_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"b": [1.5, "x"]})
    write_json(tmp_path / "a.json", {"b": [2.5, "x"]})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"b": [2.5, "x"]}
    assert names_in(tmp_path) == ["a.json"]


def test_a_link_under_a_name_that_can_be_foreseen_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "a.json.new").symlink_to("victim")
    write_json(tmp_path / "a.json", [1])
    assert (tmp_path / "victim").read_text() == "precious"
    assert not (tmp_path / "a.json").is_symlink()


def test_a_link_is_replaced_and_what_it_names_stays(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("[]")
    (tmp_path / "a.json").symlink_to("real.json")
    (tmp_path / "b.json").symlink_to("not_yet.json")
    write_json(tmp_path / "a.json", [1])
    write_json(tmp_path / "b.json", [2])
    assert not (tmp_path / "a.json").is_symlink()
    assert (tmp_path / "a.json").read_text() == "[1]"
    assert (tmp_path / "real.json").read_text() == "[]"
    assert sorted(names_in(tmp_path)) == ["a.json", "b.json", "real.json"]


def test_links_in_a_loop_and_folders_are_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OSError) as caught:
        write_json(tmp_path / "loop", [1])
    assert caught.value.errno == errno.ELOOP
    with pytest.raises(IsADirectoryError):
        write_json(tmp_path, [1])


def test_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="device"):
        write_json(tmp_path / "pipe", [1])
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_link_to_a_device_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "null").symlink_to("/dev/null")
    with pytest.raises(OSError, match="device"):
        write_json(tmp_path / "null", [1])
    assert (tmp_path / "null").is_symlink()


def test_standard_output_is_not_replaced_where_it_is_a_file(tmp_path: Path) -> None:
    code = "from infomap_ros.geometry.atomic_file import write_text; write_text('/dev/stdout', 'x')"
    before = Path("/dev/stdout").readlink()
    with (tmp_path / "out").open("wb") as out:
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=out, stderr=subprocess.PIPE, check=False
        )
    assert b"is a device" in done.stderr
    assert Path("/dev/stdout").readlink() == before


def test_a_device_is_not_replaced() -> None:
    before = Path("/dev/null").stat().st_rdev
    with pytest.raises(OSError, match="device"), replacing("/dev/null") as file:
        file.write(b"x")
    assert Path("/dev/null").stat().st_rdev == before


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", [1])
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {1, 2})
    assert (tmp_path / "a.json").read_text() == "[1]"
    assert names_in(tmp_path) == ["a.json"]


def test_remains_of_a_killed_process_go_with_the_next_writing(tmp_path: Path) -> None:
    code = (
        "import os, sys; from infomap_ros.geometry.atomic_file import replacing\n"
        "with replacing(sys.argv[1]) as file: file.write(b'half'); file.flush(); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", code, tmp_path / "a.json"], check=False)
    assert len(names_in(tmp_path)) == 1
    write_json(tmp_path / "a.json", [1])
    assert names_in(tmp_path) == ["a.json"]


def _write_often(path: Path, number: int, failures: multiprocessing.Queue) -> None:  # type: ignore[type-arg]
    failed = 0
    for _ in range(60):
        try:
            write_json(path, [number] * (10 + 3000 * number))
        except OSError:
            failed += 1
    failures.put(failed)


def test_three_writers_of_one_file_leave_it_whole_at_any_time(tmp_path: Path) -> None:
    path, failures = tmp_path / "a.json", multiprocessing.Queue()
    writers = [
        multiprocessing.Process(target=_write_often, args=(path, number, failures))
        for number in range(3)
    ]
    for writer in writers:
        writer.start()
    reads = 0
    while any(writer.is_alive() for writer in writers) or not reads:
        if path.exists():
            assert len(set(json.loads(path.read_text()))) == 1
            reads += 1
    assert [failures.get(timeout=10) for _ in writers] == [0, 0, 0]
    assert names_in(tmp_path) == ["a.json"]
