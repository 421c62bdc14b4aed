"""Memory that is ready before the first message, so that large messages flow evenly.

The first use of a page of memory costs the kernel 1 to 10 us, so a cloud of 12 MB in new memory
costs up to 30 ms in every place where it is stored. Without care this happens whenever a message
waits a little longer than usual: it takes new memory, which takes time, in which more messages
wait. Here a node keeps the memory that it frees for the next message, has some from the start, and
has used all of the shared memory through which Fast DDS sends.

Everything here only saves time: what the system does not offer is left out.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from infomap_ros.geometry.config import check_config, setting

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # of mallopt(3)
_LARGEST_HEAP_BLOCK = 32 * 1024**2  # [bytes], the most that glibc accepts
_HEAP_KEPT = 1024**3  # [bytes]
_POPULATE_WRITE = 23  # of madvise(2), Linux 5.14
_PAGE = 4096
_SEGMENT = "/dev/shm/fastrtps_"


@dataclass(frozen=True)
class MemoryConfig:
    """How much memory a node has ready.

    Raises:
        ConfigError: a value is out of its range.
    """

    reserved_memory: float = setting(
        128.0,
        "Memory that is made ready at the start for messages that wait; 10 clouds of 640x480 "
        "points are 123 MB.",
        unit="MB",
        low=0.0,
        high=100_000.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


def keep_freed_memory() -> bool:
    """Let all threads take memory from one heap, which keeps up to 1 GB of what they free.

    By default the C library has a heap per thread and gives large blocks back at once. To be
    called before other threads start; importing `infomap_ros.nodes` does so.

    Returns:
        Whether the C library can do so (glibc can).
    """
    options = {_ARENA_MAX: 1, _MMAP_THRESHOLD: _LARGEST_HEAP_BLOCK, _TRIM_THRESHOLD: _HEAP_KEPT}
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and all(mallopt(key, value) for key, value in options.items())


class _HeapFigures(ctypes.Structure):
    """The answer of mallinfo2(3), glibc 2.33."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("0", "1", "2", "3", "in_mappings", "5", "6", "in_use", "8", "9")
    )


def heap_in_use() -> int | None:
    """Memory of the C library's heap that this process has not freed [bytes].

    How much of the machine's memory a process holds does not tell it: freed memory is kept.

    Returns:
        The figure; None where the C library does not tell.
    """
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo is None:
        return None
    mallinfo.restype = _HeapFigures
    figures = mallinfo()
    return int(figures.in_use) + int(figures.in_mappings)


def reserve_heap(config: MemoryConfig) -> None:
    """Use memory of the heap once and free it; `keep_freed_memory` keeps it."""
    step = _LARGEST_HEAP_BLOCK // 2
    blocks = [np.empty(step, np.uint8) for _ in range(round(config.reserved_memory * 1e6) // step)]
    for block in blocks:
        block[::_PAGE] = 1


def use_shared_memory() -> int:
    """Use all of the shared memory of Fast DDS that this process has so far.

    Returns:
        Its size [bytes].
    """
    total, madvise = 0, ctypes.CDLL(None).madvise
    for line in Path("/proc/self/maps").read_text().splitlines():
        place, access, *_ = line.split()
        if _SEGMENT in line and access.startswith("rw"):
            begin, end = (int(address, 16) for address in place.split("-"))
            address, size = ctypes.c_void_p(begin), ctypes.c_size_t(end - begin)
            total += end - begin if madvise(address, size, _POPULATE_WRITE) == 0 else 0
    return total
