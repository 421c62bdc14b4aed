"""A replica of the map that a team shares.

Each robot owns its contribution and sends the absolute states of its voxels. A replica keeps, per
robot and voxel, the newest state that it received, and the sum over the robots stands in a map. So
updates may be lost, repeated or come in any order: nothing is counted twice, and replicas that
have received the same hold the same voxels with the same bits. Sums run in the order of the
robots' ids, because sums of floating-point numbers depend on their order.

A contribution is in one frame, which its origin names. Newer states in another frame take the place
of all that the robot sent before, older ones are void. Only what is in the frame of this robot's
own contribution is added: the others are kept aside until somebody's map is moved.

Memory is shared out: what this robot sends always comes first, every other may use an equal share,
and more while nobody else needs it. Where there is no more room, the largest contributions lose
what informs least, until all fit (`team.limits`).

A contribution that belongs elsewhere: its map after a corrected alignment.

Where the scans are kept they are better put where they belong (`mapping.reintegration`); this is
for a map of which only the voxels are left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import check_transform, invert_transform, skew, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.changes import put_offset
from infomap_ros.mapping.voxels.keys import BLOCK_BYTES as MAP_BLOCK_BYTES
from infomap_ros.mapping.voxels.keys import PLANE_BYTES
from infomap_ros.mapping.voxels.state import (
    VoxelStates,
    count_block_changes,
    information_of,
    put_states,
)
from infomap_ros.mapping.voxels.storage import Growth, MapStorage, growth_bytes
from infomap_ros.team.config import BORROWED_MOST, GUESTS_MOST, ROOM_AFTER
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.contribution_kernels import mixed
from infomap_ros.team.priority import priority_of_states
from infomap_ros.team.update import MapUpdate, are_one_frame, is_newer

_ADDED_AT_ONCE = 4096  # blocks of which the sum is made in one go


class MapReplica:
    """The newest state of every voxel of every robot, and the map that is their sum.

    A voxel of the map is known when a robot knows it; its evidence and its information are the
    sums of what the robots know.

    Args:
        config: of the map.
        own: id of the robot whose contribution comes first where memory is short; None for none.

    Attributes:
        is_crowded: whether something was refused for want of memory since `make_room`.
    """

    def __init__(self, config: VoxelMapConfig | None = None, own: int | None = None) -> None:
        self._map, self._own, self.is_crowded = VoxelMap(config), own, False
        self._contributions: dict[int, Contribution] = {}
        self._aside: set[int] = set()

    @property
    def voxel_map(self) -> VoxelMap:
        """The sum over all robots. It is the replica's own: read it only."""
        return self._map

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots that have sent, ascending."""
        return tuple(sorted(self._contributions))

    def contribution(self, robot: int) -> Contribution | None:
        """What a robot sent, None where it sent nothing. It is the replica's own."""
        return self._contributions.get(robot)

    def hash(self) -> int:
        """Hash of all contributions, 64 bits: replicas that received the same have the same."""
        parts = [mixed(mixed(robot) ^ np.uint64(part.hash())) for robot, part in self._parts()]
        return int(np.add.reduce(np.array(parts, np.uint64), dtype=np.uint64))

    def memory_bytes(self) -> int:
        """Memory in use by the contributions and their sum [bytes]."""
        parts = sum(part.memory_bytes() for part in self._contributions.values())
        return parts + self._map.memory_bytes()

    def apply(self, update: MapUpdate) -> int:
        """As `accept`, for states in any order of which a voxel may be repeated.

        Returns:
            Number of voxels of which the robot now says something else.
        """
        return int(np.count_nonzero(self.accept(update.in_order_of_blocks())))

    def accept(self, update: MapUpdate) -> NDArray[np.bool_]:
        """Learn what a robot sends.

        Args:
            update: states of voxels, each voxel once, in voxels of the map's size.

        Returns:
            Of which voxels the robot now says something else than before, shape (K,).

        Raises:
            InvalidInputError: another voxel size or impossible states. The replica is as it was.
            CapacityError: the replica would exceed ``memory_limit`` of the map. Likewise.
        """
        size = self._map.config.voxel_size
        if np.float32(update.voxel_size) != np.float32(size):
            raise InvalidInputError(
                "map update", f"voxels of {update.voxel_size:g} m, the map has {size:g} m"
            )
        update.check_states()
        self._check_capacity(update)
        contribution = self._contributions.get(update.robot)
        if contribution is not None and contribution.origin != update.origin:
            if not is_newer(update.newest, np.uint32(contribution.newest)):
                return np.zeros(len(update.versions), np.bool_)
            contribution = None
        if contribution is None:
            self._replace(update.robot, Contribution(size, update.origin))
            contribution = self._contributions[update.robot]
        changed = contribution.accept(update)
        if self._is_added(update.robot):
            self._add_up(update.indices[changed])
        return changed

    def begin_frame(self, robot: int, origin: int) -> bool:
        """Drop what a robot sent in another frame than this one; whether there was any."""
        part = self._contributions.get(robot)
        if part is None or part.origin == origin:
            return False
        self._replace(robot, Contribution(self._map.config.voxel_size, origin))
        self._contributions[robot].newest = part.newest
        return True

    def is_in_frame(self, robot: int) -> bool:
        """Whether a robot's contribution is in the frame of the map, as far as it is known."""
        return are_one_frame(self._contributions[robot].origin, self.origin)

    @property
    def origin(self) -> int:
        """Names the frame of the map: that of the own contribution, else of the smallest id's."""
        first = min(self._contributions, default=None)
        part = self._contributions.get(self._own if self._own is not None else -1)
        if part is None and first is not None:
            part = self._contributions[first]
        return 0 if part is None else part.origin

    def _is_added(self, robot: int) -> bool:
        return robot not in self._aside and self.is_in_frame(robot)

    def _replace(self, robot: int, part: Contribution) -> None:
        """Put a contribution that is empty in the place of one, if there is any."""
        is_known, origin = robot in self._contributions, self.origin
        self._contributions[robot] = part
        if is_known or self.origin != origin:
            self._sum_again()

    def forget(self, robot: int) -> None:
        """Drop a robot's contribution."""
        self._aside.discard(robot)
        if self._contributions.pop(robot, None) is not None:
            self._sum_again()

    def make_room(self) -> None:
        """Drop what informs least of the others' largest contributions, until there is room.

        What was cut before and has less than its share now is compared and asked for again.
        """
        self.is_crowded = False
        sizes = {robot: _size(part) for robot, part in self._parts()}
        total = sum(sizes.values())
        left = ROOM_AFTER * self._limit * total / max(self.memory_bytes(), 1)
        left -= sizes.pop(self._own, 0) if self._own is not None else 0
        share = _equal_share(sorted(sizes.values()), left)
        cut = [r for r, size in sizes.items() if size > share and self._contributions[r].blocks]
        for robot, part in self._parts():
            part.is_cut &= robot in cut
        for robot in cut:
            part = self._contributions[robot]
            worth, _ = priority_of_states(part, np.arange(part.blocks))
            self._contributions[robot] = part.most_informative(share / sizes[robot], worth)
        if cut:
            self._sum_again()

    @property
    def is_cut(self) -> bool:
        """Whether a contribution was cut by `make_room`."""
        return any(part.is_cut for part in self._contributions.values())

    def set_aside(self, robot: int, aside: bool) -> None:
        """Leave a robot's contribution out of the map, or put it back; it is kept all the same."""
        if aside == (robot in self._aside):
            return
        self._aside ^= {robot}
        contribution = self._contributions.get(robot)
        if contribution is not None:
            self._add_up(contribution.states(robot).indices)

    @property
    def aside(self) -> tuple[int, ...]:
        """Ids of the robots whose contributions are left out of the map."""
        return tuple(robot for robot in self.robots if not self._is_added(robot))

    def _parts(self) -> list[tuple[int, Contribution]]:
        return [(robot, self._contributions[robot]) for robot in self.robots]

    def _add_up(self, indices: NDArray[np.int32]) -> None:
        """Set voxels of the map to the sums over the robots."""
        count = len(indices)
        known, quanta = np.zeros(count, np.bool_), np.zeros(count, np.int32)
        information = np.zeros((count, 9))
        for robot, part in self._parts():
            if self._is_added(robot):
                part.add_to(indices, known, quanta, information)
        states = VoxelStates(indices, known, quanta, information.astype(np.float32))
        put_states(self._map._storage, states)

    def _sum_again(self) -> None:
        """Make the map again from the contributions, so that it has no more room than it needs."""
        self._map._storage = MapStorage()
        for robot, part in self._parts():
            for start in range(0, part.blocks if self._is_added(robot) else 0, _ADDED_AT_ONCE):
                slots = np.arange(start, min(start + _ADDED_AT_ONCE, part.blocks))
                self._add_up(part.states(robot, slots).indices)

    @property
    def _limit(self) -> float:
        return self._map.config.memory_limit * 1e9

    def _check_capacity(self, update: MapUpdate) -> None:
        """Refuse what does not fit, unless it is the own contribution and others can give way."""
        if self._own == update.robot and not self._fits(update, self._limit):
            self.make_room()
        if not self._fits(update, self._room_for(update.robot)):
            self.is_crowded = True
            raise CapacityError(
                f"the shared map holds {self.memory_bytes() / 1e9:.3g} GB, and there is no room "
                f"for more of robot {update.robot} within the limit of {self._limit / 1e9:g} GB"
            )

    def _room_for(self, robot: int) -> float:
        """How large all may become by what this robot sends [bytes]."""
        if robot == self._own or (self._own is None and len(self._contributions) < 2):
            return self._limit
        part = self._contributions.get(robot)
        count = len(self._contributions) + (part is None)
        has_its_share = part is not None and _size(part) > GUESTS_MOST * self._limit / count
        return self._limit * (BORROWED_MOST if has_its_share else GUESTS_MOST)

    def _fits(self, update: MapUpdate, limit: float) -> bool:
        part = self._contributions.get(update.robot)
        part = Contribution(self._map.config.voxel_size) if part is None else part
        blocks, surfaces = part.count_new(update.indices), part.count_new_surfaces(update)
        pages = min(surfaces, int(count_block_changes(update.indices)))
        more = Growth(blocks, blocks, pages, surfaces)
        self._map._storage.check_growth(more)
        growth = part.growth_bytes(blocks, surfaces) + growth_bytes(self._map._storage, more)
        return not growth or self.memory_bytes() + growth <= limit


