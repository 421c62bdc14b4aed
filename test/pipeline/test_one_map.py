"""One bag gives one map, to the bit: in Python, by the command, and through the live nodes."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from std_srvs.srv import Trigger
from typer.testing import CliRunner

from infomap_ros.cli.app import app
from infomap_ros.geometry import ImageRecord
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.nodes.bag_player import BagPlayerNode
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.stereo_range import StereoRangeNode
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.perception import ImageSources, Perception, StereoViewEstimator
from infomap_ros.pipeline.pipeline import Fused, Fusion, Pipeline
from infomap_ros.pipeline.range_estimator import StereoRangeEstimator
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses, ScanSynchronizer
from infomap_ros.replay.bags import player
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.writer import BagWriter
from infomap_ros.replay.localize_run import (
    LocalizeOptions,
    find_localize_inputs,
    make_localization,
    records_of,
)
from infomap_ros.replay.map_inputs import CameraPoses
from infomap_ros.stereo import StereoConfig

from .map_hash import map_hash

PAIRS = 6
VOXEL = 0.1
SIDES = ("left", "right")
SOURCES = ImageSources(
    tuple(f"/{side}/image_raw" for side in SIDES), tuple(f"/{side}/camera_info" for side in SIDES)
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The beginning of the shipped bag, without its truth."""
    path, pairs = tmp_path_factory.mktemp("bags") / "short", 0
    with BagReader(find_share("bags/rover_rocks")) as reader, BagWriter(path) as writer:
        topics = [name for name in reader.topics if "truth" not in name and "tf" not in name]
        for entry in reader.records(topics):
            pairs += isinstance(entry.record, ImageRecord) and entry.topic == SOURCES.images[0]
            if pairs > PAIRS:
                break
            writer.write(entry.topic, entry.record, entry.received)
    return path


def by_python(path: Path, *, localizes: bool) -> str:
    """The map of a for loop over the bag's records."""
    with BagReader(path) as reader:
        robot = next(reader.records(["/robot_description"])).record
        body = RobotBody(LocalizeOptions().description.read(robot.text))
        builder = MapBuilder(
            VoxelMap(VoxelMapConfig(voxel_size=VOXEL)), ScanStoreConfig() if localizes else None
        )
        localization, estimator = None, StereoRangeEstimator(StereoConfig(), rectify=True)
        poses: Any = CameraPoses("left_camera_optical_frame")
        if localizes:
            options = LocalizeOptions()
            inputs = find_localize_inputs(reader, options)
            localization = make_localization(inputs, options, Counter(), Counter())
            estimator = StereoViewEstimator(StereoConfig(), rectify=True, is_dense=True)
            poses = LocatedPoses("map")
        pipeline = Pipeline(localization, Fusion(ScanSynchronizer(poses, body), body, builder))
        told = "/odom" if localizes else "/camera_pose"
        records, fused = records_of(reader, (*SOURCES.names, "/joint_states", told)), 0
        for seen in Perception(SOURCES, estimator).see(records):
            fused += sum(isinstance(done, Fused) for done in pipeline.process(seen))
        fused += sum(isinstance(done, Fused) for done in pipeline.finish())
    assert fused == PAIRS
    return map_hash(builder.map)


def by_command(path: Path, out: Path, *, localizes: bool) -> str:
    """The map of ``infomap map``."""
    poses = "localize" if localizes else "bag"
    arguments = ["map", str(path), "--out", str(out), "--voxel-size", str(VOXEL), "--poses", poses]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert json.loads((out / "summary.json").read_text())["frames"] == PAIRS
    return map_hash(VoxelMap.load(out / "map.infomap"))


def by_nodes(path: Path, graph: Any, out: Path, *, localizes: bool) -> str:
    """The map of map_fusion, of what bag_player plays in lockstep."""
    graph.add(StereoRangeNode, rectify=True)
    names = ["points2", "camera_pose"]
    if localizes:
        graph.add(FiducialLocalizationNode, rectify=True, motion="odometry")
        names += ["keyframe_poses", "keyframe_covariances"]
    file = out / "live.infomap"
    fusion = graph.add(MapFusionNode, voxel_size=VOXEL, map_file=str(file))
    topics = [graph.tester.resolve_topic_name(name) for name in names]
    made = topics if localizes else topics[:1]
    graph.spin_until(lambda: all(graph.tester.count_publishers(name) for name in made), "topics")
    graph.spin_until(lambda: all(graph.tester.count_subscribers(name) for name in topics), "fusion")
    images = ["left/image_raw", "right/image_raw", "left/camera_info", "right/camera_info"]
    player = graph.add(
        BagPlayerNode,
        bag=str(path),
        left_out=["/camera_pose"] if localizes else [""],
        acknowledged=True,
        window=1,
        wait_for_subscribers=[*images, *(images if localizes else []), "joint_states"],
    )
    graph.spin_until(player.finished.done, "the end of the bag", 240.0)
    graph.spin_until(lambda: fusion.health.results() == PAIRS, "all scans")
    client = graph.tester.create_client(Trigger, "map_fusion/save")
    graph.spin_until(client.service_is_ready, "save")
    answer = client.call_async(Trigger.Request())
    graph.spin_until(answer.done, "the file")
    return map_hash(VoxelMap.load(file))


@pytest.mark.parametrize("localizes", [False, True], ids=["poses of the bag", "located"])
def test_one_bag_gives_one_map(
    bag: Path, graph: Any, tmp_path: Path, localizes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(player, "_ACKNOWLEDGE_TIMEOUT", 60.0)
    first = by_python(bag, localizes=localizes)

    assert by_command(bag, tmp_path / "command", localizes=localizes) == first
    assert by_nodes(bag, graph, tmp_path, localizes=localizes) == first


def test_the_hash_tells_maps_apart() -> None:
    scan = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]])
    maps = [VoxelMap(VoxelMapConfig(voxel_size=VOXEL)) for _ in range(3)]
    for points, one in zip((scan, scan, scan + 1e-6), maps, strict=True):
        one.integrate(points, np.eye(4), pose_covariance=1e-4 * np.eye(6))
    assert map_hash(maps[0]) == map_hash(maps[1]) != map_hash(maps[2])
