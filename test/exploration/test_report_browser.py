"""The report in a real browser: it draws, turns, answers, and asks for nothing."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.exploration.reports.comparison import write_comparison
from infomap_ros.exploration.reports.report import write_map_report, write_report
from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .browser import MISSING, NO_WEBGL, SOFTWARE_WEBGL, Browser, find_browser
from .made_up_run import entries, made_up_map, write_log

SIZE = (1000, 640)
ACCENT = (178, 114, 0)  # of the light theme, BGR


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    path = folder / "report.html"
    log = write_log(folder / "run.jsonl", voxel_size=0.1)
    write_report(path, log, made_up_map(voxel_size=0.1), "Stones")
    return path


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    assert find_browser() is not None, MISSING
    with Browser(tmp_path_factory.mktemp("browser") / "profile", SOFTWARE_WEBGL, SIZE) as browser:
        yield browser


@pytest.fixture
def page(window: Browser, report: Path) -> Browser:
    window.requests.clear()
    window.complaints.clear()
    window.open(report)
    window.evaluate("document.getElementById('map').scrollIntoView()")
    window.frame()
    return window


def stage(browser: Browser) -> tuple[float, float, float, float]:
    """Left, top, width and height of the 3-D view [px]."""
    box = "document.getElementById('scene').getBoundingClientRect()"
    found = browser.evaluate(f"JSON.stringify({box})")
    values = json.loads(found)
    return values["x"], values["y"], values["width"], values["height"]


def picture(browser: Browser, name: str = "scene") -> np.ndarray:
    """What a canvas shows when all is drawn, shape (H, W, 4), BGRA."""
    browser.wait("document.getElementById('scene').dataset.drawn === 'whole'")
    return decoded(browser.evaluate(f"document.getElementById('{name}').toDataURL()"))


def decoded(data: str) -> np.ndarray:
    """Pixels of a data address, shape (H, W, 4), BGRA."""
    code = np.frombuffer(base64.b64decode(data.split(",")[1]), np.uint8)
    image = cv2.imdecode(code, cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that differ."""
    return float((before != after).any(axis=2).mean())


def middle(browser: Browser) -> tuple[float, float]:
    x, y, width, height = stage(browser)
    return x + 0.5 * width, y + 0.5 * height


def details(browser: Browser) -> str:
    return str(browser.evaluate("document.getElementById('details').innerText"))


def click(browser: Browser, selector: str) -> None:
    browser.evaluate(f"document.querySelector({json.dumps(selector)}).click()")


def test_it_draws_without_a_complaint_and_asks_for_nothing(page: Browser, report: Path) -> None:
    assert page.evaluate("document.documentElement.dataset.ready") == "3d"
    colors = np.unique(picture(page)[..., :3].reshape(-1, 3), axis=0)
    assert len(colors) > 200
    assert page.complaints == []
    others = [url for url in page.requests if not url.startswith("data:")]
    assert others == [report.resolve().as_uri()]


def test_dragging_turns_the_map(page: Browser) -> None:
    before = picture(page)
    x, y = middle(page)
    page.drag((x, y), (x + 160.0, y + 40.0))
    assert changed(before, picture(page)) > 0.1
    click(page, "[data-camera=home]")
    assert changed(before, picture(page)) == 0.0


def test_the_right_button_moves_and_the_wheel_zooms(page: Browser) -> None:
    first = picture(page)
    x, y = middle(page)
    page.drag((x, y), (x + 90.0, y), button="right")
    second = picture(page)
    assert changed(first, second) > 0.1
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-400)
    third = picture(page)
    assert changed(second, third) > 0.1
    background = third[-1, -1]
    drawn = [(image != background).any(axis=2).sum() for image in (second, third)]
    assert drawn[1] > drawn[0]


def test_keys_turn_the_map(page: Browser) -> None:
    before = picture(page)
    page.evaluate("document.getElementById('scene').focus()")
    page.send("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft")
    assert changed(before, picture(page)) > 0.1


def test_each_coloring_and_layer_changes_the_picture(page: Browser) -> None:
    pictures = [picture(page)]
    for mode in ("sigma", "probability"):
        click(page, f"input[value={mode}]")
        pictures.append(picture(page))
    for layer in ("surface", "axes", "base", "camera", "views", "candidates"):
        click(page, f"input[name={layer}]")
        pictures.append(picture(page))
    for before, after in pairwise(pictures):
        assert changed(before, after) > 1e-4
    assert len(np.unique(pictures[-1].reshape(-1, 4), axis=0)) == 1  # nothing is left


