"""fiducial_localization over DDS with the shipped bag: poses against its ground truth."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, Imu, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import ConfigError, MapFileError
from infomap_ros.geometry import (
    ImageRecord,
    PoseRecord,
    TransformRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.records import ImuRecord
from infomap_ros.geometry.resources import find_share
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.messages import (
    TF,
    decode_odometry,
    decode_transforms,
    encode_image,
    encode_imu,
    encode_pose,
    encode_transforms,
)
from infomap_ros.messages.motions import decode_keyframe_poses
from infomap_ros.messages.pose_uncertainty import decode_pose_uncertainty
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.locating import localization_outputs
from infomap_ros.replay.bags.reader import BagReader
from test.nodes.bag_stage import IMAGES, INFOS, MOTION, TYPES, BagStage
from test.nodes.rovers import CAMERA as ROOM_CAMERA
from test.nodes.rovers import room_scan, update_messages

SECOND = 1_000_000_000
CAMERA = "left_camera_optical_frame"


class Stage(BagStage):
    """The bag and the node."""

    def __init__(
        self, graph: Any, motion: str = "odometry", *, robot: bool = True, **parameters: Any
    ) -> None:
        super().__init__(graph, IMAGES + INFOS + (MOTION if robot else ()))
        self.node = graph.add(FiducialLocalizationNode, rectify=True, motion=motion, **parameters)
        self.connect()

    def run(self, pairs: int, first: int = 1, shift: int = 0) -> list[int]:
        """Play pairs and wait for each; stamps of those that were located."""
        stamps = []
        for stamp in self.play(pairs, first, shift):
            if self.located(stamp, self.node) is not None:
                stamps.append(stamp)
        return stamps

    def errors(self, stamps: list[int]) -> np.ndarray:
        """Motion since the first pair against the truth: position errors, shape (n,) [m]."""
        return np.array(
            [
                np.linalg.norm(
                    invert_transform(self.poses[stamps[0]].transform)[:3]
                    @ self.poses[stamp].transform[:, 3]
                    - invert_transform(self.truth[stamps[0]])[:3] @ self.truth[stamp][:, 3]
                )
                for stamp in stamps
            ]
        )

    def call(self, service: str) -> Trigger.Response:
        client = self.graph.tester.create_client(Trigger, f"fiducial_localization/{service}")
        self.graph.spin_until(client.service_is_ready, service)
        answer = client.call_async(Trigger.Request())
        self.graph.spin_until(answer.done, f"the answer of {service}")
        return answer.result()


def test_there_is_a_pose_for_every_pair_and_it_is_right(graph: Any) -> None:
    stage = Stage(graph)
    stamps = stage.run(8)
    assert len(stamps) == 8
    assert {stage.poses[s].frame_id for s in stamps} == {"map"}
    sigmas = [np.sqrt(np.trace(stage.poses[s].covariance[:3, :3])) for s in stamps]
    assert (stage.errors(stamps) < 4.0 * np.array(sigmas)).all()
    assert stage.errors(stamps).max() < 0.02
    assert max(sigmas) < 0.1


def test_the_map_is_where_odometry_begins(graph: Any) -> None:
    stage = Stage(graph)
    (stamp,) = stage.run(1)
    height = stage.poses[stamp].transform[2, 3]
    assert 0.2 < height < 1.5  # the camera stands above the level ground that the rover is on
    assert abs(stage.poses[stamp].transform[2, 0]) < 0.1  # its x axis is level


def test_images_alone_are_enough(graph: Any) -> None:
    stage = Stage(graph, motion="none", robot=False)
    stamps = stage.run(5)
    assert len(stamps) == 5
    assert stage.errors(stamps).max() < 0.02


def test_the_frame_of_odometry_is_placed_so_that_the_camera_is_at_its_pose(graph: Any) -> None:
    frames = graph.collect(message_class(TF), "/tf", qos.stream(100))
    stage = Stage(graph, transform_tolerance=0.3)
    stamps = stage.run(3)
    ahead = 300_000_000

    def edges() -> dict[int, TransformRecord]:
        return {edge.stamp: edge for message in frames for edge in decode_transforms(message)}

    graph.spin_until(lambda: {stamp + ahead for stamp in stamps} <= edges().keys(), "frames")
    for stamp in stamps:
        edge = edges()[stamp + ahead]
        assert (edge.frame_id, edge.child_frame_id) == ("map", "odom")
        posture = stage.node._inputs._motion.posture(stamp)
        found = edge.transform @ posture.T_odom_camera
        assert np.allclose(found, stage.poses[stamp].transform, atol=1e-9)


def test_the_map_is_put_where_a_user_says_that_the_base_is(graph: Any) -> None:
    stage = Stage(graph)
    bases = graph.collect(Odometry, "base_odometry", qos.stream(50))
    told = graph.publisher(PoseWithCovarianceStamped, "initialpose")
    graph.connect(told)
    stage.run(3)
    graph.spin_until(lambda: len(bases) >= 2, "base_odometry")
    before = decode_odometry(bases[-1])
    assert (before.frame_id, before.child_frame_id) == ("map", "base_link")
    plane = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07])
    pointed = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (5.0, 6.0, 0.0))
    told.publish(encode_pose(TYPES, PoseRecord(0, "map", pointed, plane)))
    graph.spin_until(lambda: "last move" in stage.node.health.values(), "the move")
    stage.run(2, first=4)

    def moved() -> list[Any]:  # with what it has driven since
        told = [decode_odometry(base) for base in bases]
        return [base for base in told if np.hypot(*(base.transform[:2, 3] - (5.0, 6.0))) < 0.3]

    graph.spin_until(moved, "base_odometry at the place")
    after = moved()[0]
    assert abs(after.transform[2, 3] - before.transform[2, 3]) < 0.05
    assert max(np.diag(after.covariance)[:3]) < 0.01


def test_without_odometry_the_camera_itself_is_placed(graph: Any) -> None:
    frames = graph.collect(message_class(TF), "/tf", qos.stream(100))
    stage = Stage(graph, motion="none", robot=False)
    stamps = [*stage.run(3)]
    end = time.monotonic() + 1.0  # for others who may place the camera
    graph.spin_until(lambda: time.monotonic() > end, "their frames")
    stamps += stage.run(2, first=4)
    graph.spin_until(lambda: frames, "a frame")
    (edge,) = decode_transforms(frames[0])
    assert edge.stamp in stamps
    assert (edge.frame_id, edge.child_frame_id) == ("map", CAMERA)


def test_keyframes_and_fiducials_are_told(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(localization_outputs, "_FIDUCIALS_PERIOD", 0.0)
    keyframes = graph.collect(Path, "keyframe_poses", qos.stream())
    clouds = graph.collect(PointCloud2, "fiducials", qos.latched())
    markers = graph.collect(MarkerArray, "fiducial_markers", qos.latched())
    stage = Stage(graph)
    stamps = stage.run(4)
    graph.spin_until(lambda: len(clouds) >= 3 and markers and keyframes, "fiducials")
    heard = decode_keyframe_poses(keyframes[-1])
    assert heard.frame_id == "map"
    assert set(heard.stamps.tolist()) <= set(stamps)
    first = heard.stamps.tolist().index(stamps[0])
    assert np.allclose(heard.transforms[first], stage.poses[stamps[0]].transform, atol=0.05)
    stamp, frame, rows = decode_rows(clouds[-1])
    assert stamp in stamps and frame == "map"
    assert len(rows) > 20 and len(markers[-1].markers[0].points) > 20
    assert (rows["sigma"] > 0.0).all()
    place = stage.poses[stamp].transform[:3, 3]
    distances = np.linalg.norm(np.stack([rows["x"], rows["y"], rows["z"]], -1) - place, axis=1)
    assert np.median(distances) < 10.0


def test_the_parts_of_a_covariance_come_with_its_pose(graph: Any) -> None:
    messages = graph.collect(PointCloud2, "camera_pose_uncertainty", qos.stream(50))
    stage = Stage(graph)
    stamps = stage.run(4)
    graph.spin_until(lambda: len(messages) >= 2, "uncertainties")
    clocks = []
    for stamp, frame, parts in map(decode_pose_uncertainty, messages):
        assert stamp in stamps and frame == "map"
        np.testing.assert_allclose(parts.covariance, stage.poses[stamp].covariance, atol=1e-12)
        clocks.append(parts.clock)
    assert clocks == sorted(clocks)


def test_odometry_is_used_where_it_is_offered(graph: Any) -> None:
    stage = Stage(graph, motion="auto")
    (stamp,) = stage.run(1)
    posture = stage.node._inputs._motion.posture(stamp)
    assert np.allclose(stage.poses[stamp].transform, posture.T_odom_camera, atol=1e-9)


@pytest.mark.parametrize("robot", [False, True])
def test_without_useful_odometry_the_map_begins_level_at_the_camera(
    graph: Any, robot: bool
) -> None:
    settings = {"camera_frame": "camera_of_nobody"} if robot else {}
    stage = Stage(graph, motion="auto", robot=robot, **settings)
    (stamp,) = stage.run(1)
    expected = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
    assert np.allclose(stage.poses[stamp].transform, expected, atol=1e-9)


def test_an_inertial_sensor_says_what_is_level(graph: Any) -> None:
    stage = Stage(graph, motion="auto", robot=False)
    tilted = Rotation.from_euler("xyz", [0.3, 0.0, 0.2]).as_matrix()  # R_imu_camera
    samples = graph.publisher(Imu, "imu", 1000)
    tf_static = graph.tester.create_publisher(message_class(TF), "/tf_static", qos.latched())
    graph.connect(samples, tf_static)
    edge = TransformRecord(0, "imu", CAMERA, make_transform(tilted, np.zeros(3)), True)
    tf_static.publish(encode_transforms(TYPES, [edge]))
    up = np.array([0.1, -0.95, -0.3]) / np.linalg.norm([0.1, -0.95, -0.3])  # in the camera
    with BagReader(find_share("bags/rover_rocks")) as bag:
        first = next(iter(bag.records(IMAGES[:1]))).record.stamp
    for number in range(-20, 21):
        force = 9.81 * tilted @ up
        sample = ImuRecord(first + number * SECOND // 20, "imu", np.zeros(3), force)
        samples.publish(encode_imu(TYPES, sample))
    stage.node._inputs._inertial.look_from(CAMERA)
    graph.spin_until(lambda: stage.node._inputs._inertial._stamps[-1:] > [first], "the samples")
    (stamp,) = stage.run(1, first=0)
    found = stage.poses[stamp].transform[:3, :3]
    np.testing.assert_allclose(found @ up, [0.0, 0.0, 1.0], atol=1e-6)
    assert found[0, 2] > 0.9 and abs(found[1, 2]) < 1e-6  # ahead is along x


def test_without_odometry_nothing_begins_where_it_is_wanted(graph: Any) -> None:
    stage = Stage(graph, robot=False)
    for _ in stage.play(4):  # over more time than a view waits
        pass
    reason = "no odometry or joints at the stamp"
    graph.spin_until(lambda: reason in stage.node.health.drops(), "the drop")
    assert not stage.poses


def test_a_camera_that_sees_nothing_is_lost_and_says_so(graph: Any) -> None:
    stage = Stage(graph, motion="none", robot=False, max_coasting=0.4)
    stamps = stage.run(2)
    publishers = [graph.publisher(Image, topic.lstrip("/")) for topic in IMAGES]
    graph.connect(*publishers)
    values, black = stage.node.health.values, np.zeros((384, 512), np.uint8)
    for step in range(1, 5):
        stamp = stamps[-1] + step * SECOND // 5
        for publisher, side in zip(publishers, ("left", "right"), strict=True):
            dark = ImageRecord(stamp, f"{side}_camera_optical_frame", black, "mono8")
            publisher.publish(encode_image(TYPES, dark))
        graph.spin_until(lambda at=stamp: values().get("stamp") == str(at), "the dark pair")
    assert values()["state"] == "lost"
    assert any("lost" in text for text in stage.node.health.complaints())
    assert max(stage.poses) < stamp
    assert values()["reason"]


def test_reset_begins_anew(graph: Any) -> None:
    stage = Stage(graph)
    stage.run(4)
    assert stage.call("reset").success
    (stamp,) = stage.run(1, first=8)
    posture = stage.node._inputs._motion.posture(stamp)
    assert np.allclose(stage.poses[stamp].transform, posture.T_odom_camera, atol=1e-9)


def test_when_the_clock_jumps_back_the_map_begins_anew(graph: Any) -> None:
    stage = Stage(graph)
    before = stage.run(3, shift=1000 * SECOND)
    after = stage.run(3)
    assert len(before) == len(after) == 3
    assert stage.errors(after).max() < 0.02
    first = stage.poses[before[0]].transform, stage.poses[after[0]].transform
    assert np.allclose(*first, atol=1e-3)


def restarted(graph: Any, stage: Stage, **parameters: Any) -> Stage:
    """The same stage with a new node in place of the first."""
    graph.executor.remove_node(stage.node)
    stage.node.destroy_node()
    graph.nodes.remove(stage.node)
    stage.node = graph.add(FiducialLocalizationNode, rectify=True, **parameters)
    stage.connect()
    return stage


def test_a_restarted_node_goes_on_in_the_same_map(graph: Any, tmp_path: Any) -> None:
    settings = {"motion": "odometry", "state_file": str(tmp_path / "state"), "resume": True}
    stage = Stage(graph, **settings)
    before = stage.run(5)
    restarted(graph, stage, **settings)
    after = stage.run(3, first=6)
    assert len(after) == 3
    assert stage.errors(before + after).max() < 0.03


def test_without_odometry_a_restarted_node_finds_the_place_again(graph: Any, tmp_path: Any) -> None:
    settings = {"motion": "none", "state_file": str(tmp_path / "state"), "resume": True}
    stage = Stage(graph, robot=False, **settings)
    before = stage.run(4)
    restarted(graph, stage, **settings)
    after = stage.run(4, shift=60 * SECOND)
    assert after
    assert stage.errors(before[:1] + after).max() < 0.03


def test_a_node_that_is_killed_has_saved_what_it_knew(graph: Any, tmp_path: Any) -> None:
    path = tmp_path / "state"
    stage = Stage(graph, state_file=str(path), save_period=0.1)
    stage.run(2)
    graph.spin_until(path.exists, "the file")
    saved = SavedLocalization.load(path)
    assert saved.posture is not None
    assert saved.stamp in stage.poses


def test_a_clock_that_jumps_back_keeps_the_map_where_it_is_to_be_resumed(
    graph: Any, tmp_path: Any
) -> None:
    stage = Stage(graph, state_file=str(tmp_path / "state"), resume=True)
    before = stage.run(4, shift=1000 * SECOND)
    after = stage.run(4)
    assert after  # found again by the looks of the place
    twins = [stamp + 1000 * SECOND for stamp in after]
    for stamp, twin in zip(after, twins, strict=True):
        if twin in before:
            gap = stage.poses[stamp].transform[:3, 3] - stage.poses[twin].transform[:3, 3]
            assert np.linalg.norm(gap) < 0.03


def test_a_node_does_not_start_on_a_file_of_another_kind(graph: Any, tmp_path: Any) -> None:
    path = tmp_path / "map"
    VoxelMap().save(path)
    with pytest.raises(MapFileError, match="no localization"):
        graph.add(FiducialLocalizationNode, state_file=str(path), resume=True)


def test_a_node_does_not_start_with_an_impossible_parameter(graph: Any) -> None:
    with pytest.raises(ConfigError, match="motion"):
        graph.add(FiducialLocalizationNode, motion="wishes")
    with pytest.raises(ConfigError, match="fewest_fiducials"):
        graph.add(FiducialLocalizationNode, fewest_fiducials=300, wanted_fiducials=100)


@pytest.mark.parametrize("use_map", [True, False])
def test_fiducials_are_chosen_in_the_shared_map_where_it_is_wanted(
    graph: Any, use_map: bool
) -> None:
    stage = Stage(graph, use_map=use_map)
    locate, given = stage.node._localizer.locate, []

    def recorded(*arguments: Any) -> Any:
        given.append(arguments[4])
        return locate(*arguments)

    stage.node._localizer.locate = recorded
    assert len(stage.run(1)) == 1
    assert given == [None]

    told = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    told.track_changes(True)
    told.integrate(room_scan(np.eye(4)), np.eye(4), camera=ROOM_CAMERA)
    updates = graph.publisher(PointCloud2, "map_updates", 200)
    if use_map:
        graph.connect(updates)
        for message in update_messages(told):
            updates.publish(message)
        listener = stage.node._map
        graph.spin_until(
            lambda: (
                (known := listener.known_map()) is not None
                and known.known_voxels == told.known_voxels
            ),
            "the map",
        )
    assert len(stage.run(1, first=2)) == 1
    assert given[1] is (stage.node._map.known_map() if use_map else None)
