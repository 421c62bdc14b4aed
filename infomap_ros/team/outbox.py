"""What a robot sends of the map, within its bandwidth: what carries most information first.

Two streams share the bandwidth: changes of the own contribution, and answers to those who ask for
what they missed, of any contribution that is held. Both are ordered by bits per byte, in blocks of
8x8x8 voxels, as their parts would take more bytes; what waits gains on what is new. What changed
only a little (`team.priority`) is sent when nothing else waits.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.mapping import NOT_OBSERVED, VoxelMap
from infomap_ros.mapping.voxels.changes import changed_blocks, take_changes
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT
from infomap_ros.mapping.voxels.state import count_block_changes
from infomap_ros.team.config import REQUEST_TIMEOUT, Budget, TeamConfig
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.contribution_kernels import list_blocks
from infomap_ros.team.own_version import OwnVersion
from infomap_ros.team.priority import ChangePriority, priority_of_changes, priority_of_states
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MAX_SERIAL, MapUpdate, SentMessages, message_bytes, next_version
from infomap_ros.team.wire import encode_update

_WAIT = 0.5  # [s] after which what waits counts four times, after twice that nine times
_MOST_VOXELS = 1 << 20
Slots = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Outbox:
    """Chooses what is sent next.

    Args:
        robot: id of this robot.
        session: number that it drew when it started.
        version: to begin with.
        replica: what was sent and received.
        config: of the team.
    """

    def __init__(
        self, robot: int, session: int, version: int, replica: MapReplica, config: TeamConfig
    ) -> None:
        self.robot, self.session, self.own_version = robot, session, OwnVersion(version)
        self.budget = Budget(config.bandwidth * 1e6)
        self._replica, self._config = replica, config
        self._answers: dict[int, set[int]] = {}
        self._since = np.zeros(0)
        self._taken_back = np.empty((0, 3), np.int32)
        self._touched: list[NDArray[np.int32]] = []
        kept, in_transit = 2e6 * config.bandwidth, 1.5 * REQUEST_TIMEOUT
        self._sent = SentMessages(version % MAX_SERIAL, kept, in_transit)

    @property
    def version(self) -> int:
        """Version of the last publication."""
        return self.own_version.number

    @property
    def serial(self) -> int:
        """Number of the last message."""
        return self._sent.serial

    def resend(self, serials: Iterable[int], now: float) -> None:
        """Send some messages again, when there is room."""
        self._sent.ask(serials, now)

    @property
    def waiting(self) -> bool:
        """Whether somebody waits for an answer, or voxels wait to be taken back."""
        return any(self._answers.values()) or len(self._taken_back) > 0

    def answer(self, robot: int, slots: Slots) -> None:
        """Send the blocks of a contribution that is held, when there is room."""
        self._answers.setdefault(robot, set()).update(slots.tolist())

    def take_back(self, indices: NDArray[np.int32]) -> None:
        """Say of these voxels, shape (K, 3), that they are not observed, unless they are again."""
        self._taken_back = np.concatenate([self._taken_back, indices])

    def take_touched(self) -> NDArray[np.int32]:
        """Blocks of the own contribution that were sent since the last call, shape (n, 3)."""
        touched, self._touched = self._touched, []
        if not touched:
            return np.empty((0, 3), np.int32)
        return np.unique(np.concatenate(touched), axis=0)

    def updates(self, voxel_map: VoxelMap | None, now: float) -> list[NDArray[np.void]]:
        """The messages that may be sent now.

        Args:
            voxel_map: own contribution, which tracks its changes; None where there is none.
            now: time of any steady clock [s].

        Returns:
            Rows of map updates, one array a message.
        """
        if voxel_map is not None and self._replica.begin_frame(self.robot, voxel_map.origin):
            mark_all(voxel_map)
            self._answers.pop(self.robot, None)
            self._taken_back = self._taken_back[:0]
        room = self.budget.available(now)
        if room <= 0.0:
            return []
        again = self._sent.resend(0.7 * room, now)
        room -= sum(message_bytes(rows) for rows in again)
        messages = self._send_answers(0.5 * room if voxel_map is not None else room)
        if voxel_map is not None:
            self._send_taken_back(voxel_map, messages)
            left = room - sum(rows.nbytes for rows in messages)
            if left > 0.0:
                messages += self._send_changes(voxel_map, left, now)
        messages = again + [self._sent.number(rows) for rows in messages]
        self.budget.spend(sum(message_bytes(rows) for rows in messages))
        return messages

    def _send_answers(self, room: float) -> list[NDArray[np.void]]:
        messages: list[NDArray[np.void]] = []
        for robot in sorted(self._answers):
            part = self._replica.contribution(robot)
            asked, self._answers[robot] = self._answers[robot], set()
            if part is None or not asked:
                continue
            slots = np.array(sorted(asked), np.int64)
            bits, sizes = priority_of_states(part, slots)
            left = room - sum(rows.nbytes for rows in messages)
            chosen = _affordable(bits / np.maximum(sizes, 1.0), sizes, left)
            self._answers[robot] = set(slots[~chosen].tolist())
            messages += self._encode_answer(robot, part, slots[chosen])
        return messages

    def _encode_answer(
        self, robot: int, part: Contribution, slots: Slots
    ) -> list[NDArray[np.void]]:
        update = part.states(robot, slots)
        if not len(update.versions):
            return []
        if robot == self.robot:
            update = update.as_sent_by(self.session, None, self.own_version.advance())
            self._replica.accept(update)
            self._touched.append(part.coordinates(slots))
        else:
            update = update.as_sent_by(0, self.robot, None)
        return encode_update(update, self._config.message_size)

    def _send_changes(self, voxel_map: VoxelMap, room: float, now: float) -> list[NDArray[np.void]]:
        storage = voxel_map._storage
        slots, _ = changed_blocks(storage)
        if not len(slots):
            return []
        size, origin = voxel_map.config.voxel_size, voxel_map.origin
        sent = self._replica.contribution(self.robot) or Contribution(size, origin)
        priority = priority_of_changes(voxel_map, sent, slots)
        whole, parts = self._choose(slots, priority, room, now)
        dirty = storage.blocks.dirty
        changed = dirty[slots]
        later = dirty[slots[parts]] & ~priority.matters[parts]
        dirty[slots[parts]] &= priority.matters[parts]
        changes = take_changes(storage, size, _MOST_VOXELS, slots[whole | parts])
        dirty[slots[parts]] |= later
        version = next_version(self.version)
        update = MapUpdate.of_changes(changes, size, self.robot, version, self.session, origin)
        try:
            return self._publish(update)
        except CapacityError:
            dirty[slots] = changed  # to be sent when there is room
            raise

    def _choose(
        self, slots: Slots, priority: ChangePriority, room: float, now: float
    ) -> tuple[Mask, Mask]:
        """Blocks of which all changes are sent, and those of which only what matters, (n,) each."""
        bits, sizes = priority.bits, np.maximum(priority.sizes, 1.0)
        matter = np.flatnonzero(priority.sizes[:, 0] > 0.0)
        gain = (1.0 + self._waited(slots[matter], now) / _WAIT) ** 2
        fits = _affordable(bits[matter, 0] / sizes[matter, 0] * gain, sizes[matter, 0], room)
        parts = np.zeros(len(slots), np.bool_)
        parts[matter[fits]] = True
        self._since[slots[parts]] = np.inf
        left = room - sizes[parts, 0].sum()
        if not fits.all() or left <= 0.0:
            return np.zeros_like(parts), parts
        whole = _affordable(bits[:, 1] / sizes[:, 1], sizes[:, 1], left)
        return whole, parts & ~whole

    def _publish(self, update: MapUpdate) -> list[NDArray[np.void]]:
        """Encode those states of an update that were not sent like that before."""
        self.own_version.advance()
        update = update.rows(self._replica.accept(update))
        if not len(update.versions):
            return []
        blocks = np.empty((int(count_block_changes(update.indices)), 3), np.int32)
        list_blocks(update.indices, blocks)
        self._touched.append(blocks)
        return encode_update(update, self._config.message_size)

    def _send_taken_back(self, voxel_map: VoxelMap, messages: list[NDArray[np.void]]) -> None:
        if not len(self._taken_back):
            return
        size = voxel_map.config.voxel_size
        waiting, self._taken_back = self._taken_back, self._taken_back[:0]
        indices = waiting[~voxel_map.is_known((waiting + 0.5) * size)]
        count, version = len(indices), next_version(self.version)
        states = (
            np.full(count, version, np.uint32),
            indices,
            np.full(count, NOT_OBSERVED, np.int8),
            np.zeros((count, 2), np.uint64),
        )
        try:
            origin = voxel_map.origin
            update = MapUpdate(size, self.robot, *states, self.session, origin=origin)
            messages += self._publish(update)
        except CapacityError:  # what this robot sees comes first; the replica says it is crowded
            self._taken_back = waiting

    def _waited(self, slots: Slots, now: float) -> NDArray[np.float64]:
        """How long the changes of blocks have waited [s]."""
        if len(slots) and slots[-1] >= len(self._since):
            more = np.full(2 * int(slots.max()) + 64 - len(self._since), np.inf)
            self._since = np.concatenate([self._since, more])
        self._since[slots] = np.minimum(self._since[slots], now)
        return now - self._since[slots]


def mark_all(voxel_map: VoxelMap) -> None:
    """Count all of a map that tracks its changes as changed."""
    voxel_map.mark_changed(0, int(voxel_map._storage.blocks.counts[BLOCK_COUNT]))


def _affordable(priority: NDArray[np.float64], sizes: NDArray[np.float64], room: float) -> Mask:
    """The best of some things that fit in the room, at least one."""
    order = np.argsort(-priority, kind="stable")
    fits = np.cumsum(sizes[order]) <= room
    fits[:1] = True
    chosen = np.zeros(len(priority), np.bool_)
    chosen[order[fits]] = True
    return chosen
