"""A description of any size and content ends in a model or in an error, never in a crash."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from infomap_ros.errors import RobotModelError
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.urdf import MOST_BYTES, MOST_DEPTH, MOST_LINKS, MOST_SHAPES


def joint(number: int, parent: int, kind: str = "fixed", origin: str = "0 0 0") -> str:
    ends = f'<parent link="l{parent}"/><child link="l{number}"/>'
    return f'<joint name="j{number}" type="{kind}">{ends}<origin xyz="{origin}"/></joint>'


def links(count: int, inside: str = "") -> str:
    return "".join(f'<link name="l{number}">{inside}</link>' for number in range(count))


def chain(count: int, kind: str = "fixed") -> str:
    joints = "".join(joint(number, number - 1, kind) for number in range(1, count))
    return f'<robot name="r">{links(count)}{joints}</robot>'


def star(count: int, inside: str = "") -> str:
    joints = "".join(joint(number, 0) for number in range(1, count))
    return f'<robot name="r">{links(count, inside)}{joints}</robot>'


def one_link(inside: str) -> str:
    return f'<robot name="r"><link name="l0">{inside}</link></robot>'


def shape(geometry: str) -> str:
    return f"<collision><geometry>{geometry}</geometry></collision>"


@pytest.mark.parametrize("kind", ["fixed", "continuous"])
def test_a_chain_of_4000_links_is_refused_and_the_process_lives(kind: str) -> None:
    with pytest.raises(RobotModelError, match="4000 links, at most 1000"):
        RobotModel.from_urdf(chain(4000, kind))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (chain(MOST_DEPTH + 1), "links in a row"),
        (star(MOST_LINKS + 1), "links"),
        (one_link(shape('<sphere radius="1"/>') * (MOST_SHAPES + 1)), "collision shapes"),
        (one_link("<a>" * 100 + "</a>" * 100), "elements within each other"),
        (one_link("<a/>" * 100_001), "elements"),
        (one_link(" " * MOST_BYTES), "bytes"),
        (one_link(shape('<sphere radius="1e30"/>')), "radius 1e\\+30 m"),
        (one_link(shape('<box size="1 1 1e9"/>')), "radius 5e\\+08 m"),
        (f'<robot name="r">{links(2)}{joint(1, 0, origin="0 0 1e300")}</robot>', "origin"),
        (f'<robot name="r">{links(2)}{joint(1, 0, origin="nan 0 0")}</robot>', "origin"),
        (one_link("").replace("l0", "\ud800"), "surrogates"),
    ],
)
def test_what_is_beyond_a_limit_is_refused_by_name(text: str, problem: str) -> None:
    start = time.thread_time()
    with pytest.raises(RobotModelError, match=problem):
        RobotModel.from_urdf(text)
    assert time.thread_time() - start < 20.0  # of one thread: others of the process may be busy


def test_a_description_at_the_limits_is_read(tmp_path: Path) -> None:
    """In a thread with a small stack, as an executor may have."""
    (tmp_path / "chain.urdf").write_text(chain(MOST_DEPTH, "continuous"))
    (tmp_path / "star.urdf").write_text(star(MOST_LINKS))
    code = (
        "import sys, threading; threading.stack_size(1_000_000)\n"
        "from infomap_ros.motion.robot.robot_model import RobotModel\n"
        "def read():\n"
        "    for path in sys.argv[1:]: print(len(RobotModel.from_urdf(path).frames))\n"
        "thread = threading.Thread(target=read); thread.start(); thread.join()"
    )
    files = map(str, sorted(tmp_path.iterdir()))
    done = subprocess.run(
        [sys.executable, "-c", code, *files], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(MOST_DEPTH), str(MOST_LINKS)]


def test_a_file_without_an_end_is_refused() -> None:
    with pytest.raises(RobotModelError, match="bytes"):
        RobotModel.from_urdf("/dev/zero")
