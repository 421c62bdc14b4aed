"""Have kernels compiled before the first message, and say so where that takes long."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from numba.core.event import Event, Listener, install_listener
from rclpy.node import Node


def prepare_kernels(node: Node, use: Callable[[], object], seconds: float) -> None:
    """Use kernels once, so that they are compiled; with the first that is not, say how long.

    Args:
        node: that says it.
        use: uses each kernel once.
        seconds: how long that takes where nothing is compiled yet, on two cores [s].
    """
    start, log = time.monotonic(), node.get_logger()
    notice = f"compiling kernels, about {seconds:.0f} s, once"
    with install_listener("numba:compile", _FirstTime(lambda: log.info(notice))):
        use()
    log.info(f"kernels ready after {time.monotonic() - start:.1f} s")


class _FirstTime(Listener):
    """Tells that a kernel is compiled: one that is in numba's cache causes no event."""

    def __init__(self, tell: Callable[[], Any]) -> None:
        self._tell, self._has_told = tell, False

    def on_start(self, event: Event) -> None:
        if not self._has_told:
            self._has_told = True
            self._tell()

    def on_end(self, event: Event) -> None:
        """Nothing is to be said."""
