"""Whole, well-formed messages of a team with odd content: what each costs is part of the verdict.

    python benchmarks/fuzz_team_content.py --seconds 3600 --seed 1

Where `fuzz_team.py` breaks messages, this makes them: updates, digests, summaries and requests by
their own encoders, and texts of team/agents. They are empty, repeated, extreme, of the past and of
the future, in any order and in anybody's name. A robot that goes on mapping hears them by rounds.
After each round:

- nothing but the library's errors was raised;
- it holds at most `MOST_KEPT` bytes for each byte that it heard, and the other robots' state beside
  the map is bounded (`kept_beside_the_map`);
- no message took more than `MOST_TIME` of the processor, and a round no more than `TIME_PER_BYTE`
  for each of its bytes;
- it still tells what it sees, and a teammate that was honest all the time hears it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from infomap_ros.errors import InfomapError, UpdateRefusedError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import NOT_OBSERVED, SHARED_LOG_ODDS_LIMIT, VoxelMap, VoxelMapConfig
from infomap_ros.team.agent_board import AgentBoard, agent_to_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import SUMMARY_ROW, CellDigest, Request, Summary
from infomap_ros.team.member import TeamMember
from infomap_ros.team.update import MapUpdate, message_bytes
from infomap_ros.team.wire import decode_update, encode_update

CONFIG = VoxelMapConfig(voxel_size=0.1, memory_limit=0.2)
TEAM = TeamConfig(bandwidth=2.0, message_size=20_000)
VICTIM, MATE, START = 1, 2, 10**9
MOST_KEPT = (
    800  # bytes for each byte heard: a row of 11 bytes may begin a block, of 3 kB here, and sums
)
MOST_TIME = 0.5  # [s] of the processor for a message of at most 60 kB
TIME_PER_BYTE = 20e-6  # [s] beyond 10 ms for each message
MOST_BESIDE = 30e6  # [bytes]
LENS = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
Rows = np.ndarray

robots = st.sampled_from([VICTIM, MATE, 3, 4, 65_535])
sessions = st.sampled_from([0, 11, 22, 33, 2**32 - 1])
versions = st.one_of(
    st.sampled_from([1, START, START + 1, START - 20_000, START + 2**24, START + 2**29]),
    st.sampled_from([START + 2**31 - 2, START + 2**31, 2**32 - 1]),
    st.integers(1, 2**32 - 1),
)
serials = st.one_of(st.integers(0, 3), st.sampled_from([5, 1999, 2001, 2**31 - 1]))
numbers = st.one_of(
    st.integers(0, 4), st.sampled_from([255, 256, 257, 2**62]), st.integers(0, 2**62)
)
counts = st.one_of(st.sampled_from([1, 2]), st.integers(1, 3000))
seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from(["update", "cells", "summary", "request"])


def places(count: int, spread: int, seed_: int, limit: int) -> np.ndarray:
    """Corners or voxels in a cube of that edge, at a random place within the limit, (n, 3)."""
    rng = np.random.default_rng(seed_)
    spread = min(spread, 2 * limit)
    low = rng.integers(-limit, limit - spread + 1, 3)
    return (low + rng.integers(0, spread, (count, 3))).astype(np.int32)


@st.composite
def updates(draw: Any) -> list[Rows]:
    """States of voxels: of one or several versions, repeated or not, of oneself or handed on."""
    count, version = draw(counts), draw(versions)
    indices = places(count, draw(st.sampled_from([1, 8, 64, 256])), draw(seeds), 2**20)
    if draw(st.booleans()):
        indices = np.unique(indices, axis=0)
    rng = np.random.default_rng(draw(seeds))
    row_versions = np.full(len(indices), version, np.uint32)
    if draw(st.booleans()):
        row_versions = rng.choice(np.array([version, draw(versions), 1], np.uint32), len(indices))
    odds = rng.choice([-SHARED_LOG_ODDS_LIMIT, -1, 1, SHARED_LOG_ODDS_LIMIT], len(indices))
    if draw(st.booleans()):
        odds = np.full(len(indices), NOT_OBSERVED)
    codes = np.zeros((len(indices), 2), np.uint64)
    sender = draw(st.one_of(st.none(), robots))
    who = draw(sessions), sender
    update = MapUpdate(0.1, draw(robots), row_versions, indices, odds.astype(np.int8), codes, *who)
    return encode_update(update, TEAM.message_size)


@st.composite
def cells(draw: Any) -> list[Rows]:
    """Hashes of blocks that may not be there."""
    level = draw(st.integers(0, 8))
    corners = places(draw(counts), draw(st.sampled_from([1, 4, 64, 2000])), draw(seeds), 2**17)
    corners = np.unique(corners, axis=0)
    hashes = np.random.default_rng(draw(seeds)).integers(0, 3, len(corners)).astype(np.uint32)
    who = draw(robots), draw(sessions), draw(robots)
    digest = CellDigest(*who, draw(versions), draw(serials), level, corners, hashes)
    return digest.encode(TEAM.message_size, draw(numbers))


@st.composite
def summaries(draw: Any) -> list[Rows]:
    """What is held of many robots, also of those that are none."""
    count = draw(st.sampled_from([0, 1, 5, 64, 65, 1024]))
    rows = np.zeros(count, SUMMARY_ROW)
    rng = np.random.default_rng(draw(seeds))
    rows["robot"] = rng.permutation(1024)[:count]
    rows["newest"], rows["blocks"] = draw(versions), 2**32 - 1
    rows["hash"] = rng.integers(0, 2**32, (count, 2))
    return [Summary(draw(robots), draw(sessions), rows).encode(draw(numbers))]


@st.composite
def requests(draw: Any) -> list[Rows]:
    """Questions for everything, for much and for nothing."""
    wants = draw(st.sampled_from(["cells", "states", "messages"]))
    level, within = draw(st.integers(0, 8)), draw(st.integers(0, 8))
    corners = places(
        draw(counts), draw(st.sampled_from([1, 64, 2000])), draw(seeds), 2**17 >> within
    )
    corners = np.unique(corners, axis=0) if draw(st.booleans()) else corners[:0]
    who = draw(robots), draw(sessions), draw(robots), draw(sessions), draw(robots)
    request = Request(*who, wants, level, within, corners)
    return request.encode(TEAM.message_size, draw(numbers))


messages = st.tuples(kinds, st.integers(1, 3)).flatmap(
    lambda chosen: st.tuples(
        st.just(chosen[0]),
        {"update": updates(), "cells": cells(), "summary": summaries(), "request": requests()}[
            chosen[0]
        ],
        st.just(chosen[1]),
    )
)
rounds = st.lists(st.tuples(messages, st.floats(0.0, 20.0)), min_size=1, max_size=12)


def kept_beside_the_map(member: TeamMember) -> int:
    """What a member keeps of others but for the map, about [bytes]: 200 for each thing."""
    reconciler, outbox = member._reconciler, member._outbox
    things = len(reconciler._missed) + len(reconciler._held) + len(reconciler._asked)
    things += len(reconciler._behind) + len(reconciler._compared) + len(reconciler._untold)
    things += sum(map(len, reconciler.losses._lost.values())) + len(reconciler._requests)
    things += sum(map(len, member._freshness._received.values())) + len(member._taken_back)
    things += sum(map(len, member._membership._sessions.values()))
    things += sum(map(len, outbox._answers.values())) + len(outbox._sent._asked)
    wanted = [each for asked in reconciler._wanted.values() for each in asked.values()]
    rows = sum(request.corners.nbytes for request in wanted) + outbox._taken_back.nbytes
    rows += sum(50 * len(update.versions) for update in member._recovered)
    return 200 * things + rows


class Victim:
    """A robot that maps and is told odd things, and its honest teammate."""

    def __init__(self) -> None:
        self.now, self.seed = 0.0, 0
        self.pairs = [(self._member(robot), self._map()) for robot in (VICTIM, MATE)]
        self.results: Counter[str] = Counter()
        self.worst = 0.0
        self.talk()

    @staticmethod
    def _member(robot: int) -> TeamMember:
        return TeamMember(robot, 11 * robot, START, CONFIG, TEAM)

    @staticmethod
    def _map() -> VoxelMap:
        made = VoxelMap(CONFIG)
        made.track_changes(True)
        return made

    @property
    def member(self) -> TeamMember:
        """The robot that is told odd things."""
        return self.pairs[0][0]

    def look(self) -> None:
        """Both see something more."""
        for _, own in self.pairs:
            self.seed += 1
            rng = np.random.default_rng(self.seed)
            pose = np.eye(4)
            pose[:3, 3] = rng.uniform(-1, 1, 3)
            own.integrate(np.column_stack([rng.uniform(-1, 1, (50, 2)), np.full(50, 2.0)]), pose)

    def talk(self) -> list[str]:
        """They tell each other; returns why the teammate has refused what the victim saw."""
        refused = []
        self.look()
        for number, (speaker, own) in enumerate(self.pairs):
            receiver = self.pairs[1 - number][0]
            for name, messages in (
                ("receive_update", speaker.updates(own, self.now)),
                ("receive_digest", speaker.digests(self.now)),
                ("receive_request", speaker.requests(self.now)),
            ):
                for rows in messages:
                    try:
                        getattr(receiver, name)(rows, self.now)
                    except UpdateRefusedError as error:
                        own = name == "receive_update" and decode_update(rows).sender is None
                        if number == 0 and own:
                            refused.append(str(error))
        return refused

    def receive(self, kind: str, rows: Rows) -> float:
        """Tell one message; returns the processor's time for it [s]."""
        names = {"update": "receive_update", "request": "receive_request"}
        start = time.thread_time()
        try:
            getattr(self.member, names.get(kind, "receive_digest"))(rows, self.now)
            result = "received"
        except InfomapError as error:
            reason = error.reason if isinstance(error, UpdateRefusedError) else type(error).__name__
            result = f"refused: {reason}"
        self.results[f"{kind}, {result}"] += 1
        return time.thread_time() - start

    def endure(self, messages: list[Any]) -> None:
        """A round: hear these messages, with pauses, and judge.

        Raises:
            AssertionError: a bound of this file is broken.
        """
        size = count = 0
        before, spent = self.member.replica.memory_bytes(), 0.0
        for (kind, parts, times), pause in messages:
            for rows in parts * times:
                took = self.receive(kind, rows)
                size, count, spent = size + message_bytes(rows), count + 1, spent + took
                self.worst = max(self.worst, took)
                assert took < MOST_TIME, (kind, took, len(rows))
            self.now += pause
            assert not (refused := self.talk()), refused
        assert spent <= 0.01 * count + TIME_PER_BYTE * size, (spent, count, size)
        grown = self.member.replica.memory_bytes() - before
        assert grown <= MOST_KEPT * size + 200_000, (grown, size)
        assert self.member.replica.memory_bytes() <= CONFIG.memory_limit * 1e9
        assert kept_beside_the_map(self.member) <= MOST_BESIDE
        assert len(self.member.replica.robots) <= 64


