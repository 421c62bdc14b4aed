"""map_fusion on a robot of which it knows nothing but clouds and /tf; and clouds of two sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

from infomap_ros.geometry import (
    PinholeCamera,
    PointCloudRecord,
    PoseRecord,
    PoseUncertainty,
    TransformRecord,
    invert_transform,
    make_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.messages import encode_point_cloud, encode_pose, encode_transforms
from infomap_ros.nodes.fusion.scan_inputs import carried_pose
from infomap_ros.nodes.map_fusion import MapFusionNode

from .test_frames_in import Frames
from .test_map_fusion import START, TYPES

pytest.importorskip("tf2_msgs")
SECOND = 1_000_000_000
WALL = 3.02  # x of it in the map [m]
T_BASE_LIDAR = make_transform(
    Rotation.from_euler("zy", [30.0, 12.0], degrees=True).as_matrix(), [0.2, -0.1, 0.6]
)
T_LIDAR_CAMERA = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.05, 0.1, -0.2])


class Lidar:
    """Publishes a wall as a lidar on a base that drives sees it, and where the base is."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph, self.stamp = graph, START
        self.frames = Frames(graph)
        mounts = [("base_link", "lidar", T_BASE_LIDAR), ("lidar", "camera", T_LIDAR_CAMERA)]
        edges = [TransformRecord(0, *mount, True) for mount in mounts]
        self.frames.static.publish(encode_transforms(TYPES, edges))
        self.node = graph.add(MapFusionNode, voxel_size=0.1, **parameters)
        self.clouds = graph.publisher(PointCloud2, "points2")
        self.poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose")
        graph.connect(self.clouds, self.poses)

    def base(self) -> np.ndarray:
        """T_map_base now, in a curve."""
        t = (self.stamp - START) / SECOND
        turn = Rotation.from_euler("z", 0.2 * t).as_matrix()
        return make_transform(turn, [0.3 * t, 0.1 * t, 0.0])

    def scan(self) -> PointCloudRecord:
        """What a lidar sees: a list of points without covariances."""
        y, z = np.meshgrid(np.arange(-1.0, 1.0, 0.04), np.arange(0.1, 1.5, 0.04))
        wall = np.column_stack([np.full(y.size, WALL), y.ravel(), z.ravel()])
        points = transform_points(invert_transform(self.base() @ T_BASE_LIDAR), wall)
        return PointCloudRecord(self.stamp, "lidar", points.astype(np.float32))

    def drive(self, *, tells_tf: bool = True) -> None:
        """Go on for a tenth of a second, and see the wall."""
        self.stamp += SECOND // 10
        if tells_tf:
            T_map_odom = make_transform(np.eye(3), [0.5, 0.0, 0.0])
            T_odom_base = invert_transform(T_map_odom) @ self.base()
            self.frames.move(self.stamp, "map", "odom", T_map_odom)
            self.frames.move(self.stamp, "odom", "base_link", T_odom_base)
        self.clouds.publish(encode_point_cloud(TYPES, self.scan()))

    def drive_until(self, condition: Any, what: str, **how: Any) -> None:
        def step() -> Any:
            self.drive(**how)
            for _ in range(10):  # callbacks: several messages come with each step
                self.graph.executor.spin_once(timeout_sec=0.01)
            return condition()

        self.graph.spin_until(step, what)

    def surface(self) -> np.ndarray:
        """Means of the map's surface voxels, shape (N, 3)."""
        return self.node._keeper._map.gaussians()[1]


def test_clouds_and_tf_are_enough_for_a_map(graph: Any) -> None:
    lidar = Lidar(graph)
    lidar.drive_until(lambda: lidar.node.health.results() >= 8, "scans")

    surface = lidar.surface()
    assert len(surface) > 100
    np.testing.assert_allclose(surface[:, 0], WALL, atol=0.03)
    assert np.ptp(surface[:, 1]) > 1.5 and np.ptp(surface[:, 2]) > 1.0
    assert lidar.node.health.missing() == []


