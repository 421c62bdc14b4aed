"""A choice goes through text unchanged; what is not a choice is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.choice_text import choice_from_text, choice_to_text
from infomap_ros.exploration.robot import Choice

from .fakes import nothing, pose_at, progress, route_to

CHOICE = Choice(
    progress(), pose_at(1.0, 2.0), route_to(1.0, 2.0), "it tells most", {"terms": {"bits": 12.5}}
)


def test_everything_arrives() -> None:
    back = choice_from_text(choice_to_text(CHOICE))
    assert back.progress == CHOICE.progress
    assert (back.reason, back.explanation) == (CHOICE.reason, CHOICE.explanation)
    np.testing.assert_array_equal(back.pose, CHOICE.pose)
    assert back.route is not None and CHOICE.route is not None
    np.testing.assert_array_equal(back.route.base_path, CHOICE.route.base_path)
    np.testing.assert_array_equal(back.route.base_poses, CHOICE.route.base_poses)
    for mine, theirs in (
        (CHOICE.route.arm_before, back.route.arm_before),
        (CHOICE.route.arm_after, back.route.arm_after),
    ):
        assert mine.joint_names == theirs.joint_names
        np.testing.assert_array_equal(mine.positions, theirs.positions)
        np.testing.assert_array_equal(mine.times, theirs.times)


def test_no_view_and_no_sigma_arrive() -> None:
    back = choice_from_text(choice_to_text(nothing("all known")))
    assert (back.pose, back.route, back.reason) == (None, None, "all known")
    unknown = Choice(progress(sigma=float("nan")), None, None, "")
    assert np.isnan(choice_from_text(choice_to_text(unknown)).progress.mean_sigma)


def changed(path: list[str], value: object) -> str:
    content = json.loads(choice_to_text(CHOICE))
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return json.dumps(content)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["pose"], [[1, 0], [0, 1]]),
        (["pose"], np.diag([2.0, 1, 1, 1]).tolist()),
        (["route", "base_path"], [[0.0, float("nan"), 0.0]]),
        (["route", "base_path"], [[0.0, 0.0, 0.0]]),
        (["route", "arm_after", "positions"], [[1.0, 2.0, 3.0]]),
        (["route", "arm_after", "times"], [1.0, 0.5]),
        (["route", "arm_after", "times"], [0.0]),
        (["progress"], {"known_fraction": 1.0}),
        (["explanation"], 3),
    ],
)
def test_impossible_content_is_refused(path: list[str], value: object) -> None:
    with pytest.raises(InvalidInputError, match=r"choice|pose"):
        choice_from_text(changed(path, value))


@given(st.text() | st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps))
def test_any_other_text_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError):
        choice_from_text(text)