def _size(part: Contribution) -> int:
    """Memory of a contribution and of what it adds to the sum, at the most [bytes]."""
    return part.memory_bytes() + part.blocks * (MAP_BLOCK_BYTES + PLANE_BYTES)


def _equal_share(sizes: list[int], room: float) -> float:
    """The size to which the largest have to come down so that all fit; `sizes` ascend."""
    for place, size in enumerate(sizes):
        share = max(0.0, room) / (len(sizes) - place)
        if size > share:
            return share
        room -= size
    return np.inf


def moved_map(voxel_map: VoxelMap, T_new_old: ArrayLike) -> VoxelMap:
    """A map whose content is moved; tracks its changes.

    The evidence of a voxel is that of the place from which its center comes. Gaussians are moved
    as they are, each into the voxel in which its mean then lies; of several in one voxel the
    surest is kept, as they may be of one observation. That voxel is occupied. The error that the
    whole map shares moves with it.

    Args:
        voxel_map: what is moved; stays as it is.
        T_new_old: takes map coordinates as they were to those that are right, shape (4, 4).

    Raises:
        InvalidInputError: not a rigid transform.
    """
    transform = check_transform(T_new_old, "T_new_old")
    size = voxel_map.config.voxel_size
    indices = _reached(voxel_map, transform)
    sources = transform_points(invert_transform(transform), (indices + 0.5) * size)
    known = voxel_map.is_known(sources)
    indices, quanta = indices[known], np.rint(voxel_map.log_odds(sources[known]) / LOG_ODDS_QUANTUM)
    moved = VoxelMap(voxel_map.config)
    moved.track_changes(True)
    nothing = np.zeros((len(indices), 9), np.float32)
    present = np.ones(len(indices), np.bool_)
    put_states(moved._storage, VoxelStates(indices, present, quanta.astype(np.int32), nothing))
    put_states(moved._storage, _moved_surfaces(voxel_map, transform))
    put_offset(moved._storage, moved_offset(voxel_map.offset, transform))
    return moved