def test_clouds_without_covariances_are_said_once(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    lidar = Lidar(graph)
    logger = type(lidar.node.get_logger())
    monkeypatch.setattr(logger, "warning", lambda _self, text, **_how: said.append(text))
    lidar.drive_until(lambda: lidar.node.health.results() >= 3, "scans")
    assert sum("points2 has no covariances" in text for text in said) == 1


def test_a_frame_that_tf_does_not_place_is_named(graph: Any) -> None:
    lidar = Lidar(graph)
    health = lidar.node.health
    reason = "no pose at the stamp"
    lidar.drive_until(lambda: reason in health.drops(), "a drop", tells_tf=False)

    said = health.values()[f"last drop: {reason}"]
    assert "nothing has come on camera_pose" in said
    assert "'map'" in said and "lidar < base_link" in said
    assert lidar.node.health.missing() != []


def test_once_camera_pose_is_told_it_alone_counts(graph: Any) -> None:
    """tf is wrong by half a meter then, as odometry is that localization has corrected."""
    lidar = Lidar(graph)

    def tell() -> bool:
        pose = lidar.base() @ T_BASE_LIDAR
        record = PoseRecord(lidar.stamp, "map", pose, 1e-6 * np.eye(6))
        lidar.poses.publish(encode_pose(TYPES, record))
        return lidar.node._inputs._placed._has_pose

    lidar.graph.spin_until(tell, "poses")
    lidar.frames.fix("map", "base_link", make_transform(np.eye(3), [0.5, 0.0, 0.0]))

    def fused() -> bool:
        tell()
        return lidar.node.health.results() >= 4

    lidar.drive_until(fused, "scans", tells_tf=False)
    np.testing.assert_allclose(lidar.surface()[:, 0], WALL, atol=0.03)


def test_clouds_of_another_frame_than_the_camera_are_placed_by_tf(graph: Any) -> None:
    """camera_pose is that of the camera, and the clouds are of a lidar below it."""
    lidar = Lidar(graph, camera_frame="camera")

    def tell() -> bool:
        pose = lidar.base() @ T_BASE_LIDAR @ T_LIDAR_CAMERA
        record = PoseRecord(lidar.stamp, "map", pose, 1e-6 * np.eye(6))
        lidar.poses.publish(encode_pose(TYPES, record))
        return lidar.node.health.results() >= 4

    lidar.drive_until(tell, "scans", tells_tf=False)
    np.testing.assert_allclose(lidar.surface()[:, 0], WALL, atol=0.03)


def test_clouds_that_camera_pose_is_not_of_are_refused_where_tf_tells(graph: Any) -> None:
    """camera_pose is that of the camera, whose frame nobody names, and clouds are of a lidar."""
    lidar = Lidar(graph)
    graph.connect(lidar.frames.moving, lidar.frames.static)
    drops = lidar.node.health.drops

    def tell() -> bool:
        pose = lidar.base() @ T_BASE_LIDAR @ T_LIDAR_CAMERA
        record = PoseRecord(lidar.stamp, "map", pose, 1e-6 * np.eye(6))
        lidar.poses.publish(encode_pose(TYPES, record))
        return drops().get("wrong frame", 0) >= 5

    lidar.drive_until(tell, "refusals")
    # What came before the first camera_pose was placed by tf alone.
    np.testing.assert_allclose(lidar.surface()[:, 0], WALL, atol=0.03)
    said = lidar.node.health.values()["last drop: wrong frame"]
    assert "turned by 120 degrees" in said
    assert "camera_frame" in said


def test_a_carried_pose_has_the_covariance_of_its_samples() -> None:
    rng = np.random.default_rng(0)
    root = 1e-3 * rng.normal(size=(6, 6))
    parts = PoseUncertainty(root @ root.T, 1e-7 * np.eye(6), 1e-8 * np.eye(6))
    T_map_camera = make_transform(Rotation.random(random_state=1).as_matrix(), [1.0, 2.0, 3.0])
    pose = PoseRecord(0, "map", T_map_camera, parts.covariance, uncertainty=parts)
    carried = carried_pose(pose, T_LIDAR_CAMERA, "other")

    draws = rng.multivariate_normal(np.zeros(6), parts.covariance, 20_000)
    samples = np.array([perturb_transform(T_map_camera, e) @ T_LIDAR_CAMERA for e in draws])
    turns = Rotation.from_matrix(samples[:, :3, :3] @ carried.transform[:3, :3].T).as_rotvec()
    errors = np.hstack([samples[:, :3, 3] - carried.transform[:3, 3], turns])
    assert carried.covariance is not None and carried.uncertainty is not None
    sigmas = np.sqrt(np.diag(carried.covariance))
    close = np.abs(np.cov(errors.T) - carried.covariance) / np.outer(sigmas, sigmas)
    assert close.max() < 0.05
    np.testing.assert_allclose(carried.uncertainty.covariance, carried.covariance)


ROOM = np.array([4.0, 3.0])  # its walls are x = 4 m and y = 3 m [m, map]
T_BASE_CAMERA = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.2, 0.0, 0.5])
T_BASE_ARM = make_transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), [0, 0.1, 0.7])
T_ARM_SECOND = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.1, 0.3, 0.0])
CAMERA = PinholeCamera(48, 36, 40.0, 40.0, 23.5, 17.5)


