"""The report of an exploration as an animation: the map grows from decision to decision.

Opens a report in a browser without a window (Chromium), goes through its decisions while the view
turns, and writes an animated picture; needs pillow, which comes with Matplotlib.

    python benchmarks/animate_report.py out/demo/report.html --out docs/figures/exploration.webp
"""

from __future__ import annotations

import argparse
import base64
import importlib.util
import io
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from PIL import Image

from infomap_ros.geometry.atomic_file import replacing

_BROWSER = Path(__file__).parents[1] / "test" / "exploration" / "browser.py"
_STEP = """(() => {
  const slider = document.getElementById('step');
  slider.value = %d;
  slider.dispatchEvent(new Event('input'));
})()"""
_STAGE = """(() => {
  const box = document.getElementById('scene').getBoundingClientRect();
  return [box.left, box.top, box.width, box.height];
})()"""
_DRAWN = "document.getElementById('scene').dataset.drawn === 'whole'"
_TURN = 5.0  # of the mouse from frame to frame [px]


def browser_module() -> ModuleType:
    """The browser that the tests drive."""
    spec = importlib.util.spec_from_file_location("browser", _BROWSER)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["browser"] = module
    spec.loader.exec_module(module)
    return module


def frames(report: Path, size: tuple[int, int], seconds: float, rate: float) -> list[Image.Image]:
    """Pictures of the 3-D view, one decision after the other."""
    tools = browser_module()
    with (
        tempfile.TemporaryDirectory() as folder,
        tools.Browser(Path(folder) / "profile", tools.SOFTWARE_WEBGL, size) as browser,
    ):
        browser.open(report)
        decisions = int(browser.evaluate("document.getElementById('step').max")) + 1
        left, top, width, height = browser.evaluate(_STAGE)
        clip = {"x": left, "y": top, "width": width, "height": height, "scale": 1}
        x, y = left + 0.8 * width, top + 0.8 * height
        count = round(seconds * rate)
        taken: list[Image.Image] = []
        for number in range(count):
            browser.evaluate(_STEP % min(decisions - 1, number * (decisions + 1) // count))
            browser.drag((x, y), (x + _TURN, y))
            browser.wait(_DRAWN)
            taken.append(_picture(browser, clip))
    return taken


def _picture(browser: Any, clip: dict[str, float]) -> Image.Image:
    answer = browser.send("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
    return Image.open(io.BytesIO(base64.b64decode(answer["data"]))).convert("RGB")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("report", type=Path)
    parser.add_argument("--out", type=Path, required=True, help=".webp or .gif")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=6.0, help="frames per second")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 900), help="of the window [px]")
    given = parser.parse_args()
    taken = frames(given.report, tuple(given.size), given.seconds, given.rate)
    pause = [round(1000.0 / given.rate)] * (len(taken) - 1) + [2000]
    with replacing(given.out) as file:
        taken[0].save(
            file,
            format=given.out.suffix[1:],
            save_all=True,
            append_images=taken[1:],
            duration=pause,
            loop=0,
            quality=70,
        )
    print(f"{given.out}: {len(taken)} frames, {given.out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