def moved_offset(offset: FloatArray, T_new_old: FloatArray) -> FloatArray:
    """The covariance of a map's offset at its origin, (6, 6), carried to another one.

    An error (dt, dr) takes a point p by dt + dr x p, and so the moved one, R p + t, by
    R dt - (R dr) x t + (R dr) x (R p + t).
    """
    change, turn = np.zeros((6, 6)), T_new_old[:3, :3]
    change[:3, :3] = change[3:, 3:] = turn
    change[:3, 3:] = skew(T_new_old[:3, 3]) @ turn
    return np.asarray(change @ offset @ change.T)


def _reached(voxel_map: VoxelMap, transform: FloatArray) -> NDArray[np.int32]:
    """Voxels into which something may come, each once."""
    size = voxel_map.config.voxel_size
    centers = transform_points(transform, (voxel_map.voxels()[0] + 0.5) * size)
    low = np.floor(centers / size - 0.5).astype(np.int32)
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3), axis=-1).reshape(-1, 3)
    around = (low[:, None] + corners[None].astype(np.int32)).reshape(-1, 3)
    return np.asarray(np.unique(around, axis=0), np.int32)


def _moved_surfaces(voxel_map: VoxelMap, transform: FloatArray) -> VoxelStates:
    size, turn = voxel_map.config.voxel_size, transform[:3, :3]
    old, means, covariances = voxel_map.gaussians(relative=True)
    odds = voxel_map.log_odds((old + 0.5) * size)
    means, covariances = transform_points(transform, means), turn @ covariances @ turn.T
    indices = np.floor(means / size).astype(np.int32)
    order = np.argsort(np.linalg.det(covariances), kind="stable")
    _, first = np.unique(indices[order], axis=0, return_index=True)
    chosen = order[first]
    surface = np.ones(len(chosen), np.bool_)
    information = information_of(indices[chosen], surface, means[chosen], covariances[chosen], size)
    quanta = np.rint(odds[chosen] / LOG_ODDS_QUANTUM).astype(np.int32)
    return VoxelStates(indices[chosen], surface, quanta, information)