class TwoCameras:
    """A robot in a room: a camera on its base looks at one wall, one on its arm at the other.

    The second stands still beside the first, and has its own rate.
    """

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph, self.stamp, self.steps = graph, START, 0
        self.has_arm, self.has_odom, self.offset = True, True, np.zeros(2)
        self.frames = Frames(graph)
        mounts = [("base_link", "front", T_BASE_CAMERA), ("arm", "side", T_ARM_SECOND)]
        edges = [TransformRecord(0, *mount, True) for mount in mounts]
        self.frames.static.publish(encode_transforms(TYPES, edges))
        self.node = graph.add(MapFusionNode, voxel_size=0.1, **parameters)
        self.clouds = {name: graph.publisher(PointCloud2, "points2") for name in ("front", "side")}
        self.poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose", depth=100)
        graph.connect(self.poses, *self.clouds.values())

    def base(self) -> np.ndarray:
        t = (self.stamp - START) / SECOND
        turn = Rotation.from_euler("z", 0.05 * np.sin(t)).as_matrix()
        return make_transform(turn, [0.1 * np.sin(t), 0.1 * t % 0.5, 0.0])

    def arm(self) -> np.ndarray:
        """T_base_arm now: it swings."""
        swing = Rotation.from_euler("z", 0.1 * np.sin(3e-9 * (self.stamp - START))).as_matrix()
        return T_BASE_ARM @ make_transform(swing, [0.0, 0.0, 0.0])

    def place(self, name: str) -> np.ndarray:
        """T_map_sensor now, in truth."""
        if name == "front":
            return self.base() @ T_BASE_CAMERA
        return self.base() @ self.arm() @ T_ARM_SECOND

    def see(self, name: str) -> PointCloudRecord:
        """Where the rays of a camera meet the walls; the room has neither floor nor ceiling."""
        rays = CAMERA.back_project(np.ones((36, 48))).astype(float)
        T_map_sensor = self.place(name)
        directions, origin = rays @ T_map_sensor[:3, :3].T, T_map_sensor[:2, 3]
        with np.errstate(divide="ignore"):
            to_walls = (ROOM - origin) / directions[..., :2]
        scale = np.where(to_walls > 0, to_walls, np.inf).min(axis=-1)
        points = (rays * scale[..., None]).astype(np.float32)
        covariances = np.broadcast_to(1e-4 * np.eye(3, dtype=np.float32), (36, 48, 3, 3))
        return PointCloudRecord(self.stamp, name, points, covariances)

    def step(self) -> None:
        """A tenth of a second: the front camera sees at each, the other at every second."""
        self.stamp, self.steps = self.stamp + SECOND // 10, self.steps + 1
        if self.has_odom:
            self.frames.move(self.stamp, "map", "odom", make_transform(np.eye(3), [0.5, 0, 0]))
            T_odom_base = make_transform(np.eye(3), [-0.5, 0, 0]) @ self.base()
            self.frames.move(self.stamp, "odom", "base_link", T_odom_base)
        else:
            error = 1e-6 * np.eye(6)
            record = PoseRecord(self.stamp, "map", self.place("front"), error)
            self.poses.publish(encode_pose(TYPES, record))
        if self.has_arm:
            self.frames.move(self.stamp, "base_link", "arm", self.arm())
        for name in ("front", "side")[: 1 + self.steps % 2]:
            self.clouds[name].publish(encode_point_cloud(TYPES, self.see(name)))

    def go_on(self, until: Any, what: str) -> None:
        def step() -> Any:
            self.step()
            for _ in range(12):
                self.graph.executor.spin_once(timeout_sec=0.01)
            return until()

        self.graph.spin_until(step, what)

    def on_walls(self) -> tuple[int, int]:
        """Surface voxels on each wall; there are none elsewhere."""
        means = self.node._keeper._map.gaussians()[1]
        off = np.abs(ROOM - means[:, :2])
        assert off.min(axis=1).max(initial=0.0) < 0.03
        first, second = (off < 0.03).sum(axis=0).tolist()
        return first, second

    def lost(self) -> int:
        return self.node.health.drops().get("no pose at the stamp", 0)


