"""Robots whose maps are in frames of their own keep them apart until one has moved its map."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.team.agent_board import AgentBoard, agent_from_text, agent_to_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.wire import decode_update, encode_update

CONFIG = VoxelMapConfig(voxel_size=0.1)
SHARING = TeamConfig(recovery=0.0)
PERIOD = 0.1  # [s]
FIRST, SECOND = 1 << 16 | 7, 2 << 16 | 9
Part = tuple[TeamMember, VoxelMap]


def mapped(offset: float, origin: int) -> VoxelMap:
    """A map of a wall at an offset [m] along y."""
    voxel_map = VoxelMap(CONFIG)
    voxel_map.track_changes(True)
    y, z = np.mgrid[-1:1:0.04, -0.6:0.6:0.04]
    wall = np.stack([np.full(y.size, 2.0), y.ravel() + offset, z.ravel()], axis=-1)
    voxel_map.integrate(wall, np.eye(4), covariances=None)
    voxel_map.origin = origin
    return voxel_map


def talk(
    parts: list[Part], seconds: float, start: float, rng: np.random.Generator, loss: float
) -> float:
    """Let robots send for a while, with a share of the messages lost; returns the time [s]."""
    now = start
    for _ in range(round(seconds / PERIOD)):
        now += PERIOD
        for member, own_map in parts:
            for kind, messages in (
                ("update", member.updates(own_map, now)),
                ("digest", member.digests(now)),
                ("request", member.requests(now)),
            ):
                for rows in messages:
                    for other, _ in parts:
                        if other is not member and rng.random() >= loss:
                            getattr(other, f"receive_{kind}")(rows, now)
    return now


def known(voxel_map: VoxelMap) -> set[tuple[int, ...]]:
    indices: NDArray[np.int32] = voxel_map.voxels()[0]
    return {tuple(index) for index in indices.tolist()}


def members() -> list[Part]:
    maps = mapped(0.0, FIRST), mapped(0.5, SECOND)
    return [
        (TeamMember(number, number, 100, CONFIG, SHARING), own)
        for number, own in enumerate(maps, start=1)
    ]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_two_maps_until_one_is_moved_then_one_hash(rng: np.random.Generator, loss: float) -> None:
    parts = members()
    alone = [known(own) for _, own in parts]
    now = talk(parts, 6.0, 0.0, rng, loss)
    for (member, _), own in zip(parts, alone, strict=True):
        assert known(member.replica.voxel_map) == own
        assert len(member.replica.robots) == 2 and len(member.replica.aside) == 1

    first, (second, _) = parts
    moved = mapped(-0.5, FIRST)  # nothing of where it was may stay
    parts = [first, (second, moved)]
    talk(parts, 6.0, now, rng, loss)
    assert second.replica.hash() == first[0].replica.hash()
    for member, _ in parts:
        assert member.replica.aside == ()
        assert known(member.replica.voxel_map) == alone[0] | known(moved)
        np.testing.assert_array_equal(
            member.replica.voxel_map.log_odds(np.array([[1.0, 0.0, 0.0]])),
            parts[0][0].replica.voxel_map.log_odds(np.array([[1.0, 0.0, 0.0]])),
        )


def test_what_comes_late_of_the_old_frame_is_void(rng: np.random.Generator) -> None:
    (first, own), (second, before) = members()
    late = second.updates(before, 0.1)
    after = mapped(-0.5, FIRST)
    for rows in second.updates(after, 0.4):
        first.receive_update(rows, 0.4)
    first.updates(own, 0.4)
    held = known(first.replica.voxel_map), first.replica.contribution(2).hash()
    for rows in late:
        assert first.receive_update(rows, 0.5) == 0
    assert held == (known(first.replica.voxel_map), first.replica.contribution(2).hash())


def test_who_restarts_does_not_take_back_what_it_had_in_another_frame(
    rng: np.random.Generator,
) -> None:
    parts = members()
    now = talk(parts, 3.0, 0.0, rng, 0.0)
    again = TeamMember(2, 5, 1000, CONFIG, TeamConfig(recovery=2.0))
    moved = mapped(-0.5, FIRST)
    alone = known(moved)
    talk([parts[0], (again, moved)], 6.0, now, rng, 0.0)
    assert known(moved) == alone
    assert known(parts[0][0].replica.voxel_map) == known(parts[0][1]) | alone


def test_who_names_no_frame_is_in_that_of_the_others(rng: np.random.Generator) -> None:
    maps = mapped(0.0, 0), mapped(0.5, SECOND)
    parts = [
        (TeamMember(number, number, 100, CONFIG, SHARING), own) for number, own in enumerate(maps)
    ]
    talk(parts, 4.0, 0.0, rng, 0.0)
    assert all(member.replica.aside == () for member, _ in parts)


def test_the_frame_is_in_the_message() -> None:
    _, (second, own) = members()
    for rows in second.updates(own, 0.1):
        update = decode_update(rows)
        assert update.origin == SECOND
        (again,) = encode_update(update)
        assert decode_update(again).origin == SECOND


def agent(robot: int, origin: int) -> Agent:
    camera = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
    pose = np.eye(4)
    return Agent(robot, 7, 100, 10, 10, pose, pose, None, camera, 4.0, origin=origin)


def test_who_is_in_another_frame_is_known_but_nowhere() -> None:
    board = AgentBoard(1, None)
    board.origin = FIRST
    assert board.receive(agent_to_text(agent(2, SECOND)), 0.0) is not None
    assert board.present(0.0) == board.remembered(0.0) == ()
    assert board.claims(0.0) == {}
    board.origin = SECOND
    assert [each.robot for each in board.present(0.0)] == [2]
    assert agent_from_text(agent_to_text(agent(2, SECOND))).origin == SECOND
    with pytest.raises(InvalidInputError, match="origin"):
        agent(2, 2**32)