def agent_text() -> str:
    """What a robot tells of itself."""
    agent = Agent(3, 33, START, 10**9, 10**9, np.eye(4), np.eye(4), np.eye(6), LENS, 4.0)
    return agent_to_text(agent)


odd_values = st.one_of(
    st.sampled_from([0, -1, 2**64, 1e308, "", "x" * 300, [], {}, None, True]),
    versions,
    robots,
    st.lists(st.floats(-1e9, 1e9), max_size=22),
    st.dictionaries(st.text("0123456789a", max_size=6), versions, max_size=5),
)
agent_changes = st.dictionaries(st.sampled_from(sorted(json.loads(agent_text()))), odd_values)
agent_rounds = st.lists(st.tuples(agent_changes, st.floats(0.0, 100.0)), max_size=12)


class Board:
    """What is known of robots by their odd texts."""

    def __init__(self) -> None:
        self.board, self.now, self.results = AgentBoard(1, 11), 0.0, Counter[str]()
        other = AgentBoard(1, 11)
        for _ in range(2):  # what is compiled is compiled now
            other.receive(agent_text(), 0.0, START)

    def endure(self, messages: list[Any]) -> None:
        """A round: hear these texts, with pauses, and judge.

        Raises:
            AssertionError: a bound of this file is broken.
        """
        for changes, pause in messages:
            text = json.dumps(json.loads(agent_text()) | changes)
            start = time.thread_time()
            try:
                result = "received" if self.board.receive(text, self.now, START) else "not new"
            except InfomapError as error:
                result = f"refused: {type(error).__name__}"
            took = time.thread_time() - start
            self.results[f"agent, {result}"] += 1
            assert took < 0.05 + TIME_PER_BYTE * len(text), (took, len(text))
            assert len(self.board.remembered(self.now)) <= 64
            assert len(self.board.past()) <= 64
            self.now += pause


