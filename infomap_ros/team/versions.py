"""Versions of what a robot publishes: numbers of 32 bits that begin again at 1 after the last.

Of two versions the newer one is that which follows the other by less than half the numbers there
are, as for serial numbers in RFC 1982 (https://doi.org/10.17487/RFC1982). 0 is no version: it
stands for "nothing heard yet". A robot takes its first version from the clock, so that what it
says after a restart is newer than what it said before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

COUNT = 2**32
CLOCK_RATE = 32
"""Versions per second of the clock; a robot that publishes less often stays behind the clock."""


def version_at(nanoseconds: int) -> int:
    """The version that belongs to a time since the epoch [ns]; it begins again after 4 years."""
    ticks = nanoseconds * CLOCK_RATE // 1_000_000_000
    return ticks % (COUNT - 1) + 1


def next_version(version: int) -> int:
    """The version after this one."""
    return version % (COUNT - 1) + 1


def versions_ahead(version: Any, other: int) -> Any:
    """By how many versions one follows another, or several; negative where they precede it."""
    return (version - other + COUNT // 2) % COUNT - COUNT // 2


@njit(cache=True, nogil=True)
def is_newer(version: Any, other: Any) -> bool:
    """Whether one version, uint32, is newer than another; every version is newer than none (0)."""
    ahead = (np.int64(version) - np.int64(other)) & 0xFFFFFFFF
    return bool(other == 0 or 0 < ahead < 0x80000000)
