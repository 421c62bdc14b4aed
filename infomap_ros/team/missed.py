"""Blocks of others' contributions that another robot holds otherwise, until they are mended."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from infomap_ros.team.contribution import Contribution, Corners
from infomap_ros.team.digest import CellDigest
from infomap_ros.team.limits import MISSED_FOR, MOST_MISSED, MOST_TRIES
from infomap_ros.team.versions import is_newer


class _Block(NamedTuple):
    """How a block should be: hash and version; since when that is heard; how often asked for."""

    hash: int
    version: int
    heard: float
    tries: int


class Missed:
    """Missed blocks of all contributions. They are forgotten when they are mended, or too old.

    Args:
        late: time for which a block is missed before it is asked for [s].
        request_timeout: time until it is asked for again [s].
    """

    def __init__(self, late: float, request_timeout: float) -> None:
        self._late, self._request_timeout = late, request_timeout
        self._blocks: dict[int, dict[tuple[int, ...], _Block]] = {}
        self._sender: dict[int, int] = {}
        self._checked = -np.inf

    def __len__(self) -> int:
        return sum(map(len, self._blocks.values()))

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots whose contributions lack something."""
        return tuple(self._blocks)

    def hear(self, digest: CellDigest, now: float) -> None:
        """Remember what a digest says; where there are too many, the oldest of the most go."""
        self._sender[digest.robot] = digest.sender
        blocks = self._blocks.setdefault(digest.robot, {})
        for place, value in zip(digest.corners.tolist(), digest.hashes.tolist(), strict=True):
            known = blocks.pop(corner := tuple(place), None)
            if known is None or known.hash != value:
                known = _Block(value, digest.version, now, 0)
            blocks[corner] = known._replace(version=digest.version)
        while (excess := len(self) - MOST_MISSED) > 0:
            most = max(self._blocks.values(), key=len)
            for corner in list(most)[:excess]:
                del most[corner]

    def is_due(self, now: float) -> bool:
        """Whether it is time to look what is still missed; then it counts as looked at."""
        if now - self._checked < 0.5 * self._request_timeout:
            return False
        self._checked = now
        return True

    def to_ask(self, robot: int, part: Contribution | None, now: float) -> tuple[int, Corners]:
        """Whom to ask for which blocks of a contribution now; they count as asked for.

        Args:
            robot: whose contribution it is.
            part: what is held of it, None where nothing is.
            now: time of any steady clock [s].
        """
        blocks = self._blocks[robot]
        self._drop_mended(blocks, part)
        due = []
        for corner, block in list(blocks.items()):
            if block.tries >= MOST_TRIES or now - block.heard > MISSED_FOR:
                del blocks[corner]
            elif now - block.heard >= self._late + block.tries * self._request_timeout:
                blocks[corner] = block._replace(tries=block.tries + 1)
                due.append(corner)
        if not blocks:
            del self._blocks[robot]
        return self._sender[robot], np.array(due, np.int32).reshape(-1, 3)

    @staticmethod
    def _drop_mended(blocks: dict[tuple[int, ...], _Block], part: Contribution | None) -> None:
        if part is None or not blocks:
            return
        hashes, newest = part.blocks_at(np.array(list(blocks), np.int32))
        states = zip(list(blocks.items()), hashes.tolist(), newest, strict=True)
        for (corner, block), value, own in states:
            if value == block.hash or (own and is_newer(own, np.uint32(block.version))):
                del blocks[corner]
