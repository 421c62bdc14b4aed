"""What a robot sends of its contribution: states of voxels, already in the codes of the wire.

The messages that a robot sent lately, so that those which got lost can be sent again.

Versions of what a robot publishes: numbers of 32 bits that begin again at 1 after the last.

Of two versions the newer one is that which follows the other by less than half the numbers there
are, as for serial numbers in RFC 1982 (https://doi.org/10.17487/RFC1982). 0 is no version: it
stands for "nothing received yet". A robot takes its first version from the clock, so that what it
says after a restart is newer than what it said before.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import NOT_OBSERVED, SHARED_LOG_ODDS_LIMIT, VoxelChanges
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, COORDINATE_LIMIT, pack_all
from infomap_ros.team.gaussian_code import decode_gaussians, encode_gaussians
from infomap_ros.team.message_header import with_header_values

MAX_ROBOT, MAX_VERSION, MAX_SESSION = 2**16 - 1, 2**32 - 1, 2**32 - 1
MAX_SERIAL = 2**31 - 1
MAX_ORIGIN = 2**32 - 1


@dataclass(frozen=True, eq=False)
class MapUpdate:
    """Absolute states of voxels in one robot's contribution.

    Attributes:
        voxel_size: edge of a voxel [m].
        robot: id of the robot whose contribution it is, 0 to 65535.
        versions: of the robot's publication in which each state was taken, shape (K,), uint32,
            1 to 2^32 - 1.
        indices: shape (K, 3), int32; the voxel's center is (index + 0.5) * voxel_size [m, map].
        log_odds: shape (K,), int8, in units of `mapping.LOG_ODDS_QUANTUM` and within +-
            `mapping.SHARED_LOG_ODDS_LIMIT`, or `NOT_OBSERVED`.
        codes: of the surface points, shape (K, 2), uint64, see `team.gaussian_code`; 0 for none.
        session: number that the robot draws when it starts.
        sender: id of the robot that sends it, where that is another one.
        serial: number of the message among those of the robot that sends it, None without one.
        origin: names the frame in which the states are, as in `PoseUncertainty`; 0 where unknown.
    """

    voxel_size: float
    robot: int
    versions: NDArray[np.uint32]
    indices: NDArray[np.int32]
    log_odds: NDArray[np.int8]
    codes: NDArray[np.uint64]
    session: int = 0
    sender: int | None = None
    serial: int | None = None
    origin: int = 0

    def __post_init__(self) -> None:
        """Check everything but the voxels' states, which `check_states` does.

        Raises:
            InvalidInputError: a number is out of its range.
        """
        if not 0 <= self.robot <= MAX_ROBOT or not 0 <= self.session <= MAX_SESSION:
            raise InvalidInputError("map update", f"robot {self.robot}, session {self.session}")
        if not (np.isfinite(self.voxel_size) and self.voxel_size > 0.0):
            raise InvalidInputError("map update", f"voxel size {self.voxel_size} m")

    @classmethod
    def of_changes(
        cls,
        changes: VoxelChanges,
        voxel_size: float,
        robot: int,
        version: int,
        session: int = 0,
        origin: int = 0,
    ) -> MapUpdate:
        """The update with the changes of a robot's map.

        Raises:
            InvalidInputError: a Gaussian is not finite, not positive definite or a voxel away
                from its voxel, or a number is out of its range.
        """
        if not 1 <= version <= MAX_VERSION:
            raise InvalidInputError("map update", f"version {version}")
        indices, surface = changes.indices, changes.has_gaussian
        codes = np.zeros((len(indices), 2), np.uint64)
        offsets = changes.means[surface] / voxel_size - (indices[surface] + 0.5)
        codes[surface] = encode_gaussians(offsets, changes.covariances[surface] / voxel_size**2)
        versions = np.full(len(indices), version, np.uint32)
        states = versions, indices, changes.log_odds, codes
        update = cls(voxel_size, robot, *states, session, origin=origin)
        update.check_states()
        return update

    @property
    def version(self) -> int:
        """Version of the first state; all have the same unless the update is passed on."""
        return int(self.versions[0]) if len(self.versions) else 0

    @property
    def newest(self) -> np.uint32:
        """The newest of the versions; 0 without states."""
        newest = np.uint32(0)
        for version in np.unique(self.versions):
            newest = version if is_newer(version, newest) else newest
        return newest

    @property
    def has_gaussian(self) -> NDArray[np.bool_]:
        """Where there is a surface point, shape (K,)."""
        return np.asarray(self.codes[:, 1] != 0)

    @property
    def means(self) -> FloatArray:
        """Of the surface points, shape (K, 3) [m, map]; NaN where there is none."""
        return (self._gaussians[0] + (self.indices + 0.5)) * self.voxel_size

    @property
    def covariances(self) -> FloatArray:
        """Shape (K, 3, 3) [m^2]; NaN where there is none."""
        return self._gaussians[1] * self.voxel_size**2

    @cached_property
    def _gaussians(self) -> tuple[FloatArray, FloatArray]:
        return decode_gaussians(self.codes)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> MapUpdate:
        """The states that a mask or a list of rows chooses."""
        return MapUpdate(
            self.voxel_size,
            self.robot,
            self.versions[chosen],
            self.indices[chosen],
            self.log_odds[chosen],
            self.codes[chosen],
            self.session,
            self.sender,
            origin=self.origin,
        )

    def in_order_of_blocks(self) -> MapUpdate:
        """The same states, those of a block one after another."""
        keys = pack_all((self.indices >> BLOCK_BITS).astype(np.int64))
        if (keys[1:] >= keys[:-1]).all():
            return self
        return self.rows(np.argsort(keys, kind="stable"))

    def as_sent_by(self, session: int, sender: int | None, version: int | None) -> MapUpdate:
        """The same states in another session, from another sender, at a version if one is given."""
        versions = self.versions if version is None else np.full_like(self.versions, version)
        states = versions, self.indices, self.log_odds, self.codes
        return MapUpdate(self.voxel_size, self.robot, *states, session, sender, origin=self.origin)

    def check_states(self) -> None:
        """Refuse what no robot can mean.

        Raises:
            InvalidInputError: log-odds beyond the limit, a voxel beyond the coordinate limits, a
                version of 0, or a surface in a voxel that is not observed.
        """
        odds = self.log_odds
        wrong = (np.abs(odds.astype(np.int16)) > SHARED_LOG_ODDS_LIMIT) & (odds != NOT_OBSERVED)
        if wrong.any():
            raise InvalidInputError("map update", f"log-odds {int(odds[wrong][0])}")
        indices = self.indices
        if ((indices < -COORDINATE_LIMIT) | (indices >= COORDINATE_LIMIT)).any():
            raise InvalidInputError("map update", "a voxel lies outside the coordinate limits")
        if (self.versions == 0).any():
            raise InvalidInputError("map update", "version 0")
        if ((odds == NOT_OBSERVED) & self.has_gaussian).any():
            raise InvalidInputError("map update", "a voxel that is not observed has a surface")


def are_one_frame(origin: int, other: int) -> bool:
    """Whether two origins name one frame; who names none is taken to be in it."""
    return origin == other or not (origin and other)


class SentMessages:
    """Numbers messages and keeps the last ones.

    Args:
        serial: number of the message before the first.
        room: for the messages that are kept [bytes].
        request_timeout: for so long after a message was sent again, it is on its way [s].
    """

    def __init__(self, serial: int, room: float, request_timeout: float) -> None:
        self.serial = serial
        self._room, self._held, self._request_timeout = room, 0, request_timeout
        self._resent: dict[int, float] = {}
        self._messages: dict[int, NDArray[np.void]] = {}
        self._asked: set[int] = set()

    def number(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """The message with its number."""
        self.serial = (self.serial + 1) % MAX_SERIAL
        rows = with_header_values(rows, {"serial": self.serial})
        self._messages[self.serial] = rows
        self._held += rows.nbytes
        while self._held > self._room and len(self._messages) > 1:
            oldest = next(iter(self._messages))
            self._held -= self._messages.pop(oldest).nbytes
            self._resent.pop(oldest, None)
        return rows

    def ask(self, serials: Iterable[int], now: float) -> None:
        """Have messages sent again, as far as they are kept and not on their way."""
        for serial in serials:
            since = now - self._resent.get(serial, -np.inf)
            if serial in self._messages and since >= self._request_timeout:
                self._asked.add(serial)

    def resend(self, room: float, now: float) -> list[NDArray[np.void]]:
        """Messages to be sent again, oldest first, as many as fit [bytes].

        What was sent again before and is still missed is sent twice.
        """
        chosen: list[NDArray[np.void]] = []
        for serial in [number for number in self._messages if number in self._asked]:
            copies = [self._messages[serial]] * (2 if serial in self._resent else 1)
            room -= sum(map(message_bytes, copies))
            if room < 0.0 and chosen:
                return chosen
            self._asked.remove(serial)
            self._resent[serial] = now
            chosen += copies
        self._asked.clear()
        return chosen


def message_bytes(rows: NDArray[np.void]) -> int:
    """Bytes of the message that holds these rows, about."""
    return int(rows.nbytes) + 80 + sum(24 + len(name) for name in rows.dtype.names or ())


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
