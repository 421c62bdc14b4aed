"""Markers become places of interest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import FrameError, MalformedMessageError
from infomap_ros.geometry import Box, Sphere
from infomap_ros.geometry.solids import points_inside
from infomap_ros.nodes.next_best_view import Interests


def marker(number: int = 1, kind: int = Marker.CUBE, text: str = "3.0") -> Marker:
    made = Marker(ns="site", id=number, type=kind, text=text)
    made.header.frame_id = "map"
    made.pose.position.x = 2.0
    made.pose.orientation.z = made.pose.orientation.w = np.sqrt(0.5)
    made.scale.x, made.scale.y, made.scale.z = 1.0, 2.0, 3.0
    return made


@pytest.fixture
def interests() -> Interests:
    found = Interests("map")
    found.update(MarkerArray(markers=[marker(1), marker(2, Marker.SPHERE, " 0 ")]))
    return found


def test_boxes_and_spheres_have_place_and_weight(interests: Interests) -> None:
    box, sphere = interests.current()
    assert isinstance(box.place.solid, Box)
    assert isinstance(sphere.place.solid, Sphere)
    assert sphere.place.solid.radius == 0.5
    assert (box.weight, sphere.weight) == (3.0, 0.0)
    # A quarter turn: the box has its second side along x, from 1 to 3 m.
    points = np.array([[2.9, 0.4, 1.4], [2.9, 0.6, 0.0], [3.1, 0.0, 0.0]])
    inside = points_inside(points, [box.place])
    assert inside.tolist() == [True, False, False]


def test_markers_replace_those_of_their_name(interests: Interests) -> None:
    interests.update(MarkerArray(markers=[marker(1, text="7")]))
    assert sorted(each.weight for each in interests.current()) == [0.0, 7.0]


def test_markers_are_taken_away(interests: Interests) -> None:
    interests.update(MarkerArray(markers=[Marker(ns="site", id=1, action=Marker.DELETE)]))
    assert [each.weight for each in interests.current()] == [0.0]
    interests.update(MarkerArray(markers=[Marker(ns="other", id=2, action=Marker.DELETE)]))
    assert len(interests.current()) == 1
    interests.update(MarkerArray(markers=[Marker(action=Marker.DELETEALL), marker(5)]))
    assert [each.weight for each in interests.current()] == [3.0]


def _no_weight(made: Marker) -> None:
    made.text = ""


def _infinite_weight(made: Marker) -> None:
    made.text = "inf"


def _negative_weight(made: Marker) -> None:
    made.text = "-1"


def _other_type(made: Marker) -> None:
    made.type = Marker.CYLINDER


def _no_size(made: Marker) -> None:
    made.scale.y = 0.0


def _no_rotation(made: Marker) -> None:
    made.pose.orientation.z = made.pose.orientation.w = 0.0


def _no_place(made: Marker) -> None:
    made.pose.position.x = float("nan")


def _boundless_weight(made: Marker) -> None:
    made.text = "1e308"


def _boundless_box(made: Marker) -> None:
    made.scale.x = 1e308


def _boundless_place(made: Marker) -> None:
    made.pose.position.x = 1e300


@pytest.mark.parametrize(
    "spoil",
    [
        _no_weight,
        _infinite_weight,
        _negative_weight,
        _other_type,
        _no_size,
        _no_rotation,
        _no_place,
        _boundless_weight,
        _boundless_box,
        _boundless_place,
    ],
)
def test_a_message_counts_as_a_whole_or_not_at_all(
    interests: Interests, spoil: Callable[[Marker], None]
) -> None:
    before = interests.current()
    bad = marker(9)
    spoil(bad)
    with pytest.raises(MalformedMessageError, match="site/9"):
        interests.update(MarkerArray(markers=[marker(8), bad]))
    assert interests.current() == before


@pytest.mark.parametrize("where", ["ns", "frame"])
def test_names_that_a_terminal_would_obey_are_refused(interests: Interests, where: str) -> None:
    bad = marker(9)
    if where == "ns":
        bad.ns = "\x1b[2J"
    else:
        bad.header.frame_id = "map\n[INFO] all is well"
    with pytest.raises(MalformedMessageError, match="no printable") as refused:
        interests.update(MarkerArray(markers=[bad]))
    assert str(refused.value).isprintable()


def test_more_markers_than_anybody_sets_are_refused(interests: Interests) -> None:
    before = interests.current()
    with pytest.raises(MalformedMessageError, match="1001"):
        interests.update(MarkerArray(markers=[marker(number) for number in range(1001)]))
    assert interests.current() == before


def test_a_marker_in_another_frame_is_refused(interests: Interests) -> None:
    other = marker(3)
    other.header.frame_id = "odom"
    with pytest.raises(FrameError, match="'odom'"):
        interests.update(MarkerArray(markers=[other]))
    assert len(interests.current()) == 2
