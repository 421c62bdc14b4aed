"""A real browser without a window, driven through the DevTools protocol over a pipe."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
MISSING = "the report's test needs a browser: sudo apt-get install chromium (or Google Chrome)"
_FLAGS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--disable-crash-reporter",
    "--hide-scrollbars",
    "--force-device-scale-factor=1",
    "--force-color-profile=srgb",
)
SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-gpu", "--disable-3d-apis")
_PATIENCE = 60.0  # [s]
_RECORD_CANVAS_TEXT = """
const { fillText, clearRect } = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.clearRect = function (...box) {
  this.canvas.texts = [];
  clearRect.apply(this, box);
};
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...more) {
  const width = this.measureText(text).width;
  const left = x - { left: 0, center: 0.5, right: 1 }[this.textAlign] * width;
  (this.canvas.texts ||= []).push([text, left, y - 4, left + width, y + 4]);
  fillText.call(this, text, x, y, ...more);
};
"""
_TEXTS = """
(() => {
  const found = [], range = document.createRange();
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, holder = node.parentElement;
    if (!node.data.trim() || holder.closest("script, style, title")) continue;
    if (!holder.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    range.selectNodeContents(node);
    for (const line of range.getClientRects()) {
      const box = [line.left, line.top, line.right, line.bottom];
      for (let above = holder; above !== document.body; above = above.parentElement) {
        if (getComputedStyle(above).overflowX === "visible") continue;
        if (above instanceof SVGElement && above.tagName !== "svg") continue;
        const edge = above.getBoundingClientRect();
        box[0] = Math.max(box[0], edge.left), box[1] = Math.max(box[1], edge.top);
        box[2] = Math.min(box[2], edge.right), box[3] = Math.min(box[3], edge.bottom);
      }
      if (box[2] - box[0] > 1 && box[3] - box[1] > 1) found.push([node.data.trim(), ...box]);
    }
  }
  for (const canvas of document.querySelectorAll("canvas")) {
    const edge = canvas.getBoundingClientRect();
    for (const [text, left, top, right, bottom] of canvas.texts || [])
      found.push([text, left + edge.x, top + edge.y, right + edge.x, bottom + edge.y]);
  }
  return found;
})()
"""
_AS_3_AND_4 = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for end, number in zip(ends, (3, 4)):
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])
"""


def find_browser() -> str | None:
    """Path of the first browser that is installed."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


class Browser:
    """One browser with one page.

    Attributes:
        requests: addresses that the page asked for.
        complaints: errors and warnings on its console, and exceptions.
    """

    def __init__(self, profile: Path, flags: tuple[str, ...], size: tuple[int, int]) -> None:
        program = find_browser()
        assert program is not None, MISSING
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
        command = [program, *_FLAGS, *sandbox, *flags]
        command += [
            f"--user-data-dir={profile}",
            f"--window-size={size[0]},{size[1]}",
            "about:blank",
        ]
        self._log = (profile.parent / f"{profile.name}.log").open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-c", _AS_3_AND_4, str(theirs_in), str(theirs_out), *command],
            pass_fds=(theirs_in, theirs_out),
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._buffer, self._number = b"", 0
        self._messages: deque[dict[str, Any]] = deque()
        self._session = ""
        self._attach(size)

    def _attach(self, size: tuple[int, int]) -> None:
        targets = self.send("Target.getTargets")["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self.send("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        self.send("Page.addScriptToEvaluateOnNewDocument", source=_RECORD_CANVAS_TEXT)
        self.resize(*size)

    def resize(self, width: int, height: int) -> None:
        """Make the page so large [px]."""
        values = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.send("Emulation.setDeviceMetricsOverride", **values)

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol; returns its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def _receive(self) -> dict[str, Any]:
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"the browser says nothing; see {self._log.name}"
            data = os.read(self._in, 1 << 20)
            assert data, f"the browser has ended: {Path(self._log.name).read_text()[-2000:]}"
            self._buffer += data
        line, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(line)
        self._note(message)
        return message

    def _note(self, message: dict[str, Any]) -> None:
        event, values = message.get("method"), message.get("params", {})
        if event == "Network.requestWillBeSent":
            self.requests.append(values["request"]["url"][:200])
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(values["exceptionDetails"])[:1000])
        elif event == "Runtime.consoleAPICalled" and values["type"] in ("error", "warning"):
            self.complaints.append(json.dumps(values["args"])[:1000])
        elif event == "Log.entryAdded" and values["entry"]["level"] in ("error", "warning"):
            self.complaints.append(values["entry"]["text"])

    def open(self, path: Path) -> None:
        """Load a file and wait until its script has ended."""
        self.send("Page.navigate", url=path.resolve().as_uri())
        self.wait("Boolean(document.documentElement?.dataset.ready)")

    def evaluate(self, expression: str) -> Any:
        """Value of an expression of the page, promises awaited."""
        options = {"awaitPromise": True, "returnByValue": True}
        answer = self.send("Runtime.evaluate", expression=expression, **options)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until a condition of the page holds."""
        end = time.monotonic() + _PATIENCE
        frame = "new Promise((done) => setTimeout(done, 30))"
        while not self.evaluate(condition):
            assert time.monotonic() < end, f"never: {condition}"
            self.evaluate(frame)

    def frame(self) -> None:
        """Wait until what was asked for has been drawn."""
        self.evaluate("new Promise((d) => requestAnimationFrame(() => requestAnimationFrame(d)))")

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """One event of the mouse at a place of the page [px]."""
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", clickCount=1, buttons=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)

    def drag(
        self, start: tuple[float, float], end: tuple[float, float], button: str = "left"
    ) -> None:
        """Drag with a button pressed."""
        buttons = {"left": 1, "right": 2}[button]
        self.mouse("mousePressed", *start, button=button, clickCount=1, buttons=buttons)
        for share in (0.25, 0.5, 0.75, 1.0):
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, button=button, buttons=buttons)
        self.mouse("mouseReleased", *end, button=button, clickCount=1)

    def texts(self) -> list[tuple[str, float, float, float, float]]:
        """Each line of text that can be seen: left, top, right, bottom [px, window].

        What its holder cuts off (a table that scrolls) does not count; text that was drawn on a
        canvas does.
        """
        return [tuple(found) for found in self.evaluate(_TEXTS)]

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Picture of what the window, or the whole page, shows."""
        answer = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))

    def close(self) -> None:
        """End the browser."""
        os.close(self._out)  # it ends when its pipe does
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(20.0)
        os.close(self._in)
        self._log.close()

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
