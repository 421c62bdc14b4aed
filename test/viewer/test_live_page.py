"""A page in a real browser: what it is told it shows, and its buttons steer."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from infomap_ros.errors import ExplorationError
from infomap_ros.geometry import make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.viewer import LivePage, PageConfig
from infomap_ros.viewer.displays import LogDisplay
from infomap_ros.viewer.run_panel import InterestBox

ROVER = RobotModel.from_urdf(find_share("config/rover.urdf").read_text("utf-8"))
PROGRESS = {
    "t": 1.0,
    "kind": "progress",
    "views": 3,
    "distance": 2.25,
    "known_fraction": 0.625,
    "precise_fraction": 0.5,
    "entropy_bits": 12345.0,
    "mean_sigma": 0.0071,
    "surface_voxels": 4321,
    "known_voxels": 99999,
    "state": "choosing",
}
CANDIDATES = [
    {
        "position": [0.1 * number, 0.5, 1.0],
        "direction": [1.0, 0.0, 0.0],
        "rating": rating,
        "terms": {"information": 1000.0 * number, "interest": 0.0},
        "rejection": rejection,
    }
    for number, (rating, rejection) in enumerate(
        [(2.5, ""), (1.5, ""), (None, "base path: unknown ground"), (None, "base path: too steep")]
    )
]
DECISION = {
    "t": 2.0,
    "kind": "decision",
    "view": 3,
    "pose": np.eye(4).ravel().tolist(),
    "base": [0.0, 0.0, 0.0],
    "strategy": "largest_information",
    "rating": 2.5,
    "terms": {},
    "reason": "tells <most> of the far corner",
    "seconds": {},
    "candidates": CANDIDATES,
    "considered": 4,
}


class Run:
    """A page with what its buttons have done."""

    def __init__(self, config: PageConfig | None = None) -> None:
        self.given: list[str] = []
        self.boxes: list[InterestBox | None] = []
        orders = {"Start": lambda: self._note("Start"), "Stop": self._refuse}
        self.page = LivePage("a run", config, orders, self.boxes.append)

    def _note(self, name: str) -> str:
        self.given.append(name)
        return "begun"

    def _refuse(self) -> str:
        self.given.append("Stop")
        raise ExplorationError("nothing runs")


@pytest.fixture
def run() -> Iterator[Run]:
    running = Run()
    yield running
    running.page.close()


@pytest.fixture
def shown(window: Any, run: Run) -> Any:
    """The browser, when it shows the page."""
    window.complaints.clear()
    window.requests.clear()
    window.send("Page.navigate", url=run.page.address)
    wait_for(lambda: run.page.is_watched)
    return window


def wait_for(condition: Any) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "never"
        time.sleep(0.05)


def floor(offset: float = 0.0) -> VoxelMap:
    """A square of floor that a camera above it has seen."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    x, y = np.meshgrid(np.arange(-1.5, 1.5, 0.03), np.arange(-1.5, 1.5, 0.03))
    points = np.stack([x + offset, y, np.full_like(x, 2.0)], axis=-1).reshape(-1, 3)
    voxel_map.integrate(points, make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 2.0)))
    return voxel_map


def click(browser: Any, label: str) -> None:
    """Press the button of that label."""
    found = f"[...document.querySelectorAll('button')].find(b => b.innerText === {label!r})"
    browser.wait(f"Boolean({found})")
    browser.evaluate(f"{found}.click()")


def drawn(browser: Any, path: Path) -> int:
    """Number of pixels of the 3-D view that are not its white background."""
    browser.screenshot(path)
    image = cv2.imread(str(path))
    assert image is not None
    return int((image[:, :220].min(axis=-1) < 200).sum())


def test_what_the_log_tells_is_said(run: Run, shown: Any) -> None:
    display = LogDisplay(run.page)
    for entry in (PROGRESS, DECISION, {"t": 3.0, "kind": "end", "reason": "done", "detail": ""}):
        display.show(entry)

    shown.wait("document.body.innerText.includes('ended: done')")
    text = shown.evaluate("document.body.innerText")

    for expected in (
        "choosing",
        "62.5%",
        "50.0%",
        "7.1 mm",
        "2.2 m",
        "4,321 voxels",
        "tells <most> of the far corner",
        "2 views rated, 2 rejected",
        "2 x base path",
    ):
        assert expected in text, expected
    assert text.index("rating 2.5") < text.index("rating 1.5: information 1,000")
    assert "interest" not in text.replace("Place of interest", "")


