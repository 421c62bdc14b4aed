"""One robot of a team: sends its contribution, receives the others', and mends what was lost.

It knows neither network nor clock: messages are rows that somebody carries, times are handed in.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import islice
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping import NOT_OBSERVED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.block_kernels import find_block
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, local_index, pack
from infomap_ros.mapping.voxels.state import (
    VoxelStates,
    count_block_changes,
    put_states,
)
from infomap_ros.mapping.voxels.storage import Growth
from infomap_ros.team.agreement import Agreement, compare
from infomap_ros.team.config import (
    MOST_BLOCKS_TAKEN_BACK,
    MOST_RECOVERED,
    ROOM_PERIOD,
    TAKEN_BACK_SHARE,
    TeamConfig,
)
from infomap_ros.team.contribution import BLOCK_BYTES
from infomap_ros.team.digest import Freshness, Summary, decode_digest, decode_request
from infomap_ros.team.gaussian_code import information_of_codes
from infomap_ros.team.membership import Membership, TeamKey
from infomap_ros.team.outbox import Outbox, mark_all
from infomap_ros.team.reconciler import Reconciler
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate, are_one_frame, message_bytes
from infomap_ros.team.wire import decode_update

Rows = NDArray[np.void]
_REVIEW_PERIOD = 2.0  # [s] between two comparisons of the maps


class TeamMember:
    """A robot of a team.

    What it saw stands in its own map, which tracks its changes and is handed in whenever there is
    something to send. For `recovery` seconds after a start, what others still know of its
    contribution is put into its map again, but for voxels that changed since; then all of its map
    is sent.

    Args:
        robot: id of this robot, unique in its team.
        session: number that it draws at each start, see `membership.draw_session`.
        version: of its last publication, see `versions.version_at`.
        map_config: of the shared map.
        config: how it shares.
        team: ids of the robots that may write; all if empty.
        contributes: whether it has a contribution; otherwise it only listens, and asks.
        key: of the team; without it every message is taken for genuine.

    Attributes:
        replica: the shared map; what is in another frame is kept aside (`MapReplica`).
        contradictions: robots whose maps contradict this robot's: they are kept, but left out of
            the shared map here until they fit.
    """

    def __init__(
        self,
        robot: int,
        session: int,
        version: int,
        map_config: VoxelMapConfig,
        config: TeamConfig | None = None,
        team: Collection[int] = (),
        *,
        contributes: bool = True,
        key: TeamKey | None = None,
    ) -> None:
        self._config = config or TeamConfig()
        self.replica = MapReplica(map_config, robot)
        shown = session if contributes else None
        self._membership = Membership(robot, shown, team, self._config.silence)
        self._outbox = Outbox(robot, session, version, self.replica, self._config)
        self._reconciler = Reconciler(
            self.replica, self._outbox, self._config, contributes, self._membership.may_be_kept
        )
        self._freshness, self._made_room, self._reviewed = Freshness(), -np.inf, -np.inf
        self._taken_back: set[tuple[int, ...]] = set()
        limit = TAKEN_BACK_SHARE * map_config.memory_limit * 1e9
        self._most_taken_back = min(MOST_BLOCKS_TAKEN_BACK, int(limit) // BLOCK_BYTES)
        self._contributes, self._key = contributes, key
        self.contradictions: dict[int, Agreement] = {}
        self._recovered: list[MapUpdate] = []
        self._started, self._has_begun = np.nan, False

    @property
    def robot(self) -> int:
        """Id of this robot."""
        return self._outbox.robot

    @property
    def session(self) -> int:
        """Number that it drew when it started."""
        return self._outbox.session

    @property
    def version(self) -> int:
        """Version of its last publication."""
        return self._outbox.version

    @property
    def behind(self) -> bool:
        """Whether somebody still waits for an answer."""
        return self._outbox.waiting

    def barred_by(self, now: float) -> dict[int, int]:
        """Robots that hold a version of this robot's that it cannot have sent, with that version.

        What this robot sends does not count there, until it starts again.
        """
        return self._outbox.own_version.barred_by(now)

    def updates(self, own_map: VoxelMap, now: float) -> list[Rows]:
        """Map updates to send now: what changed, and what others asked for.

        Args:
            own_map: what this robot saw; tracks its changes. What others know of it and it does
                not is added.
            now: time of any steady clock [s].

        Raises:
            CapacityError: there is no room for what others know of this robot, or for what it
                sends. What was to be sent is sent when there is.
        """
        self._start(now)
        while self._recovered:
            update = self._recovered.pop()
            if are_one_frame(update.origin, own_map.origin):
                adopt(own_map, update)
        if not self._has_begun and now >= self._reconciler.recovering_until:
            self._has_begun = True
            mark_all(own_map)
        return self._signed(self._outbox.updates(own_map, now))

    def send_everything(self) -> None:
        """Send the whole own contribution again, for somebody who cannot ask."""
        part = self.replica.contribution(self.robot)
        if part is not None:
            self._outbox.answer(self.robot, np.arange(part.blocks))

    def begin(self, own_map: VoxelMap) -> None:
        """Send all of a map that this robot made since it started, without waiting for others."""
        self._has_begun = True
        mark_all(own_map)

    def replace(self, own_map: VoxelMap) -> None:
        """From now on another map is sent; what was sent and it does not know is taken back."""
        self._reconciler.recovering_until = -np.inf
        self._recovered.clear()
        self.begin(own_map)
        part = self.replica.contribution(self.robot)
        if part is not None:
            states = part.states(self.robot)
            self._outbox.take_back(states.indices[states.log_odds != NOT_OBSERVED])

    def digests(self, now: float) -> list[Rows]:
        """Digests to send now, to be called every `digest_period`."""
        self._start(now)
        if now - self._reviewed >= _REVIEW_PERIOD:
            self._reviewed = now
            self._review()
        short = self.replica.is_crowded or self.replica.is_cut
        if short and now - self._made_room >= ROOM_PERIOD:
            self._made_room = now
            self.replica.make_room()
        return self._spend(self._reconciler.digests(now))

    def requests(self, now: float) -> list[Rows]:
        """Requests to send now, to be called as often as digests or more often."""
        return self._spend(self._reconciler.requests(now))

    def receive_update(self, rows: Rows, now: float) -> int:
        """Learn from a map update.

        Returns:
            Number of voxels of the shared map that are other than before.

        Raises:
            InvalidInputError: it is malformed or absurd.
            UpdateRefusedError: its robot must not write, or not that.
            CapacityError: the shared map would become too large.
            In all cases the map is as it was.
        """
        update = decode_update(self._genuine(rows))
        self._start(now)
        self._membership.check_update(update, now, self._outbox.version)
        if update.sender is None:
            self._reconciler.meet(update.robot, update.session, is_sure=False)
        speaker = update.robot if update.sender is None else update.sender
        if update.serial is not None and (speaker != self.robot or not self._contributes):
            self._reconciler.losses.receive(speaker, update.serial, now)
        if update.robot != self.robot or not self._contributes:
            if self._contributes and update.robot not in self.replica.robots:
                self.replica.set_aside(update.robot, True)
                self._reviewed = -np.inf
            return self.replica.apply(update)
        if update.sender is not None and update.sender != self.robot:
            self._recover(update, now)
        return 0

    def receive_digest(self, rows: Rows, now: float) -> None:
        """Learn what another robot holds.

        Raises:
            InvalidInputError: it is malformed.
            UpdateRefusedError: its sender must not write.
        """
        self._start(now)
        digest = decode_digest(self._genuine(rows))
        self._membership.check_robot(digest.sender)
        if digest.sender == self.robot and self._contributes:
            return
        self._freshness.check(digest.sender, digest.session, digest.number)
        self._reconciler.meet(digest.sender, digest.session)
        if isinstance(digest, Summary):
            for newest in digest.rows["newest"][digest.rows["robot"] == digest.sender].tolist():
                self._membership.note_version(digest.sender, digest.session, newest, now)
            self._reconciler.receive_summary(digest, now)
        else:
            if digest.robot == digest.sender:
                of_itself = digest.sender, digest.session, digest.version
                self._membership.note_version(*of_itself, now)
            self._reconciler.receive_cells(digest, now)

    def receive_request(self, rows: Rows, now: float) -> None:
        """Learn what another robot asks for.

        Raises:
            InvalidInputError: it is malformed.
            UpdateRefusedError: its sender must not write.
        """
        request = decode_request(self._genuine(rows))
        self._membership.check_robot(request.sender)
        if request.sender == self.robot and request.session == self._outbox.session:
            return
        self._freshness.check(request.sender, request.session, request.number)
        self._reconciler.receive_request(request, now)

    def _review(self) -> None:
        """Leave maps out that contradict the own one, and let others in."""
        own = self.replica.contribution(self.robot)
        self.contradictions = {}
        for robot in self.replica.robots:
            other = self.replica.contribution(robot)
            if robot == self.robot or other is None:
                continue
            is_comparable = self.replica.is_in_frame(robot)  # others are compared when they join
            found = Agreement(0, 0)
            if own is not None and is_comparable:
                found = compare(own, other)
            if found.is_contradiction:
                self.contradictions[robot] = found
            self.replica.set_aside(robot, found.is_contradiction or not is_comparable)

    def _start(self, now: float) -> None:
        if np.isnan(self._started):
            self._started = now
            self._reconciler.recovering_until = now + self._config.recovery

    def _recover(self, update: MapUpdate, now: float) -> None:
        """Keep what others know of this robot's contribution and it did not send since it began.

        That is put into the map only while the robot recovers; afterwards it is taken back.
        """
        sender = self.robot if update.sender is None else update.sender
        part = self.replica.contribution(self.robot)
        if part is not None and not are_one_frame(part.origin, update.origin):
            return
        for version in {int(v) for v in np.unique(update.versions)}:
            self._outbox.own_version.follow(version, sender, now)
        if part is not None:
            update = update.rows(part.versions_of(update.indices) == 0)
        if now < self._reconciler.recovering_until:
            if sum(len(known.versions) for known in self._recovered) <= MOST_RECOVERED:
                self._recovered.append(update)
            return
        held = update.indices[update.log_odds != NOT_OBSERVED]
        corners = [tuple(corner) for corner in (held >> BLOCK_BITS).tolist()]
        room = self._most_taken_back - len(self._taken_back)
        self._taken_back.update(islice(set(corners) - self._taken_back, room))
        chosen = [corner in self._taken_back for corner in corners]
        self._outbox.take_back(held[np.array(chosen, np.bool_)])

    def _spend(self, messages: list[Rows]) -> list[Rows]:
        self._outbox.budget.spend(sum(message_bytes(rows) for rows in messages))
        return self._signed(messages)

    def _signed(self, messages: list[Rows]) -> list[Rows]:
        key = self._key
        return messages if key is None else [key.sign(rows) for rows in messages]

    def _genuine(self, rows: Rows) -> Rows:
        return rows if self._key is None else self._key.verify(rows)


def adopt(own_map: VoxelMap, update: MapUpdate) -> None:
    """Put sent states into a map, but for voxels that have changed; they count as changes.

    What a robot sent is newer than the file from which it starts again, but not newer than what
    it sees since then.

    Args:
        own_map: tracks its changes since it was read.
        update: states of its contribution as another robot received them.

    Raises:
        CapacityError: with them it would take more than half of its memory limit.
    """
    fresh = np.zeros(len(update.versions), np.bool_)
    _find_changed(own_map._storage.blocks, update.indices, fresh)
    update = update.rows(~fresh & (update.log_odds != NOT_OBSERVED))
    information = information_of_codes(update.codes, own_map.config.voxel_size)
    states = VoxelStates(
        update.indices,
        np.ones(len(update.versions), np.bool_),
        update.log_odds.astype(np.int32),
        information.astype(np.float32),
    )
    blocks, surfaces = int(count_block_changes(update.indices)), int(update.has_gaussian.sum())
    more = Growth(blocks, blocks, min(blocks, surfaces), surfaces)
    own_map._storage.check_growth(more, 0.5e9 * own_map.config.memory_limit)
    put_states(own_map._storage, states)


@njit(cache=True, nogil=True)
def _find_changed(blocks: Any, indices: Any, changed: Any) -> None:
    for row in range(len(indices)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        slot = find_block(blocks, pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS))
        if slot >= 0:
            local = local_index(x, y, z)
            word = blocks.dirty[slot, local >> 6] >> np.uint64(local & 63)
            changed[row] = (word & np.uint64(1)) != np.uint64(0)