def test_two_cameras_by_tf_map_two_walls_and_one_goes_on_without_the_other(graph: Any) -> None:
    robot = TwoCameras(graph)
    robot.go_on(lambda: min(robot.on_walls()) > 100, "both walls")
    robot.has_arm, lost = False, robot.lost()
    robot.go_on(lambda: robot.lost() >= lost + 5, "drops of one")
    said = robot.node.health.values()["last drop: no pose at the stamp"]
    assert "cloud in frame 'side'" in said
    results = robot.node.health.results()
    robot.go_on(lambda: robot.node.health.results() >= results + 10, "scans of the other")
    robot.on_walls()
    robot.has_arm = True
    robot.node._keeper._map.track_changes(True)
    seen, arrived = set[str](), robot.node._keeper.fuse

    def fuse(scan: Any) -> None:
        seen.add(scan.cloud.header.frame_id)
        arrived(scan)

    robot.node._keeper.fuse = fuse
    robot.go_on(lambda: seen == {"front", "side"}, "both again")
    robot.on_walls()


def test_a_camera_beside_the_located_one_is_placed_from_it_by_tf(graph: Any) -> None:
    """tf has the robot's joints, and nothing of map or odometry."""
    robot = TwoCameras(graph, camera_frame="front")
    robot.has_odom = False
    robot.go_on(lambda: min(robot.on_walls()) > 100, "both walls")
    scans: list[Any] = []
    fuse = robot.node._keeper.fuse

    def note(scan: Any) -> None:
        scans.append((scan.cloud.header.frame_id, scan.pose))
        fuse(scan)

    robot.node._keeper.fuse = note
    robot.go_on(lambda: {name for name, _ in scans} == {"front", "side"}, "both")
    by_frame = dict(scans)
    assert by_frame["front"].child_frame_id == ""
    lever = np.linalg.norm(T_BASE_CAMERA[:3, 3] - (T_BASE_ARM @ T_ARM_SECOND)[:3, 3])
    variance = np.trace(by_frame["side"].covariance[:3, :3])
    # Rotation about three axes moves the end of a lever by two of them.
    assert variance == pytest.approx(3e-6 + 2e-6 * lever**2, rel=0.05)


def test_two_cameras_and_a_pose_of_neither_by_name_are_refused(graph: Any) -> None:
    robot = TwoCameras(graph)
    robot.has_odom = robot.has_arm = False
    drops = robot.node.health.drops
    robot.go_on(lambda: drops().get("wrong frame", 0) >= 20, "refusals")
    said = robot.node.health.values()["last drop: wrong frame"]
    assert "'front'" in said and "'side'" in said
    assert robot.on_walls()[1] < 100
