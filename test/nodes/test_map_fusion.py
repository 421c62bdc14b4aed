"""map_fusion over DDS: numbers, stamps and frames of what it publishes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from infomap_ros.errors import ConfigError, MapFileError
from infomap_ros.geometry import (
    JointStateRecord,
    PinholeCamera,
    PointCloudRecord,
    PoseRecord,
    TextRecord,
    make_transform,
)
from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.mapping import (
    LOG_ODDS_QUANTUM,
    NOT_OBSERVED,
    SHARED_LOG_ODDS_LIMIT,
    VoxelChanges,
    VoxelMap,
    VoxelMapConfig,
)
from infomap_ros.mapping.files.export import obstacle_distances
from infomap_ros.messages import encode, encode_point_cloud, encode_pose
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.fusion import map_outputs
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.team import reconciler
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import TeamKey
from infomap_ros.team.update import MapUpdate, version_at
from infomap_ros.team.wire import decode_update, encode_update

TYPES = RclpyMessageTypes()
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
FRAME = "left_optical_frame"
CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
# The camera looks along +x of the map from 1 m above its origin.
T_MAP_CAMERA = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 1.0])
COVARIANCE = np.diag([1e-6] * 6)


def cloud(stamp: int = START, depth: float = 2.0, frame: str = FRAME) -> PointCloudRecord:
    """A wall in front of the camera."""
    points = CAMERA.back_project(np.full((48, 64), depth))
    covariances = np.broadcast_to(1e-4 * np.eye(3, dtype=np.float32), (48, 64, 3, 3))
    return PointCloudRecord(stamp, frame, points, covariances)


def pose(stamp: int = START, frame: str = "map", covariance: Any = COVARIANCE) -> PoseRecord:
    return PoseRecord(stamp, frame, T_MAP_CAMERA, covariance)


def stamp_of(message: Any) -> int:
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


@pytest.fixture(autouse=True)
def _many_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_outputs, "_PERIOD", 0.05)


class Bench:
    """The node with everything around it connected."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph = graph
        self.node = graph.add(MapFusionNode, **{"voxel_size": 0.1, **parameters})
        self.clouds = graph.publisher(PointCloud2, "points2")
        self.poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose", depth=100)
        self.updates = graph.collect(PointCloud2, "map_updates", qos.stream(100))
        graph.connect(self.clouds, self.poses)
        topic = graph.tester.resolve_topic_name("map_updates")
        graph.spin_until(lambda: graph.tester.count_publishers(topic), "map_updates")

    def send(self, *records: PointCloudRecord | PoseRecord) -> None:
        for record in records:
            if isinstance(record, PoseRecord):
                self.poses.publish(encode_pose(TYPES, record))
            else:
                self.clouds.publish(encode_point_cloud(TYPES, record))

    def wait_for_results(self, count: int) -> None:
        self.graph.spin_until(lambda: self.node.health.results() >= count, f"{count} scans")

    def wait_for_drop(self, reason: str) -> str:
        health = self.node.health
        self.graph.spin_until(lambda: reason in health.drops(), f"a drop: {reason}")
        return health.values()[f"last drop: {reason}"]

    def wait_for_updates(self, stamp: int) -> list[Any]:
        self.graph.spin_until(
            lambda: any(stamp_of(m) == stamp for m in self.updates), "map_updates"
        )
        return [m for m in self.updates if stamp_of(m) == stamp]

    def wait_for_map(self, expected: dict[Any, Any]) -> None:
        """Until who listens to map_updates has this map."""
        self.graph.spin_until(lambda: replica(self.updates) == expected, "the expected map")

    def call(self, service: str) -> Trigger.Response:
        client = self.graph.tester.create_client(Trigger, f"map_fusion/{service}")
        self.graph.spin_until(client.service_is_ready, service)
        answer = client.call_async(Trigger.Request())
        self.graph.spin_until(answer.done, f"the answer of {service}")
        return answer.result()


