"""An end for a process that its middleware does not let go.

Fast DDS 2.14 may wait for ever, on one whole core, for a participant to be deleted while others
leave, as at a Ctrl-C that reaches all nodes of a graph: ``DomainParticipant::set_listener`` waits
for a callback of the discovery, which waits for what the deletion holds. It keeps Python's lock
meanwhile, so nothing that is Python can end it. A timer of POSIX can, whose thread calls ``_exit``.
"""

from __future__ import annotations

import ctypes
import sys

from infomap_ros.nodes.common.interrupts import runs_a_node

_LONGEST = 5.0  # [s]; deleting takes below 0.1 s, and whoever launched the nodes waits 5 to 10 s
_MONOTONIC, _CALLS_A_FUNCTION = 1, 2  # CLOCK_MONOTONIC and SIGEV_THREAD of Linux


class _Event(ctypes.Structure):
    """``struct sigevent`` of Linux, 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_byte * 32),
    )


class _Times(ctypes.Structure):
    """``struct itimerspec``: seconds and nanoseconds of the interval and of the first time."""

    _fields_ = (
        ("interval", ctypes.c_long),
        ("interval_rest", ctypes.c_long),
        ("first", ctypes.c_long),
        ("first_rest", ctypes.c_long),
    )


def part_soon() -> None:
    """Have the process of a node end by itself, whatever holds it; what it had to save is saved.

    Where the process was started for something else, such as a test, nothing is done.
    """
    if runs_a_node():
        exit_within(_LONGEST)


def exit_within(seconds: float) -> None:
    """End this process with status 0 after so many seconds, if it is still there; on Linux."""
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    sys.stderr.flush()
    leave = ctypes.cast(libc._exit, ctypes.c_void_p).value  # called with the value, which is 0
    event, timer = _Event(0, 0, _CALLS_A_FUNCTION, leave, None), ctypes.c_void_p()
    if libc.timer_create(_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        whole = int(seconds)
        times = _Times(0, 0, whole, max(1, int(1e9 * (seconds - whole))))
        libc.timer_settime(timer, 0, ctypes.byref(times), None)