def test_hiding_what_is_above_takes_the_tops_away(page: Browser) -> None:
    before = picture(page)
    page.evaluate(
        "(() => { const s = document.getElementById('cut'); s.value = 20;"
        " s.dispatchEvent(new Event('input')); })()"
    )
    assert changed(before, picture(page)) > 0.05
    assert page.evaluate("document.getElementById('cut-text').textContent").endswith(" m")


def test_a_click_on_a_view_shows_its_terms(page: Browser) -> None:
    told = [entry for entry in entries() if entry["kind"] == "decision"]
    click(page, ".views tbody tr[data-step='7']")
    labels = picture(page, "labels").astype(int)
    near = (np.abs(labels[..., :3] - ACCENT).max(axis=2) < 8) & (labels[..., 3] > 250)
    row, column = np.argwhere(near).mean(axis=0)
    click(page, ".views tbody tr[data-step='2']")
    assert "View 2" in details(page)
    page.evaluate("document.getElementById('map').scrollIntoView({behavior: 'instant'})")
    page.evaluate("new Promise((done) => setTimeout(done, 100))")
    x, y, _, _ = stage(page)
    page.click(x + column, y + row)
    text = details(page)
    assert "View 7" in text
    assert told[7]["reason"] in text
    for name, value in told[7]["terms"].items():
        assert name.replace("_", " ") in text
        digits = f"{abs(value):.3g}" if abs(value) < 1000 else f"{abs(value):.0f}"
        assert digits in text


def test_pointing_at_a_candidate_tells_its_rating_and_a_click_its_terms(page: Browser) -> None:
    for layer in ("surface", "axes", "base", "camera", "views"):
        click(page, f"input[name={layer}]")
    image = picture(page)[..., :3].astype(int)
    bright = image.max(axis=2) - image.min(axis=2)  # rated ones have a color, rejected are gray
    count, _, boxes, centers = cv2.connectedComponentsWithStats((bright > 90).astype(np.uint8))
    sizes = boxes[1:count, cv2.CC_STAT_AREA]
    column, row = centers[1 + int(np.argmax(sizes))]
    x, y, _, _ = stage(page)
    page.mouse("mouseMoved", x + column, y + row)
    assert "candidate" in page.evaluate("document.getElementById('tip').textContent")
    page.click(x + column, y + row)
    assert "Candidate" in details(page)
    assert "localization error" in details(page)


def test_it_opens_with_the_whole_map_and_the_slider_rewinds_it(page: Browser) -> None:
    for layer in ("axes", "base", "camera", "views", "candidates"):
        click(page, f"input[name={layer}]")
    last = page.evaluate("document.getElementById('step').max")
    assert page.evaluate("document.getElementById('step').value") == last
    drawn = []
    for step in (int(last), 1, 0):
        move = f"s.value = {step}; s.dispatchEvent(new Event('input'))"
        page.evaluate(f"(() => {{ const s = document.getElementById('step'); {move}; }})()")
        image = picture(page)
        drawn.append(int((image != image[-1, -1]).any(axis=2).sum()))
    assert drawn[0] > 1.5 * drawn[1] > 0 and drawn[2] == 0


def test_stepping_shows_other_candidates(page: Browser) -> None:
    for layer in ("surface", "axes", "base", "camera", "views"):
        click(page, f"input[name={layer}]")
    before = picture(page)
    click(page, "#before")
    assert changed(before, picture(page)) > 1e-3


def test_looking_through_a_camera_changes_the_view(page: Browser) -> None:
    click(page, "#before")  # the last decision chose none
    before = picture(page)
    click(page, "#through")
    assert changed(before, picture(page)) > 0.2


def test_the_dark_theme_is_dark(page: Browser) -> None:
    light = picture(page)[0, 0, :3]
    click(page, "#theme")
    dark = picture(page)[0, 0, :3]
    click(page, "#theme")
    assert light.min() > 200
    assert dark.max() < 60