def endure_rounds(victim: Victim | Board, first_seed: int, count: int) -> None:
    """Let a robot, or its board, endure so many random rounds, one after another.

    Raises:
        AssertionError: a bound of this file is broken.
    """

    @seed(first_seed)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(messages=rounds if isinstance(victim, Victim) else agent_rounds)
    def endure(messages: list[Any]) -> None:
        victim.endure(messages)

    endure()


def main() -> None:
    """Run until the time is over; a failure ends it and is shown with the round."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    end, turn, victims = time.monotonic() + arguments.seconds, arguments.seed, 0
    results, worst, largest = Counter[str](), 0.0, Counter[str]()
    while time.monotonic() < end:
        turn, victim, board = turn + 1000, Victim(), Board()
        victims += 1

        endure_rounds(victim, turn, 200)
        endure_rounds(board, turn, 200)
        results.update(victim.results + board.results)
        worst = max(worst, victim.worst)
        largest["robots"] = max(largest["robots"], len(victim.member.replica.robots))
    for name, count in sorted(results.items()):
        print(f"{count:9d} {name}")
    print(
        f"{results.total()} messages to {victims} robots in {arguments.seconds:.0f} s; "
        f"the slowest took {1e3 * worst:.0f} ms; {largest['robots']} robots in a map at the most"
    )


if __name__ == "__main__":
    main()
