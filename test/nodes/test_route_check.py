"""A box that the map shows on the way, while the robot is under way, stops it with the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from infomap_ros.exploration.records.choice_text import route_digest
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.state import VoxelStates, information_of, put_states
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.planning.exploration_status import read_status

from .rovers import PaperRover, update_messages
from .test_next_best_view import Stage

VOXEL = 0.1  # of the rover's map [m]
BOX = 0.4  # edge [m]
FAR_AWAY = {
    "task__region_low": (1.9, -2.0, -0.2),
    "task__region_high": (3.2, 2.0, 1.5),
    "max_range": 1.5,
}  # what is to be seen: the base has to go there


def box_at(place: np.ndarray) -> VoxelMap:
    """A map that knows nothing but a box on the ground at a place, shape (3,)."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=VOXEL, max_range=5.0))
    voxel_map.track_changes(True)
    low = np.floor((place - [0.5 * BOX, 0.5 * BOX, 0.1]) / VOXEL).astype(np.int32)
    indices = np.indices([round(BOX / VOXEL)] * 3, np.int32).reshape(3, -1).T + low
    solid, quanta = np.ones(len(indices), bool), np.full(len(indices), 100, np.int32)
    covariances = np.tile(1e-4 * np.eye(3), (len(indices), 1, 1))
    gaussians = information_of(indices, solid, (indices + 0.5) * VOXEL, covariances, VOXEL)
    put_states(voxel_map._storage, VoxelStates(indices, solid, quanta, gaussians))
    return voxel_map


def room(rover: PaperRover) -> VoxelMap:
    return rover.looks(-0.8, 0.0, 0.8)


def test_a_box_on_the_way_stops_the_robot_with_the_reason(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, **FAR_AWAY)
    stage.rover.obeys = False  # the base never gets to the end of its way
    states = graph.collect(DiagnosticStatus, "route_status", qos.latched())
    said = graph.collect(DiagnosticStatus, "exploration_status", qos.latched())
    for message in update_messages(room(stage.rover)):
        stage.rover.updates.publish(message)
    stage.rover.tells_updates = True
    graph.add(
        ExplorerNode,
        autostart=True,
        progress_timeout=60.0,
        mission_file=str(tmp_path / "mission.json"),
        log_file=str(tmp_path / "run.jsonl"),
    )
    graph.spin_until(lambda: stage.rover.paths, "a path of the base", timeout=90.0)
    assert {state.level for state in states} == {DiagnosticStatus.OK}
    sent = stage.node._planner.planner.motion._sent
    assert sent is not None and sent.moves_base
    end = sent.base_poses[-1][:3, 3]
    place = end * (1.0 + 0.3 / np.linalg.norm(end))  # under the front of the rover, at the end
    assert np.linalg.norm(place) > 0.6, "the box must not stand on the robot"

    for message in update_messages(box_at(place), robot=7):
        stage.team.publish(message)

    graph.spin_until(lambda: states[-1].level == DiagnosticStatus.ERROR, "the route to be blocked")
    assert states[-1].values[0].value == route_digest(sent)
    assert states[-1].message.startswith("the base path is blocked at (")
    graph.spin_until(lambda: len(stage.rover.paths) > 1, "the order to stay")
    (stay,) = stage.rover.paths[1].poses
    assert (stay.pose.position.x, stay.pose.position.y) == pytest.approx((0.0, 0.0), abs=1e-9)

    def failed() -> str:
        view = read_status(said[-1]).failed_view if said else None
        return "" if view is None else view.reason

    graph.spin_until(failed, "the failed view")
    assert failed().startswith("drive: broken off: the base path is blocked at (")