def test_paper_gets_the_map_on_a_light_ground(page: Browser) -> None:
    click(page, "#theme")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    data = page.evaluate("document.getElementById('labels').toDataURL()")
    printed = decoded(data)
    assert len(np.unique(printed[..., :3].reshape(-1, 3), axis=0)) > 200
    assert printed[0, 0, :3].min() > 200
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert picture(page)[0, 0, :3].max() < 60


def test_a_pointer_on_a_chart_tells_the_value(page: Browser) -> None:
    page.evaluate("document.querySelector('svg.chart').scrollIntoView({block: 'center'})")
    box = "JSON.stringify(document.querySelector('svg.chart').getBoundingClientRect())"
    values = json.loads(page.evaluate(box))
    x = values["right"] - 0.04 * values["width"]
    page.mouse("mouseMoved", x, values["y"] + 0.5 * values["height"])
    text = page.evaluate("document.querySelector('svg.chart .mark-text').textContent")
    assert text.endswith("at views 12")


def two_patches(browser: Browser, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """A low patch about (3, 0, 0.05) and a high one about (0, 3, 1.05), from above.

    Returns:
        Row and column in the 3-D view [px] of the middle of the low and of the high patch.
    """
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=10.0))
    steps = np.arange(-0.5, 0.5, 0.03)
    patch = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    low = np.column_stack([patch + np.array([3.0, 0.0]), np.full(len(patch), 0.05)])
    high = np.column_stack([patch + np.array([0.0, 3.0]), np.full(len(patch), 1.05)])
    for _ in range(4):
        pose = make_transform(np.eye(3), np.array([0.0, 0.0, 4.0]))
        voxel_map.integrate(np.concatenate([low, high]) - (0.0, 0.0, 4.0), pose)
    write_map_report(path, voxel_map, "Two patches")
    browser.open(path)
    click(browser, "[data-camera=top]")
    image = picture(browser)[..., :3].astype(int)
    blue, green, red = np.moveaxis(image, 2, 0)
    yellow, violet = (red - blue > 80), (blue - green > 40)
    assert yellow.sum() > 500
    assert violet.sum() > 500
    return np.argwhere(violet).mean(axis=0), np.argwhere(yellow).mean(axis=0)


def test_from_above_x_points_right_and_y_up(window: Browser, tmp_path: Path) -> None:
    low, high = two_patches(window, tmp_path / "map.html")
    assert low[1] > high[1] + 50.0
    assert high[0] < low[0] - 50.0


