"""Requests of the user to a running exploration."""

from __future__ import annotations

import threading
from enum import Enum


class Request(Enum):
    """What the user wants."""

    RUN = "run"
    PAUSE = "pause"
    HOME = "home"
    STOP = "stop"


class Control:
    """The last request, shared by the thread that explores and those that ask of it.

    The last request counts; only STOP is final.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._request = Request.RUN

    @property
    def request(self) -> Request:
        """The request that holds now."""
        with self._changed:
            return self._request

    def ask(self, request: Request) -> bool:
        """Make a request; returns False when it comes too late, after STOP."""
        with self._changed:
            if self._request is Request.STOP:
                return request is Request.STOP
            self._request = request
            self._changed.notify_all()
            return True

    def answered(self, request: Request, then: Request) -> None:
        """Note that `request` is carried out; `then` holds unless something else was asked."""
        with self._changed:
            if self._request is request:
                self._request = then
                self._changed.notify_all()

    def interrupted(self) -> bool:
        """Whether a motion is to be broken off."""
        return self.request is not Request.RUN

    def wait(self, seconds: float) -> None:
        """Sleep, but not beyond the next request."""
        with self._changed:
            before = self._request
            self._changed.wait_for(lambda: self._request is not before, seconds)

    def wait_while_paused(self) -> Request:
        """Wait until the request is no longer PAUSE; returns it."""
        with self._changed:
            self._changed.wait_for(lambda: self._request is not Request.PAUSE)
            return self._request