def replica(messages: list[Any]) -> dict[tuple[int, int, int], tuple[int, bool]]:
    """Voxel -> (log-odds, surface), the newest version of each, as a listener keeps it."""
    newest: dict[Any, Any] = {}
    for message in messages:
        rows = decode_rows(message)[2]
        if not len(rows):
            continue
        update = decode_update(rows)
        for index, odds, surface in zip(
            update.indices.tolist(), update.log_odds, update.has_gaussian, strict=True
        ):
            known = newest.get(tuple(index), (-1,))
            if update.version > known[0]:
                newest[tuple(index)] = (update.version, int(odds), bool(surface))
    return {index: value[1:] for index, value in newest.items() if value[1] != NOT_OBSERVED}


def as_replica(voxel_map: VoxelMap) -> dict[tuple[int, int, int], tuple[int, bool]]:
    indices, log_odds = voxel_map.voxels()
    quanta = np.rint(log_odds / LOG_ODDS_QUANTUM)
    quanta = np.clip(quanta, -SHARED_LOG_ODDS_LIMIT, SHARED_LOG_ODDS_LIMIT).astype(int)
    surface = {tuple(index) for index in voxel_map.gaussians()[0].tolist()}
    return {
        tuple(i): (int(q), tuple(i) in surface)
        for i, q in zip(indices.tolist(), quanta, strict=True)
    }


def expected_map(*scans: PointCloudRecord, voxel_size: float = 0.1) -> VoxelMap:
    expected = VoxelMap(VoxelMapConfig(voxel_size=voxel_size))
    for scan in scans:
        expected.integrate(scan.points, T_MAP_CAMERA, scan.covariances, COVARIANCE, CAMERA)
    return expected