def test_two_clicks_measure_and_escape_forgets(window: Browser, tmp_path: Path) -> None:
    places = two_patches(window, tmp_path / "map.html")
    marked = "document.getElementById('marked').innerText"
    window.evaluate("document.getElementById('map').scrollIntoView({behavior: 'instant'})")
    window.frame()
    x, y, _, _ = stage(window)
    window.click(x + places[0][1], y + places[0][0])
    assert "sigma, probability" in window.evaluate(marked)
    assert "distance" not in window.evaluate(marked)
    window.click(x + places[1][1], y + places[1][0])
    told = re.findall(
        r"(level distance|straight distance|height difference)\t(.*) m", window.evaluate(marked)
    )
    values = {name: float(value.replace("\u2212", "-")) for name, value in told}
    assert values["straight distance"] == pytest.approx(np.sqrt(19.0), abs=0.2)
    assert values["level distance"] == pytest.approx(np.sqrt(18.0), abs=0.2)
    assert values["height difference"] == pytest.approx(1.0, abs=0.11)
    window.evaluate("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
    assert "distance" not in window.evaluate(marked)


def overlapping(texts: list[tuple[str, float, float, float, float]]) -> list[tuple[str, str]]:
    """Pairs of texts that share more than the leading of their lines."""
    found = []
    for (one, *a), (other, *b) in combinations(texts, 2):
        width = min(a[2], b[2]) - max(a[0], b[0])
        height = min(a[3], b[3]) - max(a[1], b[1])
        if width > 1.0 and height > 2.0:
            found.append((one, other))
    return found


@pytest.fixture(scope="module")
def pages(report: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The reports of a run, of a map below a ceiling, and of two runs compared."""
    folder = tmp_path_factory.mktemp("pages")
    runs = {}
    for name in ("first_of_two_with_a_name_that_is_much_too_long_for_a_phone", "second"):
        runs[name] = folder / name
        runs[name].mkdir()
        write_log(runs[name] / "exploration.jsonl")
        made_up_map(voxel_size=0.1).save(runs[name] / "map.infomap")
        figures = {"pose_error_rms": 0.0071, "simulated_seconds": 312.5, "memory_bytes": 9113658}
        (runs[name] / "summary.json").write_text(json.dumps(figures), encoding="utf-8")
    write_comparison(folder / "comparison.html", runs)
    write_map_report(folder / "map.html", room_with_a_ceiling(), "A room", figures=figures)
    return {
        "report": report,
        "map": folder / "map.html",
        "comparison": folder / "comparison.html",
    }


@pytest.mark.parametrize("width", [1500, 400])
@pytest.mark.parametrize("name", ["report", "map", "comparison"])
def test_no_two_texts_overlap_and_nothing_is_wider_than_the_page(
    window: Browser, pages: dict[str, Path], name: str, width: int
) -> None:
    window.resize(width, 1000)
    turns = ["[data-camera=home]", "[data-camera=top]", "[data-camera=side]"]
    clicks = [] if name == "comparison" else [*turns, "input[value=sigma]"]
    try:
        window.open(pages[name])
        if clicks:
            click(window, "input[name=surface]")  # takes long to draw
        if name == "report":
            click(window, "input[name=views]")  # their numbers lie where the views are
        for selector in clicks or ["body"]:
            click(window, selector)
            window.frame()
            texts = [text for text in window.texts() if text[3] > 0.0]
            assert len(texts) > 30
            assert overlapping(texts) == [], selector
            assert [text for text in texts if text[1] < 0.0 or text[3] > width] == []
        assert window.evaluate("document.documentElement.scrollWidth") <= width
        if clicks and width == 400:
            _, _, shown_width, height = stage(window)
            assert height <= 1.1 * shown_width
    finally:
        window.resize(*SIZE)


def room_with_a_ceiling() -> VoxelMap:
    """A floor at 0 m and half a table at 1 m below a ceiling at 2.5 m, seen from between."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=10.0))
    steps = np.arange(-1.5, 1.5, 0.03)
    x, y = (each.ravel() for each in np.meshgrid(steps, steps))
    below = np.column_stack([x, y, np.where(x < 0.0, 0.5, 1.5)])
    above = np.column_stack([x, y, np.full(len(x), 1.0)])
    for turn, points in ((np.diag([1.0, -1.0, -1.0]), below), (np.eye(3), above)):
        for _ in range(4):
            voxel_map.integrate(points, make_transform(turn, np.array([0.0, 0.0, 1.5])))
    return voxel_map


def test_a_room_opens_without_its_ceiling_and_any_height_can_be_cut(
    window: Browser, pages: dict[str, Path]
) -> None:
    window.open(pages["map"])
    told = "document.getElementById('cut-text').textContent"
    assert 1.0 <= float(window.evaluate(told).removesuffix(" m")) < 2.5
    click(window, "[data-camera=side]")
    click(window, "input[name=axes]")
    heights = []
    for share in (None, 0.2, 1.0):
        if share is not None:
            move = f"s.value = {share} * s.max; s.dispatchEvent(new Event('input'))"
            window.evaluate(f"(() => {{ const s = document.getElementById('cut'); {move}; }})()")
        image = picture(window)
        heights.append(float(np.ptp(np.argwhere((image != image[-1, -1]).any(axis=(1, 2))))))
    assert window.evaluate(told) == "nothing"
    table, floor, ceiling = heights
    assert floor + 50.0 < table < ceiling - 50.0  # [px]


def test_without_webgl_it_says_so_and_shows_the_pictures(report: Path, tmp_path: Path) -> None:
    assert find_browser() is not None, MISSING
    with Browser(tmp_path / "profile", NO_WEBGL, SIZE) as browser:
        browser.open(report)
        assert browser.evaluate("document.documentElement.dataset.ready") == "2d"
        notice = browser.evaluate("document.getElementById('notice').innerText")
        assert "No 3-D view here (WebGL 2 is not available)" in notice
        shown = "(s) => document.querySelector(s).getBoundingClientRect().height"
        assert browser.evaluate(f"({shown})('svg.plan image')") > 100
        assert browser.evaluate(f"({shown})('svg.chart polyline')") > 20
        click(browser, "#theme")
        complaints = [text for text in browser.complaints if "WebGL" not in text]
        assert complaints == []