def test_words_of_others_are_text_wherever_they_stand(run: Run, shown: Any) -> None:
    bad = "<img src=x onerror=alert(1)>"
    display = LogDisplay(run.page)
    display.show(PROGRESS | {"state": bad})
    display.show(DECISION | {"reason": bad, "strategy": bad})
    display.show({"t": 3.0, "kind": "end", "reason": bad, "detail": bad})
    run.page.panel.say(bad)
    shown.wait(f"document.body.innerText.includes({bad!r})")
    assert shown.evaluate("document.querySelectorAll('img[onerror]').length") == 0


def test_the_map_is_drawn_where_there_is_one(run: Run, shown: Any, tmp_path: Path) -> None:
    before = drawn(shown, tmp_path / "before.png")

    run.page.map.show(floor())
    wait_for(lambda: drawn(shown, tmp_path / "after.png") > before + 3_000)

    shown.wait("document.body.innerText.includes('-0.05 m') || /-?0\\.\\d\\d m/.test("
               "document.body.innerText)")  # fmt: skip
    assert np.allclose(run.page.map.middle[:2], 0.0, atol=0.2)


def test_who_comes_late_sees_the_same(run: Run, window: Any, tmp_path: Path) -> None:
    run.page.map.show(floor())
    LogDisplay(run.page).show(DECISION)

    window.send("Page.navigate", url=run.page.address)

    window.wait("document.body?.innerText?.includes('far corner')")
    wait_for(lambda: drawn(window, tmp_path / "late.png") > 3_000)


def test_a_button_steers_and_the_answer_is_told(run: Run, shown: Any) -> None:
    click(shown, "Start")
    shown.wait("document.body.innerText.includes('Start: begun')")
    click(shown, "Stop")
    shown.wait("document.body.innerText.includes('nothing runs')")

    assert run.given == ["Start", "Stop"]


def test_a_page_that_is_read_only_has_nothing_that_steers(window: Any) -> None:
    running = Run(PageConfig(read_only=True))
    try:
        window.send("Page.navigate", url=running.page.address)
        wait_for(lambda: running.page.is_watched)
        window.wait("document.body.innerText.includes('Why this view')")
        text = window.evaluate("document.body.innerText")
        assert not any(word in text for word in ("Start", "Stop", "Place of interest"))
    finally:
        running.page.close()


def test_a_box_is_handed_on_and_taken_away(run: Run, shown: Any) -> None:
    run.page.map.show(floor(offset=3.0))
    shown.wait("document.body.innerText.includes('Place of interest')")
    shown.evaluate(
        "document.evaluate(\"//*[contains(text(), 'Place of interest')]\", document, null, 9, null)"
        ".singleNodeValue.click()"
    )
    click(shown, "Send")
    wait_for(lambda: len(run.boxes) == 1)
    click(shown, "Remove")
    wait_for(lambda: len(run.boxes) == 2)

    box = run.boxes[0]
    assert box is not None
    assert box.weight == 3.0
    assert np.allclose(box.center, run.page.map.middle, atol=1e-6)
    assert box.center[0] > 2.0
    assert run.boxes[1] is None


def test_robot_camera_and_paths_are_drawn_without_complaint(run: Run, shown: Any) -> None:
    joints = {joint.name: 0.1 for joint in ROVER.joints}
    for step in range(5):
        base = make_transform(np.eye(3), (0.1 * step, 0.0, 0.0))
        run.page.robot.show(ROVER, base, joints)
        run.page.robot.show_camera(base, None)
    run.page.robot.show(ROVER, np.eye(4), {})  # its joints are not known
    run.page.views.show_path(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    run.page.views.show_path(np.empty((0, 3)))
    run.page.views.show_chosen(None, None, "nothing is left")
    run.page.panel.add_point(math.nan, 0.5)

    shown.wait("document.body.innerText.includes('nothing is left')")

    assert not [text for text in shown.complaints if "deprecated" not in text]
    assert all(
        address.startswith((run.page.address.partition("?")[0], "blob:", "data:"))
        for address in shown.requests
    ), json.dumps(shown.requests)