def test_updates_are_the_map_that_the_library_makes_of_the_same_scans(graph: Any) -> None:
    bench = Bench(graph)
    scans = [cloud(START + i * SECOND // 10, 2.0 + 0.3 * i) for i in range(3)]
    for number, scan in enumerate(scans):
        bench.send(pose(scan.stamp), scan)
        bench.wait_for_results(number + 1)
    bench.wait_for_map(as_replica(expected_map(*scans)))

    messages = bench.updates
    assert {stamp_of(m) for m in messages} == {scan.stamp for scan in scans}
    assert {m.header.frame_id for m in messages} == {"map"}
    assert max(len(m.data) for m in messages) < 1_000_000
    assert [f.name for f in messages[0].fields][:2] == ["index", "log_odds"]


def test_a_wall_at_two_meters_is_in_voxel_map_and_projected_map(graph: Any) -> None:
    bench = Bench(graph, projection__low=0.5, projection__high=1.5)
    clouds = graph.collect(PointCloud2, "voxel_map", qos.latched())
    grids = graph.collect(OccupancyGrid, "projected_map", qos.latched())
    bench.send(pose(), cloud())
    graph.spin_until(
        lambda: clouds and clouds[-1].width and grids and grids[-1].info.width > 1,
        "voxel_map and projected_map",
    )

    _, frame, rows = decode_rows(clouds[-1])
    assert (stamp_of(clouds[-1]), frame) == (START, "map")
    assert rows.dtype.names == ("x", "y", "z", "probability", "sigma")
    assert np.median(rows["x"]) == pytest.approx(2.0, abs=0.02)
    assert (rows["probability"] > 0.5).mean() > 0.9
    assert ((rows["sigma"] > 0.0) & (rows["sigma"] < 0.05)).all()
    grid = grids[-1]
    assert (stamp_of(grid), grid.header.frame_id) == (START, "map")
    assert grid.info.resolution == pytest.approx(0.1)
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    origin = grid.info.origin.position
    row = int((0.0 - origin.y) / 0.1)
    assert cells[row, int((2.0 - origin.x) / 0.1)] > 60
    assert 0 <= cells[row, int((1.0 - origin.x) / 0.1)] < 40


def distance_at(message: PointCloud2, x: float, y: float, z: float) -> float:
    """The distance of the voxel of 0.1 m that holds a point, NaN where there is none."""
    rows = decode_rows(message)[2]
    offsets = np.stack([rows["x"] - x, rows["y"] - y, rows["z"] - z])
    (held,) = np.nonzero((np.abs(offsets) < 0.0501).all(axis=0))
    return float(rows["intensity"][held[0]]) if len(held) else np.nan


def test_distances_to_a_wall_follow_the_wall(graph: Any) -> None:
    bands = {"projection__low": 0.5, "projection__high": 1.5}
    bench = Bench(graph, distances__limit=0.7, **bands)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    fields = graph.collect(PointCloud2, "distance_field", qos.latched())
    slices = graph.collect(PointCloud2, "distance_slice", qos.latched())
    bench.send(pose(), cloud(START, 2.05))
    graph.spin_until(lambda: fields and slices, "distances")
    for message in (fields[-1], slices[-1]):
        _, frame, rows = decode_rows(message)
        assert (stamp_of(message), frame) == (START, "map")
        assert rows.dtype.names == ("x", "y", "z", "intensity")
        assert rows["intensity"].max() == np.float32(0.7)
        for x, meters in ((1.05, 0.7), (1.55, 0.45), (1.75, 0.25), (2.05, 0.0)):
            assert distance_at(message, x, 0.05, 1.05) == pytest.approx(meters, abs=1e-5)
        assert np.isnan(distance_at(message, 2.55, 0.05, 1.05)), "behind the wall"
    assert len(np.unique(decode_rows(fields[-1])[2]["z"])) > 5
    np.testing.assert_allclose(decode_rows(slices[-1])[2]["z"], 1.0)

    later = START + SECOND // 2
    bench.send(cloud(later, frame="elsewhere"))
    bench.wait_for_drop("wrong frame")
    bench.send(pose(later), cloud(later, 1.35))

    def nearer(messages: list[PointCloud2]) -> bool:
        return distance_at(messages[-1], 1.05, 0.05, 1.05) == pytest.approx(0.25, abs=1e-5)

    graph.spin_until(lambda: nearer(fields) and nearer(slices), "distances to the nearer wall")
    assert {stamp_of(fields[-1]), stamp_of(slices[-1])} == {later}
    (message,) = other_robot(7, [20])
    team.publish(message)
    graph.spin_until(
        lambda: distance_at(fields[-1], 10.05, 0.05, 0.05) == 0.0, "what another robot saw"
    )


def test_distances_leave_the_thread_of_the_map_most_of_its_time(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[float] = []

    def slow(*arguments: Any) -> Any:
        begun.append(time.monotonic())
        time.sleep(0.2)
        return obstacle_distances(*arguments)

    monkeypatch.setattr("infomap_ros.nodes.fusion.map_outputs.obstacle_distances", slow)
    bench = Bench(graph)
    for step in range(3):  # nobody listens
        bench.send(pose(START + step), cloud(START + step))
    bench.wait_for_results(3)
    graph.collect(PointCloud2, "voxel_map", qos.latched())
    assert not begun
    graph.collect(PointCloud2, "distance_slice", qos.latched())
    sent = time.monotonic()
    stamp = START + SECOND

    def scans_come() -> bool:
        nonlocal sent, stamp
        if time.monotonic() > sent + 0.1:
            sent, stamp = time.monotonic(), stamp + SECOND // 10
            bench.send(pose(stamp), cloud(stamp))
        return len(begun) >= 3

    graph.spin_until(scans_come, "three slices")
    assert (np.diff(begun) >= 1.0).all()
    bench.node._keeper.outputs._pictures["distance_slice"].rests_until = np.inf
    graph.collect(PointCloud2, "distance_slice", qos.latched())
    graph.spin_until(lambda: len(begun) > 3, "a slice for a new subscriber")


def test_who_comes_late_gets_the_voxel_map(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)

    clouds = graph.collect(PointCloud2, "voxel_map", qos.latched())

    graph.spin_until(lambda: clouds and clouds[-1].width, "voxel_map")


def test_who_comes_late_to_the_updates_gets_the_whole_map_in_slices(graph: Any) -> None:
    bench = Bench(graph, voxel_size=0.05, team_map__bandwidth=0.1)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    expected = as_replica(expected_map(cloud(), voxel_size=0.05))
    bench.wait_for_map(expected)

    late = graph.collect(PointCloud2, "map_updates", qos.stream(100))

    graph.spin_until(lambda: replica(late) == expected, "the map")
    assert len(expected) > 10_000
    assert max(len(message.data) for message in late) < 0.5 * sum(len(m.data) for m in late)


def test_scans_that_nobody_heard_of_are_told_when_somebody_listens(graph: Any) -> None:
    node = graph.add(MapFusionNode, voxel_size=0.1)
    clouds = graph.publisher(PointCloud2, "points2")
    poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose")
    graph.connect(clouds, poses)
    poses.publish(encode_pose(TYPES, pose()))
    clouds.publish(encode_point_cloud(TYPES, cloud()))
    graph.spin_until(lambda: node.health.results() == 1, "the scan")

    updates = graph.collect(PointCloud2, "map_updates", qos.stream(100))

    expected = as_replica(expected_map(cloud()))
    graph.spin_until(lambda: replica(updates) == expected, "the map")


def test_a_map_that_is_resumed_is_told_without_a_scan(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.infomap"
    expected_map(cloud()).save(file)

    bench = Bench(graph, map_file=str(file), resume=True)

    bench.wait_for_map(as_replica(expected_map(cloud())))


def test_a_cloud_waits_for_its_pose(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(cloud())
    later = START + SECOND // 20
    bench.send(pose(START - SECOND // 20), pose(later))

    bench.wait_for_results(1)
    assert bench.wait_for_updates(START)
    assert bench.node.health.drops() == {}


def test_a_cloud_without_pose_is_dropped_with_its_reason(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(START + SECOND), cloud(START))

    detail = bench.wait_for_drop("no pose at the stamp")

    assert "before the first pose" in detail
    assert bench.node.health.results() == 0


def other_robot(version: int, odds: Sequence[int], **changes: Any) -> list[PointCloud2]:
    """What robot 9 tells of the voxels (100, 0, 0), (101, 0, 0), ..., without surface."""
    count = len(odds)
    indices = np.array([[100 + i, 0, 0] for i in range(count)], np.int32)
    nothing = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    states = {"voxel_size": 0.1, "robot": 9, "version": version} | changes
    changed = VoxelChanges(
        indices, np.array(odds, np.int8), np.zeros(count, np.bool_), nothing[0], nothing[1]
    )
    update = MapUpdate.of_changes(changed, **states)
    return [encode_rows(TYPES, START, "map", rows) for rows in encode_update(update)]


def test_the_grid_shows_what_other_robots_saw_and_the_updates_do_not(graph: Any) -> None:
    bench = Bench(graph, projection__low=0.0, projection__high=2.0)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    grids = graph.collect(OccupancyGrid, "projected_map", qos.latched())
    bench.send(pose(), cloud())
    bench.wait_for_results(1)

    for message in other_robot(7, [20, -20]):
        team.publish(message)

    def cell(x: float, y: float) -> int:
        info = grids[-1].info
        column = int((x - info.origin.position.x) / 0.1)
        row = int((y - info.origin.position.y) / 0.1)
        inside = 0 <= column < info.width and 0 <= row < info.height
        return int(grids[-1].data[row * info.width + column]) if inside else -1

    wanted = [(10.05, 0.05, 100), (10.15, 0.05, 0), (2.05, 0.05, 100), (1.05, 0.05, 0)]
    graph.spin_until(
        lambda: grids and all(cell(x, y) == value for x, y, value in wanted), "both robots' part"
    )
    bench.wait_for_map(as_replica(expected_map(cloud())))


@pytest.mark.parametrize(
    ("changes", "frame", "reason"),
    [
        ({}, "odom", "wrong frame"),
        ({"voxel_size": 0.2}, "map", "invalid data"),
    ],
)
def test_updates_that_do_not_fit_are_dropped(
    graph: Any, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], frame: str, reason: str
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 0)
    bench = Bench(graph)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    (message,) = other_robot(changes.pop("version", 7), [20], **changes)
    message.header.frame_id = frame

    team.publish(message)

    bench.wait_for_drop(reason)


def test_another_robot_with_the_same_id_is_noticed(graph: Any) -> None:
    bench = Bench(graph, team_map__silence=0.5)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    later = version_at(time.time_ns() + 3600 * SECOND)
    (message,) = other_robot(later, [20], robot=0, session=1)

    def is_noticed() -> bool:
        team.publish(message)
        return "two robots with one id" in bench.node.health.drops()

    graph.spin_until(is_noticed, "the second robot")
    assert bench.node.health.drops().keys() == {"two robots with one id"}


def test_robots_that_are_not_on_the_list_are_dropped(graph: Any) -> None:
    bench = Bench(graph, team=[3, 8])
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)

    team.publish(other_robot(7, [20])[0])

    assert "robot 9" in bench.wait_for_drop("not on the team list")


def test_what_is_not_signed_with_the_team_key_is_dropped(graph: Any, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("a secret of the team\n")
    bench = Bench(graph, team_key=str(tmp_path / "key"))
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    (message,) = other_robot(7, [20])
    bench.send(pose(), cloud())
    bench.wait_for_results(1)

    team.publish(message)

    bench.wait_for_drop("not authentic")
    key = TeamKey(b"a secret of the team")
    signed = next(m for m in bench.updates if m.width)
    assert len(decode_update(key.verify(decode_rows(signed)[2])).indices)


def test_what_was_missed_is_asked_for_and_told(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconciler, "_SUMMARY_PERIOD", 0.1)
    bench = Bench(graph)
    mate = TeamMember(9, 1, 50, VoxelMapConfig(voxel_size=0.1))
    seen = expected_map(cloud())
    seen.track_changes(True)
    mate.replace(seen)
    first = mate.updates(seen, 0.0)
    publishers = [
        graph.publisher(PointCloud2, topic) for topic in ("team/map_updates", "team/digests")
    ]
    graph.connect(*publishers)
    requests = graph.collect(PointCloud2, "team/requests", qos.stream(100))

    def catches_up() -> bool:
        now = time.monotonic()
        for message in requests:
            mate.receive_request(decode_rows(message)[2], now)
        requests.clear()
        told = mate.updates(seen, now)
        for publisher, messages in zip(publishers, (told, mate.digests(now)), strict=True):
            for rows in messages:
                publisher.publish(encode_rows(TYPES, START, "map", rows))
        values = bench.node.health.values()
        return bool(values.get("known voxels") == str(seen.known_voxels))

    assert first
    graph.spin_until(catches_up, "the map of the other robot")


def test_the_own_updates_may_come_back(graph: Any) -> None:
    bench = Bench(graph)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    bench.send(pose(), cloud())
    bench.wait_for_map(as_replica(expected_map(cloud())))
    for message in bench.updates:
        team.publish(message)
    team.publish(other_robot(7, [20])[0])

    robots = "robots in the map"
    graph.spin_until(lambda: bench.node.health.values().get(robots) == "2", "both robots")
    assert bench.node.health.drops() == {}


@pytest.mark.parametrize(
    ("record", "reason", "detail"),
    [
        (pose(frame="odom"), "wrong frame", "'odom'"),
        (pose(covariance=-np.eye(6)), "malformed message", "eigenvalue"),
    ],
)
def test_wrong_data_are_dropped_by_name(graph: Any, record: Any, reason: str, detail: str) -> None:
    bench = Bench(graph)

    bench.send(record)

    assert detail in bench.wait_for_drop(reason)


def test_bad_clouds_are_dropped_and_good_ones_still_count(graph: Any) -> None:
    bench = Bench(graph)
    good = encode_point_cloud(TYPES, cloud())
    for attribute, value in (("row_step", 7), ("point_step", 3), ("fields", [])):
        bad = encode_point_cloud(TYPES, cloud())
        setattr(bad, attribute, value)
        bench.clouds.publish(bad)
    negative = cloud()
    minus = PointCloudRecord(START, FRAME, negative.points, -np.array(negative.covariances))
    bench.send(pose())
    bench.clouds.publish(encode_point_cloud(TYPES, minus))
    bench.clouds.publish(good)

    bench.wait_for_results(1)
    graph.spin_until(lambda: bench.node.health.drops().get("malformed message") == 4, "four drops")


@pytest.mark.parametrize("points", [np.full((48, 64, 3), np.nan), np.zeros((0, 3))])
def test_clouds_without_points_change_nothing(graph: Any, points: np.ndarray) -> None:
    bench = Bench(graph)
    empty = PointCloudRecord(START, FRAME, points.astype(np.float32))
    bench.send(pose(), empty)
    later = START + SECOND // 10
    bench.wait_for_results(1)

    bench.send(pose(later), cloud(later))

    bench.wait_for_results(2)
    assert bench.wait_for_updates(later)
    bench.wait_for_map(as_replica(expected_map(cloud())))


def test_a_scan_that_memory_does_not_hold_is_dropped(graph: Any) -> None:
    bench = Bench(graph, voxel_size=0.002, memory_limit=0.001)

    bench.send(pose(), cloud())

    assert bench.wait_for_drop("out of capacity")


def test_a_clock_that_jumps_back_keeps_the_map_and_goes_on(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    early = START - 100 * SECOND

    bench.send(cloud(early), pose(early - SECOND // 20), pose(early + SECOND // 20))

    bench.wait_for_results(2)
    assert bench.wait_for_updates(early)
    bench.wait_for_map(as_replica(expected_map(cloud(), cloud())))


def test_a_cloud_that_is_late_for_a_jump_still_gets_its_pose(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(), pose(START + SECOND // 20), pose(START - 100 * SECOND))

    bench.send(cloud())

    bench.wait_for_results(1)
    bench.wait_for_map(as_replica(expected_map(cloud())))
    assert bench.node.health.drops() == {}


def test_a_cloud_after_a_jump_never_gets_a_pose_from_before_it(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(START - 100 * SECOND), pose(), cloud())
    bench.wait_for_results(1)
    early = START - 100 * SECOND
    # The clouds jump first, to where an old pose would fit; then comes a pose that does not.
    bench.send(cloud(early), pose(early - SECOND), cloud(early + 2 * SECOND))
    bench.send(cloud(early + 2 * SECOND + SECOND // 10))  # a step is believed with its second

    bench.wait_for_drop("no pose at the stamp")
    assert bench.node.health.results() == 1


def test_a_clock_that_jumps_back_resets_the_map_where_that_is_wanted(graph: Any) -> None:
    bench = Bench(graph, reset_on_clock_jump=True)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    early = START - 100 * SECOND

    bench.send(pose(early), cloud(early, depth=3.0))

    bench.wait_for_results(2)
    bench.wait_for_updates(early)
    bench.wait_for_map(as_replica(expected_map(cloud(depth=3.0))))


def test_a_lone_cloud_of_another_time_resets_nothing(graph: Any) -> None:
    bench = Bench(graph, reset_on_clock_jump=True)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    stamps = [START + k * SECOND // 10 for k in range(1, 4)]
    for wrong in (START + 10**7 * SECOND, SECOND):
        bench.send(cloud(wrong))
    for stamp in stamps:
        bench.send(pose(stamp), cloud(stamp))
    bench.wait_for_results(4)
    assert bench.node.health.drops() == {"lone stamp": 2}
    bench.wait_for_map(as_replica(expected_map(cloud(), *map(cloud, stamps))))


def test_a_first_cloud_in_a_foreign_frame_does_not_decide(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(cloud(START - SECOND // 10, frame="junk"))
    stamps = [START + k * SECOND // 10 for k in range(5)]
    for stamp in stamps:
        bench.send(pose(stamp), cloud(stamp))
    bench.wait_for_results(4)
    assert bench.node.health.drops()["wrong frame"] == 1


def test_save_reset_load_bring_the_map_back(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    bench = Bench(graph, map_file=str(file))
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    saved = as_replica(expected_map(cloud()))

    assert bench.call("save").success
    assert as_replica(VoxelMap.load(file)) == saved
    assert bench.call("reset").success
    bench.wait_for_map({})
    answer = bench.call("load")
    assert answer.success, answer.message
    bench.wait_for_map(saved)


def test_a_corrupt_file_is_refused_by_name_and_the_map_stays(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    bench = Bench(graph, map_file=str(file))
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    file.write_bytes(b"no map")

    answer = bench.call("load")

    assert not answer.success
    assert "map.npz" in answer.message
    assert bench.call("save").success
    assert as_replica(VoxelMap.load(file)) == as_replica(expected_map(cloud()))


def test_saving_where_nothing_can_be_written_fails_with_a_reason(
    graph: Any, tmp_path: Path
) -> None:
    bench = Bench(graph, map_file=str(tmp_path / "nowhere" / "map.npz"))

    answer = bench.call("save")

    assert not answer.success
    assert "nowhere" in answer.message


def test_the_map_is_resumed_and_saved_again_at_the_end(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    expected_map(cloud()).save(file)
    bench = Bench(graph, map_file=str(file), resume=True, autosave_period=1000.0)
    bench.send(pose(), cloud(depth=3.0))
    bench.wait_for_results(1)

    graph.executor.remove_node(bench.node)
    graph.nodes.remove(bench.node)
    bench.node.destroy_node()

    assert as_replica(VoxelMap.load(file)) == as_replica(expected_map(cloud(), cloud(depth=3.0)))


def test_a_node_does_not_start_on_a_corrupt_map(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    file.write_bytes(b"no map")

    with pytest.raises(MapFileError, match=r"map\.npz"):
        graph.add(MapFusionNode, map_file=str(file), resume=True)


def test_a_node_does_not_start_with_an_impossible_parameter(graph: Any) -> None:
    with pytest.raises(ConfigError, match="'voxel_size'"):
        graph.add(MapFusionNode, voxel_size=-1.0)


ROBOT = f"""<robot name="arm">
  <link name="base"/>
  <link name="{FRAME}"/>
  <link name="gripper">
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
  <joint name="mount" type="fixed"><parent link="base"/><child link="{FRAME}"/></joint>
  <joint name="slide" type="prismatic"><parent link="{FRAME}"/><child link="gripper"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="3" velocity="1" effort="1"/></joint>
</robot>"""


def test_the_own_body_is_kept_out_of_the_map(graph: Any) -> None:
    bench = Bench(graph)
    descriptions = graph.tester.create_publisher(String, "robot_description", qos.latched())
    joints = graph.publisher(JointState, "joint_states")
    graph.connect(descriptions, joints)
    descriptions.publish(encode(TYPES, TextRecord(0, "", ROBOT)))
    count = f"{graph.namespace}/robot_description count"
    graph.spin_until(lambda: bench.node.health.values()[count] == "1", "the description")
    hand = cloud()
    v, u = np.mgrid[0:48, 0:64]
    on_hand = np.hypot(u - CAMERA.cx, v - CAMERA.cy) < 3.0
    points = hand.points.copy()
    points[on_hand] *= 0.95 / 2.0
    bench.send(pose(), PointCloudRecord(START, FRAME, points, hand.covariances))
    # The gripper is 1 m in front of the camera at the stamp of the cloud, not before or after.
    for offset, position in ((-SECOND // 10, 0.0), (SECOND // 10, 2.0)):
        record = JointStateRecord(START + offset, "", ("slide",), np.array([position]))
        joints.publish(encode(TYPES, record))

    bench.wait_for_results(1)
    bench.wait_for_updates(START)
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    beside = np.hypot(rays[..., 0], rays[..., 1])  # of its middle, 1 m ahead
    assert 0.0 < (beside <= 0.12).mean() - on_hand.mean() < 0.1
    points[on_hand | (beside <= 0.12)] = np.nan  # on it, or seen through it and its margin
    expected = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    camera = fit_pinhole_camera(points)  # which is that of the cloud but for rounding
    expected.integrate(points, T_MAP_CAMERA, hand.covariances, COVARIANCE, camera)
    bench.wait_for_map(as_replica(expected))


def test_without_joint_states_nothing_is_fused_and_the_reason_is_told(graph: Any) -> None:
    bench = Bench(graph, waiting__max_wait=0.5)
    descriptions = graph.tester.create_publisher(String, "robot_description", qos.latched())
    descriptions.publish(encode(TYPES, TextRecord(0, "", ROBOT)))
    count = f"{graph.namespace}/robot_description count"
    graph.spin_until(lambda: bench.node.health.values()[count] == "1", "the description")

    bench.send(pose(), cloud(), cloud(START + SECOND))

    assert "no joint state" in bench.wait_for_drop("no pose at the stamp")


def test_a_pose_without_covariance_is_not_taken_for_exact(graph: Any) -> None:
    bench = Bench(graph, default_position_sigma=0.5)
    bench.send(pose(covariance=None), cloud())
    bench.wait_for_results(1)

    def surfaces() -> list[np.ndarray]:
        rows = [decode_rows(message)[2] for message in bench.updates]
        return [r for r in rows if "mean" in (r.dtype.names or ())]

    graph.spin_until(surfaces, "surface voxels")
    covariances = decode_update(surfaces()[0]).covariances
    assert np.sqrt(np.linalg.eigvalsh(covariances)[:, 0]).min() > 0.4


def test_a_map_whose_file_is_named_is_saved_at_the_end(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "named.infomap"
    earlier = expected_map(cloud(depth=1.0))
    earlier.save(file)
    bench = Bench(graph, map_file=str(file))
    bench.send(pose(), cloud())
    bench.wait_for_results(1)

    graph.remove(bench.node)

    assert VoxelMap.load(file).known_voxels == expected_map(cloud()).known_voxels
    kept = VoxelMap.load(tmp_path / "named_previous.infomap")
    assert kept.known_voxels == earlier.known_voxels


def test_an_empty_map_takes_nothing_from_its_file(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / "named.infomap"
    expected_map(cloud()).save(file)
    before = file.read_bytes()

    graph.remove(Bench(graph, map_file=str(file)).node)

    assert file.read_bytes() == before


def test_who_comes_late_gets_the_map_as_it_is_and_none_from_before(graph: Any) -> None:
    bench = Bench(graph)
    early = graph.collect(PointCloud2, "voxel_map", qos.latched())
    bench.send(pose(), cloud())
    graph.spin_until(lambda: early, "the first picture")
    assert stamp_of(early[0]) == START, "nothing is shown of an empty map"
    graph.forget(PointCloud2, "voxel_map")
    later = START + SECOND
    bench.send(pose(later), cloud(later, 3.0))
    bench.wait_for_results(2)
    end = time.monotonic() + 2.5  # as long as a sample is kept
    graph.spin_until(lambda: time.monotonic() > end, "the end of the sample")

    late = graph.collect(PointCloud2, "voxel_map", qos.latched())

    graph.spin_until(lambda: late, "a picture")
    assert stamp_of(late[0]) == later


def test_robots_that_only_map_hear_each_other(graph: Any) -> None:
    shared = [f"team/{name}" for name in ("map_updates", "digests", "requests", "agents")]
    robots, inputs = [], []
    for number in (1, 2):
        space = f"{graph.namespace}/robot{number}"
        rules = [f"__ns:={space}", *(f"{name}:={graph.namespace}/{name}" for name in shared)]
        arguments = ["--ros-args", *(word for rule in rules for word in ("-r", rule))]
        node_class = partial(MapFusionNode, cli_args=arguments)
        robots.append(graph.add(node_class, voxel_size=0.1, robot_id=number))
        inputs.append(
            (
                graph.publisher(PointCloud2, f"{space}/points2"),
                graph.publisher(PoseWithCovarianceStamped, f"{space}/camera_pose"),
            )
        )
    for clouds, poses in inputs:
        graph.connect(clouds, poses)
        poses.publish(encode_pose(TYPES, pose()))
        clouds.publish(encode_point_cloud(TYPES, cloud()))

    def heard(node: MapFusionNode) -> str | None:
        return node.health.values().get("robots in the map")

    graph.spin_until(lambda: [heard(node) for node in robots] == ["2", "2"], "one map of both")
