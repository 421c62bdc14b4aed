"""Work ahead in a second thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable
from typing import TypeVar

Item = TypeVar("Item")

_POLL = 0.1  # [s]


class _End:
    """Marks the end of the items, and carries the error that ended them, if any."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


def in_background(items: Iterable[Item], ahead: int = 2) -> Generator[Item, None, None]:
    """Give out the items of an iterable that runs in a thread of its own.

    The order stays, and an error in the iterable is raised here. When the caller stops early (or
    closes the generator) the thread ends after the item it is at.

    Args:
        items: what is run in the thread.
        ahead: how many items wait at most.
    """
    ready: queue.Queue[Item | _End] = queue.Queue(maxsize=ahead)
    stopped = threading.Event()

    def put(item: Item | _End) -> bool:
        while not stopped.is_set():
            try:
                ready.put(item, timeout=_POLL)
            except queue.Full:
                continue
            return True
        return False

    def work() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                if not put(item):
                    return
        except BaseException as caught:
            error = caught
        put(_End(error))

    thread = threading.Thread(target=work, name="in_background", daemon=True)
    thread.start()
    try:
        while not isinstance(item := ready.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stopped.set()
        thread.join()
