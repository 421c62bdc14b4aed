"""What robots tell of themselves: the text, what is refused, and who is forgotten when."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import InfomapError, InvalidInputError, UpdateRefusedError
from infomap_ros.geometry import PinholeCamera, make_transform, perturb_transform
from infomap_ros.motion.robot.urdf import hash_of_description
from infomap_ros.team.agent_board import AgentBoard, agent_from_text, agent_to_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.config import MOST_ROBOTS
from infomap_ros.team.membership import (
    BACKWARDS,
    NOT_AUTHENTIC,
    NOT_LISTED,
    TOO_MANY,
    TWO_OF_A_NAME,
    TeamKey,
)

LENS = PinholeCamera(640, 480, 500.0, 501.0, 319.5, 239.5)
KEY = TeamKey(b"a secret of sixteen bytes")


def agent(robot: int = 3, version: int = 100, session: int = 7, **fields: Any) -> Agent:
    base = perturb_transform(make_transform(np.eye(3), (1.0, -2.0, 0.1)), [0, 0, 0, 0.1, 0.2, 0.9])
    given: dict[str, Any] = {
        "T_map_base": base,
        "T_map_camera": base @ make_transform(np.eye(3), (0.2, 0.0, 0.8)),
        "covariance": np.diag([1e-4, 4e-4, 9e-4, 1e-5, 1e-5, 1e-4]) + 1e-6,
        "camera": LENS,
        "max_range": 4.0,
        "state": "choosing",
        "joints": {"arm": 0.3, "wheel": -5.0},
        "goal": base @ make_transform(np.eye(3), (2.0, 0.0, 0.8)),
        "path": np.array([[1.0, -2.0, 0.9], [2.0, -1.0, 0.7]]),
        "claim": 4,
        "claims": {1: 9},
        "description": "/rover3/robot_description",
        "description_hash": hash_of_description("<robot/>"),
        "base_frame": "base_link",
    }
    return Agent(robot, session, version, 12_345_678_901, 12_000_000_000, **(given | fields))


def word(*told: int, **fields: Any) -> str:
    """The text of an `agent`."""
    return agent_to_text(agent(*told, **fields))


def test_a_text_says_all_of_it() -> None:
    told = agent()
    read = agent_from_text(agent_to_text(told))
    for name in ("T_map_base", "T_map_camera", "covariance", "goal", "path"):
        np.testing.assert_allclose(getattr(read, name), getattr(told, name), atol=1e-12)
    same = [
        "robot",
        "session",
        "version",
        "stamp",
        "since",
        "camera",
        "max_range",
        "state",
        "joints",
    ]
    same += ["claim", "claims", "radius", "bottom", "top", "base_frame"]
    same += ["description", "description_hash"]
    assert {n: getattr(read, n) for n in same} == {n: getattr(told, n) for n in same}


def test_what_is_not_known_is_not_made_up() -> None:
    read = agent_from_text(agent_to_text(agent(covariance=None, goal=None, path=np.empty((0, 3)))))
    assert read.covariance is None
    assert read.goal is None
    assert read.path.shape == (0, 3)


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("robot", 70_000, "agent robot: 70000"),
        ("robot", 1.5, "not a whole number"),
        ("version", 0, "agent version"),
        ("since", 12_345_678_902, "agent since"),
        ("base", [0, 0, 0, 0, 0, 0, 2], "norm 2"),
        ("base", [1e9, 0, 0, 0, 0, 0, 1], "is at"),
        ("goal", [0, 0, 0], "3 numbers, expected 7"),
        ("covariance", [-1.0] + 20 * [0.0], "negative eigenvalue"),
        ("covariance", [1e300] + 20 * [0.0], "larger than any error"),
        ("lens", [640, 480, -1, 1, 1, 1], "not positive"),
        ("max_range", 1e300, "max_range"),
        ("path", 300 * [[0, 0, 0]], "300 places"),
        ("path", [[0, 0]], "2 numbers, expected 3"),
        ("joints", {"a": "b"}, "not a finite number"),
        ("joints", {"a": 10**400}, "too large"),
        ("claims", {"-1": 3}, "agent claims"),
        ("claims", {"x": 3}, "invalid literal"),
        ("state", "a\u0000b", "not printable"),
        ("description", 3, "not a text"),
        ("description", "/a b", "not the name of a topic"),
        ("description", "relative", "not the name of a topic"),
        ("top", -50.0, "agent top"),
        ("description_hash", "zz", "not a hash"),
    ],
)
def test_what_is_impossible_is_refused_and_named(field: str, value: Any, problem: str) -> None:
    content = json.loads(agent_to_text(agent()))
    with pytest.raises(InvalidInputError, match=problem):
        agent_from_text(json.dumps(content | {field: value}))


@pytest.mark.parametrize(
    "text", ["", "null", "[]", '{"infomap_agent":1}', "[" * 60_000, "1" * 70_000, "NaN", "\ud800"]
)
def test_what_is_no_such_text_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match="agent"):
        agent_from_text(text)


def test_changed_texts_are_read_or_refused_and_never_end_the_process() -> None:
    rng = np.random.default_rng(5)
    text = agent_to_text(agent())
    read = 0
    for _ in range(3000):
        letters = list(text)
        for place in rng.integers(len(letters), size=rng.integers(1, 4)):
            letters[place] = chr(rng.integers(1, 128))
        try:
            read += isinstance(agent_from_text("".join(letters)), Agent)
        except InfomapError:
            continue
    assert 0 < read < 3000


def test_with_a_key_only_what_was_signed_with_it_counts() -> None:
    signed = agent_to_text(agent(), KEY)
    assert agent_from_text(signed, KEY).robot == 3
    assert agent_from_text(signed).robot == 3
    other = TeamKey(b"another secret of the same size")
    forged = signed.replace('"claim":4', '"claim":5')
    for text in (agent_to_text(agent()), agent_to_text(agent(), other), forged, signed + "0"):
        with pytest.raises(UpdateRefusedError) as refused:
            agent_from_text(text, KEY)
        assert refused.value.reason == NOT_AUTHENTIC


def test_a_board_with_a_key_hears_only_its_team() -> None:
    board = AgentBoard(0, 1, key=KEY)
    assert refusal(board, word()) == NOT_AUTHENTIC
    assert board.receive(agent_to_text(agent(), KEY), 0.0)


def test_the_newest_word_of_each_counts_in_whatever_order_it_comes() -> None:
    board = AgentBoard(0, 1)
    news = [board.receive(word(2, version, claim=version), 0.0) for version in (10, 12, 11, 12)]
    assert [each is not None for each in news] == [True, True, False, False]
    assert board.receive(word(1, 50), 0.0)
    assert [(each.robot, each.claim) for each in board.present(0.0)] == [(1, 4), (2, 12)]
    assert board.claims(0.0) == {1: 4, 2: 12}


def test_the_silent_lose_their_goals_first_and_are_forgotten_then() -> None:
    board = AgentBoard(0, 1)
    board.receive(word(2), 10.0)
    for now, goals, bodies in ((15.0, 1, 1), (15.1, 0, 1), (70.0, 0, 1), (70.1, 0, 0)):
        assert (len(board.present(now)), len(board.remembered(now))) == (goals, bodies)
    assert board.receive(word(2, 101), 80.0)


@pytest.mark.parametrize("session", [1, None])
def test_own_words_are_no_news(session: int | None) -> None:
    board = AgentBoard(3, session)
    assert not board.receive(word(3, session=1), 0.0, own_version=100)
    assert board.remembered(0.0) == ()


def refusal(board: AgentBoard, told: str, now: float = 0.0) -> str:
    with pytest.raises(UpdateRefusedError) as refused:
        board.receive(told, now, own_version=100)
    return refused.value.reason


def test_strangers_namesakes_and_the_past_are_refused() -> None:
    board = AgentBoard(0, 1, team=(3,))
    board.receive(word(3, 10**6), 0.0)
    before = board.present(0.0)
    assert refusal(board, word(9)) == NOT_LISTED
    assert refusal(board, word(3, 10**6 - 20_000)) == BACKWARDS
    board.receive(word(0, 101, session=2), 0.0, own_version=100)
    assert refusal(board, word(0, 102, session=2), 6.0) == TWO_OF_A_NAME
    assert board.present(0.0) == before


def test_a_robot_that_has_started_again_is_the_same_robot() -> None:
    board = AgentBoard(0, 1)
    board.receive(word(3, 100, session=7, claim=40), 0.0)
    assert board.receive(word(3, 200, session=8, claim=1), 1.0)
    assert not board.receive(word(3, 101, session=7, claim=41), 1.1), "late, from before"
    assert board.claims(1.1) == {3: 1}


@pytest.mark.parametrize(("session", "behind"), [(7, 0), (7, 5000), (5, 100_000), (7, 2**23 + 1)])
def test_old_words_of_who_has_fallen_silent_make_no_ghost(session: int, behind: int) -> None:
    board = AgentBoard(0, 1, (3,), KEY)
    board.receive(agent_to_text(agent(3, 2**30), KEY), 0.0)
    old = agent_to_text(agent(3, 2**30 - behind, session), KEY)
    for now in (1.0, 30.0, 90.0, 700.0):
        try:
            assert not board.receive(old, now)
        except UpdateRefusedError as error:
            assert error.reason == BACKWARDS
        assert board.past() in ({3: 2**30}, {}), "whoever it is learns it"
    assert board.remembered(700.0) == ()
    assert board.receive(agent_to_text(agent(3, 2**30 + 9), KEY), 701.0)


def test_a_robot_whose_clock_was_never_set_is_heard_after_it_was_forgotten() -> None:
    board = AgentBoard(0, 1)
    board.receive(word(3, 2**30), 0.0)
    assert refusal(board, word(3, 1000, session=8), 1.0) == BACKWARDS
    assert board.receive(word(3, 1001, session=8), 61.0)
    assert board.receive(word(3, 1002, session=8), 62.0)


def test_more_robots_than_a_team_has_are_refused() -> None:
    board = AgentBoard(0, 1)
    for robot in range(1, MOST_ROBOTS):
        assert board.receive(word(robot), 0.0)
    assert refusal(board, word(9999)) == TOO_MANY


def test_a_pose_tells_how_sure_it_is() -> None:
    assert agent(covariance=np.diag([1.0, 4.0, 0.25, 1, 1, 1])).position_sigma == 2.0
    assert replace(agent(), covariance=None).position_sigma == 0.0
    assert agent(covariance=1e-2 * np.eye(6), radius=0.4).reach == pytest.approx(0.7)
