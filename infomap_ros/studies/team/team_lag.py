"""How far behind each other the maps of a team are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import LOG_ODDS_QUANTUM, SHARED_LOG_ODDS_LIMIT
from infomap_ros.studies.team.team_network import NetworkRobot, TeamNetwork

LEAST_CHANGE = 0.02
"""Change of a probability that counts; less is what evidence near its limit still gains."""

_HALF = 1 << 15  # voxel indices stay below this


@dataclass(eq=False)
class _View:
    """Voxels to which a view gave other evidence, and who has not heard of all of them."""

    robot: int
    taken: float
    version: int
    indices: NDArray[np.int32]
    missing: set[int]


class LagMeter:
    """Measures for each view how long it takes until every other robot has all that it changed.

    Args:
        network: of the robots.

    Attributes:
        lags: of each view and receiver that has all of it [s].
    """

    def __init__(self, network: TeamNetwork) -> None:
        self._network = network
        self._views: list[_View] = []
        self.lags: list[float] = []

    @property
    def open(self) -> int:
        """Number of views of which somebody still misses something."""
        return len(self._views)

    def look(self, robot: NetworkRobot) -> None:
        """Let a robot take a view, and remember what it changed."""
        before = _evidence(robot)
        version = robot.member.version
        self._network.look(robot)
        after = _evidence(robot)
        indices = _changed(before, after)
        robot.told += len(indices)
        others = set(range(len(self._network.robots))) - {robot.member.robot}
        view = _View(robot.member.robot, self._network.now, version, indices, others)
        self._views.append(view)

    def check(self) -> None:
        """Find out who has heard of which views; to be called after each step."""
        for view in self._views:
            for number in list(view.missing):
                part = self._network.robots[number].member.replica.contribution(view.robot)
                if part is not None and (part.versions_of(view.indices) > view.version).all():
                    view.missing.remove(number)
                    self.lags.append(self._network.now - view.taken)
        self._views = [view for view in self._views if view.missing]


def _evidence(robot: NetworkRobot) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Known voxels as single numbers, ascending, and their evidence as it is told."""
    indices, log_odds = robot.own.voxels()
    limit = SHARED_LOG_ODDS_LIMIT
    quanta = np.clip(np.rint(log_odds / LOG_ODDS_QUANTUM), -limit, limit).astype(np.int64)
    x, y, z = indices.astype(np.int64).T + _HALF
    keys = (x * 2 * _HALF + y) * 2 * _HALF + z
    order = np.argsort(keys)
    return keys[order], quanta[order]


def _probability(quanta: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.asarray(1.0 / (1.0 + np.exp(-quanta * LOG_ODDS_QUANTUM)))


def _changed(
    before: tuple[NDArray[np.int64], NDArray[np.int64]],
    after: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int32]:
    """Voxels that are new, or whose probability changed by `LEAST_CHANGE`, shape (n, 3)."""
    keys, quanta = after
    same = np.zeros(len(keys), np.bool_)
    if len(before[0]):
        place = np.minimum(np.searchsorted(before[0], keys), len(before[0]) - 1)
        change = np.abs(_probability(before[1][place]) - _probability(quanta))
        same = (before[0][place] == keys) & (change < LEAST_CHANGE)
    rest, z = np.divmod(keys[~same], 2 * _HALF)
    return np.stack([*np.divmod(rest, 2 * _HALF), z], axis=-1).astype(np.int32) - _HALF
