"""What explorer says of views that brought nothing, as next_best_view reads it."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import KeyValue

from infomap_ros.errors import MalformedMessageError
from infomap_ros.exploration.loop import Exploration
from infomap_ros.exploration.robot import FailedView
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.nodes.planning.exploration_status import read_status, status_message
from test.exploration.fakes import FakePlanner, FakeRobot, Notes, view


def exploration() -> Exploration:
    return Exploration(FakeRobot(), FakePlanner(view(1.0)), TaskConfig(), Notes())


@pytest.mark.parametrize("reached", [False, True])
def test_a_failed_view_arrives_as_it_was_told(reached: bool) -> None:
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 0.1 + 0.2
    told = [FailedView(np.eye(4), "drive: stuck"), FailedView(pose, "look: lost", reached)]

    news = read_status(status_message(exploration(), told))

    assert news.failures == 2
    assert news.failed_view is not None
    np.testing.assert_array_equal(news.failed_view.pose, pose)
    assert (news.failed_view.reason, news.failed_view.reached) == ("look: lost", reached)


def test_a_view_that_was_reached_perhaps_is_malformed() -> None:
    message = status_message(exploration(), [FailedView(np.eye(4), "drive: stuck")])
    message.values = [pair for pair in message.values if pair.key != "failed view reached"]
    message.values = [*message.values, KeyValue(key="failed view reached", value="0.5")]

    with pytest.raises(MalformedMessageError, match="failed view reached"):
        read_status(message)
