"""next_best_view across DDS: what it answers, publishes, refuses and learns."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetMap
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.exploration.records.choice_text import choice_from_text, route_digest
from infomap_ros.exploration.robot import Choice
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner import ViewPlannerConfig
from infomap_ros.geometry import CameraInfoRecord, StereoRig, transform_points
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.localization.prediction.error_prediction import ErrorPrediction, Paths
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.octomap_file import binary_tree, full_tree
from infomap_ros.messages import encode_camera_info
from infomap_ros.messages.encode import OCTOMAP, encode_octomap
from infomap_ros.messages.fiducials import encode_fiducials
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.next_best_view import NextBestViewNode, PlannedCameraConfig
from infomap_ros.nodes.team import map_listener
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig

from .rovers import (
    BASELINE,
    CAMERA,
    FRAMES,
    TYPES,
    PaperRover,
    calibration,
    room_scan,
    update_messages,
)

QUICK = {
    "choice__candidates__candidates": 200,
    "arm_views": 50,
    "reaching__postures": 3000,
    "choice__selection__refined": 10,
    "reaching__collision__tolerance": 0.03,
    "threads": 1,
}
OUTPUTS = {
    "next_view": PoseStamped,
    "next_best_view/base_path": Path,
    "next_best_view/arm_trajectory": JointTrajectory,
    "view_candidates": MarkerArray,
}


@pytest.fixture(autouse=True)
def _no_arrival_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_listener, "_ARRIVAL_PAUSE", 0.0)


class Stage:
    """The node, a rover on paper, and what the node says."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph = graph
        self.rover = PaperRover(graph, tells_updates=False)
        self.team = graph.publisher(PointCloud2, "team/map_updates", 200)
        latched, create = qos.latched(), graph.tester.create_publisher
        self.interest = create(MarkerArray, "interest", latched)
        self.status = create(DiagnosticStatus, "exploration_status", latched)
        self.fiducials = create(PointCloud2, "fiducials", latched)
        self.said = {name: graph.collect(kind, name) for name, kind in OUTPUTS.items()}
        self.node = graph.add(NextBestViewNode, **{**QUICK, **parameters})
        publishers = [self.interest, self.status, self.fiducials]
        if parameters.get("map_source") == "octomap":
            self.octrees = create(message_class(OCTOMAP), "octomap_full", latched)
            publishers += [self.octrees]
        else:
            publishers += [self.rover.updates, self.team]
        infos = () if parameters.get("source") == "depth" else self.rover.infos.values()
        graph.connect(*publishers, *infos)

    def call(self, name: str = "plan") -> Trigger.Response:
        client = self.graph.tester.create_client(Trigger, f"next_best_view/{name}")
        self.graph.spin_until(client.service_is_ready, name)
        future = client.call_async(Trigger.Request())
        self.graph.spin_until(future.done, name)
        return future.result()

    def plan(self) -> Choice:
        answers = [self.call()]

        def answered() -> bool:
            if not answers[-1].success:
                answers.append(self.call())
            return bool(answers[-1].success)

        self.graph.spin_until(answered, "a plan")
        return choice_from_text(answers[-1].message)

    def tell(self, publisher: Any, *pans: float, **labels: Any) -> None:
        """Have a robot tell what the rover sees in these directions; waits until it is heard."""
        results = self.node.health.results()
        messages = update_messages(self.rover.looks(*pans), **labels)
        for message in messages:
            publisher.publish(message)
        wanted = results + len(messages)
        self.graph.spin_until(lambda: self.node.health.results() >= wanted, "updates")

    def send(self, octree: Any) -> None:
        """Publish an octree that can be used; waits until it is there."""
        results = self.node.health.results()
        self.octrees.publish(octree)
        self.graph.spin_until(lambda: self.node.health.results() > results, "the octree")

    def wait_for_drops(self, reason: str, count: int) -> None:
        drops = self.node.health.drops
        self.graph.spin_until(lambda: drops().get(reason, 0) >= count, f"{count} x {reason}")


