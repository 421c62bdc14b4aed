"""map_fusion hears of corrected poses: its map and everybody's follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import PoseRecord, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.messages import encode_pose
from infomap_ros.messages.motions import (
    KeyframePoses,
    decode_keyframe_covariances,
    decode_keyframe_poses,
    encode_keyframe_covariances,
    encode_keyframe_poses,
)
from infomap_ros.messages.rows import encode_rows
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.team.replica import moved_map
from test.nodes.test_map_fusion import (
    CAMERA,
    COVARIANCE,
    SECOND,
    START,
    T_MAP_CAMERA,
    TYPES,
    Bench,
    as_replica,
    cloud,
    pose,
)

ELSEWHERE = T_MAP_CAMERA.copy()
ELSEWHERE[0, 3] += 0.5


def keyframes(stamp: int, *transforms: np.ndarray, frame: str = "map") -> KeyframePoses:
    stamps = START + SECOND * np.arange(len(transforms))
    return KeyframePoses(stamp, frame, stamps, np.array(transforms))


class CorrectedBench(Bench):
    def __init__(self, graph: Any, **parameters: Any) -> None:
        super().__init__(graph, **parameters)
        self.keyframes = graph.publisher(Path, "keyframe_poses")
        graph.connect(self.keyframes)

    def tell(self, record: KeyframePoses) -> None:
        self.keyframes.publish(encode_keyframe_poses(TYPES, record))

    def wait_for_correction(self) -> None:
        name = "corrections of the map"
        self.graph.spin_until(lambda: name in self.node.health.values(), "the correction")


def map_of(*poses: np.ndarray) -> VoxelMap:
    expected = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    for transform in poses:
        scan = cloud()
        expected.integrate(scan.points, transform, scan.covariances, COVARIANCE, CAMERA)
    return expected


def test_keyframe_poses_survive_the_message() -> None:
    record = keyframes(START + 7, T_MAP_CAMERA, ELSEWHERE)
    read = decode_keyframe_poses(encode_keyframe_poses(TYPES, record))
    assert (read.stamp, read.frame_id) == (START + 7, "map")
    assert np.array_equal(read.stamps, record.stamps)
    assert np.allclose(read.transforms, record.transforms)


def test_covariances_of_keyframes_survive_the_message() -> None:
    covariances = np.stack([COVARIANCE, 4.0 * COVARIANCE])
    record = keyframes(START + 7, T_MAP_CAMERA, ELSEWHERE)
    record = replace(record, covariances=covariances, origin=0xFFFFFFFE)
    stamp, origin, stamps, read = decode_keyframe_covariances(
        encode_keyframe_covariances(TYPES, record)
    )
    assert (stamp, origin) == (START + 7, 0xFFFFFFFE)
    assert np.array_equal(stamps, record.stamps)
    assert np.array_equal(read, covariances)
    with pytest.raises(MalformedMessageError, match="covariances of keyframes"):
        decode_keyframe_covariances(encode_rows(TYPES, 1, "map", np.zeros(2, [("x", "<f4")])))


def test_a_corrected_map_is_as_sure_as_its_keyframes(graph: Any) -> None:
    bench = CorrectedBench(graph)
    publisher = graph.publisher(PointCloud2, "keyframe_covariances")
    graph.connect(publisher)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    topic = bench.node.resolve_topic_name("keyframe_covariances")
    heard = bench.node.health._streams[topic]
    for stamp, place, factor in ((1, T_MAP_CAMERA, 1.0), (2, ELSEWHERE, 9.0)):
        record = keyframes(START + stamp * SECOND, place)
        known = replace(record, covariances=factor * COVARIANCE[None])
        publisher.publish(encode_keyframe_covariances(TYPES, known))
        graph.spin_until(lambda n=stamp: heard.count == n, "covariances")
        bench.tell(record)
    bench.wait_for_correction()
    (scan,) = bench.node._keeper._builder.scans
    assert np.allclose(scan.uncertainty.covariance, 9.0 * COVARIANCE, rtol=1e-6, atol=1e-12)


def test_what_is_in_a_map_is_moved_by_hand(graph: Any) -> None:
    bench = CorrectedBench(graph)
    publisher = graph.publisher(PoseWithCovarianceStamped, "map_fusion/move")
    graph.connect(publisher)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    shift = make_transform(np.eye(3), (0.5, 0.0, -0.2))
    publisher.publish(encode_pose(TYPES, PoseRecord(0, "map", shift, COVARIANCE)))
    bench.wait_for_map(as_replica(moved_map(map_of(T_MAP_CAMERA), shift)))


def test_scans_follow_and_listeners_forget_the_ghost(graph: Any) -> None:
    bench = CorrectedBench(graph)
    bench.send(pose(), pose(START + SECOND), cloud(), cloud(START + SECOND))
    bench.wait_for_results(2)
    bench.tell(keyframes(START + SECOND, T_MAP_CAMERA, T_MAP_CAMERA))
    bench.tell(keyframes(START + 2 * SECOND, ELSEWHERE, T_MAP_CAMERA))
    bench.wait_for_map(as_replica(map_of(ELSEWHERE, T_MAP_CAMERA)))
    bench.wait_for_correction()


def test_a_scan_that_comes_after_the_correction_stays(graph: Any) -> None:
    bench = CorrectedBench(graph)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    bench.tell(keyframes(START, T_MAP_CAMERA))
    bench.tell(keyframes(START + SECOND, ELSEWHERE))
    bench.wait_for_correction()
    bench.send(pose(START + 2 * SECOND), cloud(START + 2 * SECOND))
    bench.wait_for_results(2)
    bench.wait_for_map(as_replica(map_of(ELSEWHERE, T_MAP_CAMERA)))


def saved_while_correcting(graph: Any, file: Any) -> CorrectedBench:
    """A node that has saved its map on the way, with a correction not yet made."""
    bench = CorrectedBench(graph, map_file=str(file), autosave_period=0.3)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    bench.tell(keyframes(START, T_MAP_CAMERA))
    bench.tell(keyframes(START + SECOND, ELSEWHERE))
    graph.spin_until(file.is_file, "the map")
    return bench


def test_the_map_is_saved_meanwhile_as_it_is_however_long_a_correction_takes(
    graph: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("infomap_ros.pipeline.map_builder.MapBuilder.correct_more", lambda _: None)
    file = tmp_path / "map.infomap"
    bench = saved_while_correcting(graph, file)
    bench.send(pose(START + 2 * SECOND), cloud(START + 2 * SECOND))
    bench.wait_for_results(2)


def test_what_was_saved_on_the_way_is_saved_again_with_the_correction_at_the_end(
    graph: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, may_correct, correct_more = tmp_path / "map.infomap", [], MapBuilder.correct_more
    monkeypatch.setattr(
        MapBuilder, "correct_more", lambda self: correct_more(self) if may_correct else None
    )
    bench = saved_while_correcting(graph, file)
    stop = bench.node._worker.stop
    monkeypatch.setattr(bench.node._worker, "stop", lambda: may_correct.append(stop()))

    graph.executor.remove_node(bench.node)
    graph.nodes.remove(bench.node)
    bench.node.destroy_node()

    assert as_replica(VoxelMap.load(file)) == as_replica(map_of(ELSEWHERE))


def test_poses_in_another_frame_are_refused(graph: Any) -> None:
    bench = CorrectedBench(graph)
    bench.tell(keyframes(START, T_MAP_CAMERA, frame="odom"))
    assert "odom" in bench.wait_for_drop("wrong frame")


def test_a_node_that_keeps_no_scans_says_so_by_their_number(graph: Any) -> None:
    bench = CorrectedBench(graph, scans__memory=0.0)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    graph.spin_until(lambda: bench.node.health.values().get("scans kept") == "0", "the number")


def test_scans_are_kept_from_when_somebody_may_correct_them(graph: Any) -> None:
    bench = Bench(graph)
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    graph.connect(publisher := graph.publisher(Path, "keyframe_poses"))
    bench.send(pose(START + SECOND), cloud(START + SECOND))
    bench.wait_for_results(2)
    for stamp, place in ((1, T_MAP_CAMERA), (2, ELSEWHERE)):
        record = keyframes(START + stamp * SECOND, place, place)
        publisher.publish(encode_keyframe_poses(TYPES, record))
    bench.wait_for_map(as_replica(map_of(T_MAP_CAMERA, ELSEWHERE)))
    assert len(bench.node._keeper._builder.scans) == 1


@pytest.mark.parametrize("order", ["reset", "load"])
def test_scans_of_a_map_that_was_given_up_move_nothing(
    graph: Any, order: str, tmp_path: Any
) -> None:
    bench = CorrectedBench(graph, map_file=str(tmp_path / "map.infomap"))
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    bench.tell(keyframes(START, T_MAP_CAMERA))
    assert bench.call("save").success
    assert bench.call(order).success
    bench.tell(keyframes(START + SECOND, ELSEWHERE))
    bench.send(pose(START + 2 * SECOND), cloud(START + 2 * SECOND))
    bench.wait_for_results(2)
    expected = map_of(T_MAP_CAMERA) if order == "reset" else map_of(T_MAP_CAMERA, T_MAP_CAMERA)
    bench.wait_for_map(as_replica(expected))