@pytest.fixture
def stage(graph: Any) -> Stage:
    return Stage(graph)


def status(**values: object) -> DiagnosticStatus:
    given = {"views": 1, "home base": [], "home joints": {}, "failures": 0}
    given |= {"last look base": [], "last look joints": {}}
    content = given | {name.replace("_", " "): value for name, value in values.items()}
    pairs = {k: v if isinstance(v, str) else json.dumps(v) for k, v in content.items()}
    return DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in pairs.items()])


def places_of_interest(stage: Stage) -> list[float]:
    return [each.place.transform[1, 3] for each in stage.node._interests.current()]


def test_a_plan_is_answered_and_published_but_moves_nothing(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    before = stage.rover.T_map_camera()

    choice = stage.plan()

    assert choice.pose is not None
    assert choice.route is not None
    assert 0.0 < choice.progress.known_fraction < 1.0
    stage.graph.spin_until(lambda: all(stage.said.values()), "all outputs")
    view, path, arm, markers = (messages[-1] for messages in stage.said.values())
    stamps = [each.header.stamp for each in (view, path, arm, *markers.markers[1:])]
    assert stamps == [view.header.stamp] * len(stamps)
    assert view.header.stamp.sec > 0
    frames = {each.header.frame_id for each in (view, path, *markers.markers[1:])}
    assert frames == {"map"}
    position = view.pose.position
    np.testing.assert_allclose((position.x, position.y, position.z), choice.pose[:3, 3])
    assert len(path.poses) == len(choice.route.base_path)
    np.testing.assert_allclose(
        arm.points[-1].positions, choice.route.arm_after.positions[-1], atol=1e-9
    )
    assert stage.rover.paths == []
    assert stage.rover.trajectories == []
    np.testing.assert_array_equal(stage.rover.T_map_camera(), before)


def test_candidates_show_their_terms_and_their_rejections(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    choice = stage.plan()
    stage.graph.spin_until(lambda: stage.said["view_candidates"], "candidates")
    markers = stage.said["view_candidates"][-1].markers
    assert markers[0].action == Marker.DELETEALL
    kinds = {kind: [m for m in markers if m.ns == kind] for kind in ("candidates", "rejected")}
    assert all("information" in marker.text for marker in kinds["candidates"])
    assert all(marker.text for marker in kinds["rejected"])
    listed = len(kinds["candidates"]) + len(kinds["rejected"])
    assert listed == len(choice.explanation["candidates"])
    assert [marker.id for marker in markers if marker.ns == "chosen"] == [0]


def test_a_strategy_that_is_set_counts_for_the_next_plan(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    assert stage.plan().reason.startswith("largest_information")
    (result,) = stage.node.set_parameters([Parameter("strategy", value="raster")])
    assert result.successful
    assert stage.plan().reason.startswith("raster")


def test_where_the_robot_can_stand_is_published_and_given_by_service(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    stage.plan()
    grids = stage.graph.collect(OccupancyGrid, "traversability_map", qos.latched())
    stage.graph.spin_until(lambda: grids, "the grid")
    client = stage.graph.tester.create_client(GetMap, "traversability_map")
    stage.graph.spin_until(client.service_is_ready, "the service")
    answer = client.call_async(GetMap.Request())
    stage.graph.spin_until(answer.done, "the answer")
    given = answer.result().map
    assert given.header.frame_id == grids[0].header.frame_id == "map"
    assert (given.info.width, given.data) == (grids[0].info.width, grids[0].data)
    cells = np.array(given.data).reshape(given.info.height, given.info.width)
    corner = given.info.origin.position
    base = stage.rover.base[:2, 3]
    column, row = ((base - (corner.x, corner.y)) / given.info.resolution).astype(int)
    assert cells[row, column] == 0  # where it stands
    assert (cells == -1).any()


def test_a_depth_camera_is_planned_for_by_its_own_info(graph: Any) -> None:
    stage = Stage(graph, source="depth", depth_noise=0.002)
    info = graph.publisher(CameraInfo, "depth/camera_info")
    graph.connect(info)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    assert not stage.call().success
    info.publish(
        encode_camera_info(TYPES, CameraInfoRecord(0, FRAMES["left"], calibration("left")))
    )
    assert stage.plan().pose is not None
    stage.rover.is_located = False  # tells its odometry

    def searched() -> bool:
        return bool(stage.call("plan_search").success)

    graph.spin_until(searched, "a look for the target")


def test_a_depth_camera_is_as_noisy_as_is_said() -> None:
    rig = PlannedCameraConfig("depth", depth_noise=0.002).rig((calibration("left"),))
    assert rig.left == CAMERA
    assert InformationConfig.of_stereo(rig).range_noise == pytest.approx(0.002)


def test_what_is_missing_is_said(graph: Any) -> None:
    stage = Stage(graph)
    for name in ("plan", "plan_home", "plan_back"):
        answer = stage.call(name)
        assert (answer.success, answer.message) == (False, "no map_updates have arrived yet")
    stage.tell(stage.rover.updates, 0.0)
    stage.plan()
    assert "has not said where home is" in stage.call("plan_home").message
    assert "has not said where last look is" in stage.call("plan_back").message


def test_a_map_that_still_arrives_is_waited_for(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_listener, "_ARRIVAL_PAUSE", 60.0)
    stage = Stage(graph)
    stage.tell(stage.rover.updates, 0.0)
    answer = stage.call()
    assert not answer.success
    assert "still arriving" in answer.message


def test_what_another_robot_saw_counts(stage: Stage) -> None:
    stage.tell(stage.rover.updates, 0.0)
    alone = stage.plan().progress
    stage.tell(stage.team, -0.8, 0.8, robot=7)
    together = stage.plan().progress
    assert together.known_voxels > alone.known_voxels
    assert together.known_fraction > alone.known_fraction


def test_updates_that_cannot_be_used_are_counted(stage: Stage) -> None:
    stage.tell(stage.rover.updates, 0.0)
    known = stage.plan().progress.known_voxels
    (message, *_) = update_messages(stage.rover.looks(0.8), robot=3)
    broken = PointCloud2(header=message.header, height=1, width=5, point_step=27, row_step=1)
    stage.team.publish(broken)
    stage.wait_for_drops("malformed message", 1)
    stage.team.publish(update_messages(stage.rover.looks(0.8), robot=3, frame="odom")[0])
    stage.wait_for_drops("wrong frame", 1)
    assert stage.plan().progress.known_voxels == known


def test_a_place_of_interest_draws_the_view(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    looks = {}
    for side in (-1.0, 1.0):
        box = Marker(ns="site", id=1, type=Marker.CUBE, text="200")
        box.header.frame_id = "map"
        box.pose.position.y = side * 2.0
        box.pose.orientation.w = 1.0
        box.scale.x, box.scale.y, box.scale.z = 8.0, 2.0, 4.0
        stage.interest.publish(MarkerArray(markers=[box]))
        stage.graph.spin_until(lambda y=2.0 * side: places_of_interest(stage) == [y], "interest")
        pose = stage.plan().pose
        assert pose is not None
        looks[side] = pose[1, 3] + 1.5 * pose[1, 2]
    assert looks[-1.0] < 0.0 < looks[1.0]


def test_a_view_that_failed_is_not_chosen_again(stage: Stage) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    poses = []
    for failures in range(1, 4):
        pose = stage.plan().pose
        assert pose is not None
        for earlier in poses:
            apart = np.linalg.norm(pose[:3, 3] - earlier[:3, 3])
            turned = np.arccos(np.clip(pose[:3, 2] @ earlier[:3, 2], -1.0, 1.0))
            assert apart > 0.2 or turned > 0.35
        poses.append(pose)
        failed = status(failures=failures, failed_view=pose.tolist(), failure="arm: stuck")
        stage.status.publish(failed)
        stage.graph.spin_until(
            lambda n=failures: stage.node._last.failures == n, "the failure to be heard"
        )


def test_foreign_statuses_are_counted(stage: Stage) -> None:
    stage.status.publish(DiagnosticStatus(name="motor"))
    stage.wait_for_drops("malformed message", 1)


@pytest.mark.parametrize("name, place", [("plan_home", "home"), ("plan_back", "last_look")])
def test_routes_to_known_places_are_planned(stage: Stage, name: str, place: str) -> None:
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    joints = {**stage.rover.joints, "arm_pan_joint": 0.3}
    known = {f"{place}_base": [0.0, 0.0, 0.0], f"{place}_joints": joints}
    stage.status.publish(status(home_pose=np.eye(4).tolist(), **known))
    stage.graph.spin_until(lambda: getattr(stage.node._last, place).is_known, "it to be heard")
    stage.plan()
    answer = stage.call(name)
    assert answer.success, answer.message
    route = choice_from_text(answer.message).route
    assert route is not None
    names = route.arm_after.joint_names
    np.testing.assert_allclose(
        route.arm_after.positions[-1], [joints[name] for name in names], atol=1e-6
    )


def test_the_arm_is_planned_again_to_the_view_planned_last(stage: Stage) -> None:
    said = stage.graph.collect(DiagnosticStatus, "route_status", qos.latched())
    assert not stage.call("plan_arm").success
    stage.tell(stage.rover.updates, -0.4, 0.0, 0.4)
    view = stage.plan()
    assert view.route is not None
    answer = stage.call("plan_arm")
    assert answer.success, answer.message
    again = choice_from_text(answer.message)
    assert again.route is not None and again.pose is not None and view.pose is not None
    driven = again.route.base_poses[-1][:2, 3] if again.route.moves_base else np.zeros(2)
    assert np.linalg.norm(driven) <= 1.0, "the base, which has not driven, is near the view"
    assert np.linalg.norm(again.pose[:3, 3] - view.pose[:3, 3]) <= 0.1
    wanted = {route_digest(choice.route) for choice in (view, again) if choice.route}
    stage.graph.spin_until(lambda: len(said) >= len(wanted), "the state of both routes")
    assert {status.values[0].value for status in said} == wanted
    assert {status.level for status in said} == {DiagnosticStatus.OK}


def test_a_restarted_planner_keeps_to_the_clear_space_of_the_start(graph: Any) -> None:
    """Where the mission began is clear, not the place where the planner was started again."""
    stage = Stage(graph)
    began = np.eye(4)
    began[0, 3] = -50.0
    stage.status.publish(status(home_base=[-50.0, 0.0, 0.0], home_pose=began.tolist()))
    stage.graph.spin_until(lambda: stage.node._last.home_pose is not None, "home to be heard")
    stage.tell(stage.rover.updates, 0.0)
    stage.plan()
    assert stage.node._planner is not None
    np.testing.assert_array_equal(stage.node._planner.planner.motion._start.T_map_base, began)


def rating_model(stage: Stage) -> str:
    return stage.node.health.values().get("localization error by", "")


def wall_fiducials() -> Fiducials:
    """On the wall ahead of the rover, known to a millimeter."""
    y, z = np.meshgrid(np.linspace(-1.5, 1.5, 7), np.linspace(0.2, 1.2, 4))
    points = np.column_stack([np.full(y.size, 3.0), y.ravel(), z.ravel()])
    return Fiducials(np.arange(len(points)), points, np.tile(1e-6 * np.eye(3), (y.size, 1, 1)))


def test_views_are_rated_by_the_fiducials_that_are_published(stage: Stage) -> None:
    """What the node says of the chosen view is what the prediction gives for it."""
    stage.rover.pose_covariance = np.diag([4e-4] * 3 + [1e-5] * 3)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    drift = stage.plan()
    assert rating_model(stage) == "odometry drift"
    assert drift.explanation["terms"]["localization_error"] > 0.0

    known = wall_fiducials()
    stage.fiducials.publish(encode_fiducials(TYPES, 1_000_000_000, "map", known))
    stage.graph.spin_until(lambda: stage.node._fiducials.fiducials() is not None, "fiducials")
    choice = stage.plan()
    assert rating_model(stage) == f"{len(known)} fiducials"

    terms, pose = choice.explanation["terms"], choice.pose
    state, voxel_map = stage.node._tracker.state(), stage.node._map.voxel_map()
    prediction = ErrorPrediction(StereoRig(CAMERA, CAMERA, BASELINE))
    new = prediction.new_points(state.T_map_camera, known.positions, voxel_map)
    assert pose is not None
    straight = float(np.linalg.norm(pose[:3, 3] - state.T_map_camera[:3, 3]))
    before = np.sqrt(np.trace(state.pose_covariance[:3, :3]))
    growths = []
    for length in (straight, 3.0 * straight):  # the way through free space is between these
        after = prediction.predict(
            state.T_map_camera, state.pose_covariance, Paths(pose[None], np.array([length])),
            (known.positions, known.covariances), new, voxel_map,
        )[0]  # fmt: skip
        growths.append(np.sqrt(np.trace(after[:3, :3])) - before)
    assert growths[0] - 1e-5 <= terms["localization_error"] <= growths[1] + 1e-5


def test_fiducials_that_cannot_be_used_are_counted(stage: Stage) -> None:
    stage.fiducials.publish(encode_fiducials(TYPES, 0, "odom", wall_fiducials()))
    stage.wait_for_drops("wrong frame", 1)
    known = wall_fiducials()
    known.positions[0, 0] = np.nan
    stage.fiducials.publish(encode_fiducials(TYPES, 0, "map", known))
    stage.wait_for_drops("malformed message", 1)
    assert stage.node._fiducials.fiducials() is None


@pytest.mark.parametrize("predicts", [False, True])
def test_unknown_voxels_are_predicted_where_that_is_asked_for(graph: Any, predicts: bool) -> None:
    stage = Stage(graph, predict_unknown=predicts)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    choice = stage.plan()
    assert choice.pose is not None
    task, planner = stage.node.config(TaskConfig), stage.node.config(ViewPlannerConfig)
    told = {}
    for predict in (False, True):
        config = replace(
            InformationConfig.of_stereo(StereoRig(CAMERA, CAMERA, BASELINE)),
            wanted_sigma=task.surface_sigma,
            predict_unknown=predict,
        )
        told[predict] = expected_information(
            stage.node._map.voxel_map(), choice.pose[None], CAMERA, planner.max_range,
            config=config, region=task.region,
        )[0]  # fmt: skip
    stated = choice.explanation["terms"]["information"]
    assert abs(stated - told[predicts]) < 0.2 * abs(stated - told[not predicts])


def octree_of(voxel_map: VoxelMap, binary: bool = False, frame: str = "map") -> Any:
    """A map as map_fusion publishes it."""
    tree, size = (binary_tree if binary else full_tree)(voxel_map), voxel_map.config.voxel_size
    return encode_octomap(TYPES, 1_000_000_000, frame, size, tree.data, binary=binary)


def bits_of(voxel_map: VoxelMap, pose: Any, wanted_sigma: float) -> float:
    """What a view is expected to tell."""
    config = InformationConfig.of_stereo(StereoRig(CAMERA, CAMERA, BASELINE))
    config, region = replace(config, wanted_sigma=wanted_sigma), TaskConfig().region
    reach = ViewPlannerConfig().max_range
    of_all = expected_information(
        voxel_map, pose[None], CAMERA, reach, config=config, region=region
    )
    return float(of_all[0])


def test_a_view_is_planned_on_an_octree_as_on_the_updates_of_the_same_map(graph: Any) -> None:
    """Occupancy is the same, so views have the same bits of it.

    Of the surface a tree says less: its sigma is 0.1 m / sqrt(12) = 29 mm, which the 30 mm that
    suffice count as precise, so these bits are those that the scans still lack, a few percent.
    Heights are those of the voxels' centers, so that ground is up to half a voxel off and places
    to stand, and with them the chosen view, are others: one within a fifth of the bits.
    """
    pytest.importorskip("octomap_msgs")
    stage = Stage(graph, map_source="octomap", octomap_free=0.05)
    assert stage.call().message == "no octomap_full with something in it has arrived yet"
    seen = stage.rover.looks(-0.8, 0.0, 0.8)
    stage.send(octree_of(seen))
    chosen = stage.plan().pose
    found = stage.node._map.voxel_map()
    centers = (seen.voxels()[0] + 0.5) * 0.1
    assert found.known_voxels == seen.known_voxels
    np.testing.assert_allclose(found.probability(centers), seen.probability(centers), rtol=1e-12)

    graph.remove(stage.node)
    stage.node = graph.add(NextBestViewNode, **QUICK)
    graph.connect(stage.rover.updates)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    by_updates = stage.plan().pose
    assert chosen is not None and by_updates is not None
    for pose in (chosen, by_updates):
        assert bits_of(found, pose, 0.0) == pytest.approx(bits_of(seen, pose, 0.0), rel=1e-6)
        assert bits_of(found, pose, 0.03) == pytest.approx(bits_of(seen, pose, 0.03), rel=0.05)
    assert bits_of(seen, chosen, 0.03) > 0.8 * bits_of(seen, by_updates, 0.03)


def test_a_newer_octree_replaces_the_map_and_an_odd_one_changes_nothing(graph: Any) -> None:
    pytest.importorskip("octomap_msgs")
    stage = Stage(graph, map_source="octomap", octomap_free=0.05)
    wide, narrow = stage.rover.looks(-0.8, 0.0, 0.8), stage.rover.looks(0.0)
    for seen in (narrow, wide, narrow):  # what a mapper forgets is gone too
        stage.send(octree_of(seen))
        assert stage.plan().progress.known_voxels == seen.known_voxels
    stage.send(octree_of(wide))  # nobody has asked for a plan on this one when the odd ones come
    short, color, large = octree_of(wide), octree_of(wide), octree_of(wide)
    short.data, color.id, large.resolution = short.data[:-3], "ColorOcTree", 1e9
    for count, (reason, odd) in enumerate(
        [
            ("wrong frame", octree_of(wide, frame="odom")),
            ("malformed message", color),
            ("invalid data", short),
            ("invalid data", large),
        ]
    ):
        stage.octrees.publish(odd)
        stage.wait_for_drops(reason, max(1, count - 1))
    assert stage.plan().progress.known_voxels == wide.known_voxels
    stage.send(octree_of(narrow))
    assert stage.plan().progress.known_voxels == narrow.known_voxels


@pytest.mark.parametrize("binary", [False, True])
def test_a_view_is_planned_on_what_octomap_server_sends(
    graph: Any, tmp_path: Any, binary: bool
) -> None:
    """Its sensor model (0.7, 0.4), clamped at -2 and 3.5: no voxel is below 0.1 in the tree."""
    pytest.importorskip("octomap_msgs")
    pyoctomap = pytest.importorskip("pyoctomap")
    stage, tree = Stage(graph, map_source="octomap"), pyoctomap.OcTree(0.1)
    for pan in (-0.8, 0.0, 0.8):
        stage.rover.joints |= {"arm_pan_joint": pan, "arm_wrist_joint": 0.4}
        pose = stage.rover.T_map_camera()
        points = transform_points(pose, room_scan(pose).reshape(-1, 3).astype(float))
        for _ in range(8):
            tree.insertPointCloud(points, pose[:3, 3])
    (tree.writeBinary if binary else tree.write)(str(tmp_path / "tree"))
    data = (tmp_path / "tree").read_bytes().partition(b"\ndata\n")[2]
    stage.send(encode_octomap(TYPES, 1_000_000_000, "map", 0.1, data, binary=binary))
    choice = stage.plan()
    assert choice.pose is not None
    assert choice.route is not None
    ahead = stage.node._map.voxel_map().probability([[1.0, 0.0, 0.3], [3.05, 0.0, 0.3]])
    assert ahead[0] < 0.05 < 0.95 < ahead[1]
