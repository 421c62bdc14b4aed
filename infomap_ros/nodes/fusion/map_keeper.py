"""The voxel map of map_fusion, with its file and its outputs. Used by one thread.

Scans are kept from when somebody publishes keyframe_poses: without that nobody can correct them,
and to keep one takes about as long as to integrate it.

Kernels of a map that are ready before the first message.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import InvalidInputError, MapFileError
from infomap_ros.exploration.team.teammate_places import BodyInScan
from infomap_ros.geometry import PinholeCamera, PlacedSolid, PointCloudRecord, PoseRecord, Sphere
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.files.export import (
    DistanceConfig,
    ProjectionConfig,
    obstacle_distances,
    project_map,
)
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.messages import decode_point_cloud, encode_point_cloud
from infomap_ros.messages.motions import KeyframePoses
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.run import prepare_kernels
from infomap_ros.nodes.fusion.map_outputs import MapOutputs, voxel_map_rows
from infomap_ros.nodes.fusion.update_stream import UpdateStream
from infomap_ros.nodes.team.map_moves import describe_move
from infomap_ros.nodes.team.team_map import TeamMap, team_map_file
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.stereo import DepthCameraSensor
from infomap_ros.team.replica import MapReplica, moved_map
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import encode_update


def warm_up(threads: int) -> None:
    """Use every kernel of a map once, so that it is compiled before the first message.

    Args:
        threads: that integrate a scan.
    """
    points = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5).back_project(np.full((24, 32), 1.0))
    covariances = np.broadcast_to(np.float32(1e-4) * np.eye(3, dtype=np.float32), (24, 32, 3, 3))
    colors = np.zeros(points.shape, np.uint8)
    record = PointCloudRecord(0, "warm_up", points, covariances, colors)
    cloud = decode_point_cloud(encode_point_cloud(RclpyMessageTypes(), record))
    # Voxels so small that all tables grow.
    trial = VoxelMap(VoxelMapConfig(voxel_size=0.01, max_range=2.0, threads=threads))
    trial.track_changes(True)
    pose = PoseRecord(0, "map", np.eye(4), 1e-6 * np.eye(6))
    MapBuilder(trial).fuse(Scan(cloud, pose, [PlacedSolid(Sphere(0.1), np.eye(4))]))
    trial.integrate(cloud.points.reshape(-1, 3)[::16], np.eye(4))
    replica, changes = MapReplica(trial.config), trial.take_changes()
    for version in (1, 2):
        update = MapUpdate.of_changes(changes, 0.01, 0, version)
        encode_update(update)
        replica.apply(update)
    trial.mark_changed(0, 1)
    trial.is_known(np.zeros((trial.known_voxels, 3)))
    voxel_map_rows(trial)
    _warm_up_corrections(trial.config, cloud.points)
    project_map(trial, ProjectionConfig())
    obstacle_distances(trial, DistanceConfig(margin=1.0))


def _warm_up_corrections(config: VoxelMapConfig, points: NDArray[np.float32]) -> None:
    """Keep scans in both forms and move them."""
    correctable, elsewhere = CorrectableMap(VoxelMap(config)), np.eye(4)
    correctable.voxel_map.track_changes(True)
    elsewhere[0, 3] = 0.1
    camera = fit_pinhole_camera(points)
    measured = DepthCameraSensor(camera).measure(points[..., 2]) if camera else None
    if measured is not None:
        cloud = measured.organized_points
        correctable.integrate(0, cloud, np.eye(4), measured.covariance_triangles, None, camera)
    correctable.integrate(1, points.reshape(-1, 3), np.eye(4))
    for stamp, pose in enumerate((np.eye(4), elsewhere)):
        correctable.receive_poses(stamp + 2, [0, 1], [pose, pose])
    correctable.correct()


KEYFRAME_POSES = "keyframe_poses"
_UNNAMED = "map.infomap"
Corner = tuple[float, float, float]
_LAST_CORRECTIONS = 3.0  # [s], for which the last save waits at the most


@dataclass(frozen=True)
class MapKeeperConfig:
    """Where the map is kept.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_file: str = parameter(
        "",
        "File of ~/save and ~/load, relative to the working directory. The map is saved to it at "
        "the end too. Empty: map.infomap, written only when that is asked for.",
    )
    resume: bool = parameter(False, "Load map_file at the start, where there is one.")

    def __post_init__(self) -> None:
        check_config(self)


class MapKeeper:
    """Integrates scans and keeps map file and outputs up to date.

    Args:
        node: has the configurations of keeper, outputs and map, and publishes.
        on_wanted: called, by any thread, when somebody waits for `publish_pictures`.

    Attributes:
        team: the map that is shown where there are other robots.
    """

    def __init__(self, node: MonitoredNode, on_wanted: Callable[[], object]) -> None:
        self._node = node
        self._config = node.config(MapKeeperConfig)
        self.outputs, self._updates = MapOutputs(node, on_wanted), UpdateStream(node)
        self.team = TeamMap(node, self._updates, self.outputs.changed)
        self._path = Path(self._config.map_file or _UNNAMED).absolute()
        self._is_saved, self._is_ours = True, False
        self._builder = MapBuilder(
            _tracked(VoxelMap(node.config(VoxelMapConfig))),
            body=node.config(BodyFilterConfig),
            assumed=node.config(AssumedPoseConfig),
        )
        self._stamp, self._without_covariances = 0, set[str]()

    @property
    def _map(self) -> VoxelMap:
        return self._builder.map

    def prepare(self) -> None:
        """Compile the kernels, and load the map file if the work is to be resumed.

        Raises:
            MapFileError: the map file cannot be used.
        """
        prepare_kernels(self._node, partial(warm_up, self._map.config.threads), seconds=90.0)
        if self._config.resume and self._path.exists():
            self._node.get_logger().info(self.load())
            self._updates.resumed()

    def fuse(self, scan: Scan[PointCloud2]) -> None:
        """Add a scan and publish what it changed.

        Raises:
            InfomapError: the scan cannot be used; the map is as before.
        """
        cloud = decode_point_cloud(scan.cloud)
        if scan.pose.covariance is None and not self._builder.assumed_poses:
            self._node.get_logger().warning(
                "the camera's pose has no covariance: default_position_sigma and "
                "default_rotation_sigma stand in for it"
            )
        if cloud.covariances is None and cloud.frame_id not in self._without_covariances:
            self._without_covariances.add(cloud.frame_id)
            sigma = self._map.config.default_sigma
            self._node.get_logger().warning(
                f"points2 has no covariances in frame '{cloud.frame_id}': each point counts as "
                f"right to {sigma} m (default_sigma)"
            )
        self._keep_scans_if_wanted()
        self._builder.fuse(scan.with_cloud(cloud))
        self._stamp = cloud.stamp
        self._announce_change()

    def forget_body(self, body: BodyInScan) -> None:
        """Take a teammate's body, placed in the map, out of what was fused before it was known."""
        if forgotten := self._builder.forget_body(body):
            self._node.get_logger().info(
                f"took {forgotten} voxels of teammate {body.robot} out of the map"
            )
            self._announce_change()

    @property
    def is_correcting(self) -> bool:
        """Whether scans are being put elsewhere."""
        return self._builder.is_correcting

    def add_keyframes(self, poses: KeyframePoses) -> None:
        """Take corrected poses, and begin to correct the map where scans belong elsewhere."""
        self._keep_scans_if_wanted()
        origin = self._map.origin
        self._builder.add_keyframes(poses)
        if self._map.origin != origin and origin:
            self._node.get_logger().info(f"moved the map to the frame of origin {poses.origin:08x}")
            self._announce_change()
            if self._config.map_file:  # what would be read is of another frame
                self.save_meanwhile()

    def correct_more(self) -> None:
        """Do a part of the correction; with the last one, publish what has become other.

        Raises:
            CapacityError: it does not fit into memory; the map is as before.
        """
        report = self._builder.correct_more()
        if report is None:
            return
        self._node.health.note("corrections of the map", str(self._builder.corrections))
        self._node.get_logger().info(
            f"moved {report.scans_moved} scans by up to {report.largest_correction:.3f} m, "
            f"{report.blocks_rebuilt} blocks made again"
        )
        self._announce_change()

    @property
    def behind(self) -> bool:
        """Whether a subscriber of map_updates still waits for what was known before."""
        return self._updates.behind

    def publish_more(self) -> None:
        """Publish more of what subscribers of map_updates wait for."""
        self._updates.publish(self._map, self._stamp, always=False)

    def picture(self, topic: str) -> Any:
        """The message of a topic of `MapOutputs` for the map as it is now.

        Raises:
            InvalidInputError: the map reaches too far for an octree.
        """
        shown = self._shown
        return self.outputs.picture(topic, shown, self._shown_stamp(shown))

    def publish_pictures(self) -> None:
        """Publish the pictures of the map that are wanted and out of date."""
        shown = self._shown
        memory = self._map.memory_bytes() + self.team.memory_bytes()
        self._node.health.note("map memory [bytes]", str(memory))
        store = self._builder.scans
        self._node.health.note("scans kept", str(len(store)))
        self._node.health.note("scans memory [bytes]", str(store.memory_bytes()))
        self._node.health.note("known voxels", str(shown.known_voxels))
        self.outputs.publish_pictures(shown, self._shown_stamp(shown))

    @property
    def _shown(self) -> VoxelMap:
        """The map of the team, where there is one."""
        return self.team.voxel_map or self._map

    def _shown_stamp(self, shown: VoxelMap) -> int:
        """That of the last scan, or of now for a map from a file; 0 for one without content."""
        now = self._node.get_clock().now().nanoseconds if shown.known_voxels else 0
        return self._stamp or int(now)

    def save(self) -> str:
        """Finish corrections that have begun and write the map file; returns a sentence.

        Raises:
            CapacityError: a correction does not fit into memory.
            MapFileError: it cannot be written.
        """
        while self._builder.is_correcting:
            self.correct_more()
        return self._save()

    def save_at_end(self) -> None:
        """Write the map file if one is named and lacks anything; no correction takes long then.

        Raises:
            CapacityError: a correction does not fit into memory.
            MapFileError: it cannot be written.
        """
        if not self._config.map_file or not self._map.known_voxels:
            return
        end = time.monotonic() + _LAST_CORRECTIONS
        while self._builder.is_correcting and time.monotonic() < end:
            self.correct_more()
        if not self._is_saved:
            self._node.get_logger().info(self._save())

    def save_meanwhile(self) -> None:
        """Write the map as it is where it has changed; a correction that has begun goes on after.

        Raises:
            MapFileError: it cannot be written.
        """
        if not self._is_saved and self._map.known_voxels:
            self._save()

    def _save(self) -> str:
        """Write the map file; what another run left there is kept beside it."""
        if not self._is_ours and self._path.exists():
            _keep_beside(self._path)
        answer = _save(self._map, self._path)
        self._is_saved = self._is_ours = True
        return answer

    def save_team(self) -> str:
        """Write the map of the whole team beside the map file; returns a sentence.

        Raises:
            InvalidInputError: there is no other robot.
            MapFileError: it cannot be written.
        """
        shared = self.team.voxel_map
        if shared is None:
            raise InvalidInputError("team", "no other robot has reported")
        shared.origin, shared.sessions = self._map.origin, self._map.sessions
        return _save(shared, team_map_file(self._path))

    def load(self) -> str:
        """Replace the map by that of the map file; returns a sentence.

        Raises:
            MapFileError: the file cannot be used; the map is as before.
        """
        loaded = VoxelMap.load(self._path)
        sizes = loaded.config.voxel_size, self._map.config.voxel_size
        if sizes[0] != sizes[1]:
            raise MapFileError(f"{self._path} has voxels of {sizes[0]} m, not {sizes[1]} m")
        restored = VoxelMap.from_state(self._map.config, loaded.state())
        restored.origin, restored.sessions = loaded.origin, loaded.sessions
        self._replace_by(restored)
        self._is_saved = self._is_ours = True
        return f"loaded {self._map.known_voxels} voxels from {self._path}"

    def reset(self) -> str:
        """Forget the map; returns a sentence."""
        count = self._map.known_voxels
        empty = VoxelMap(self._map.config)
        self._replace_by(empty)
        return f"forgot {count} voxels"

    def clear_region(self, low: Corner, high: Corner) -> str:
        """Make what is occupied in a box unknown, until it is seen again; returns a sentence.

        Args:
            low: smallest x, y, z of the box [m, map].
            high: largest x, y, z [m, map].

        Raises:
            InvalidInputError: the box is empty or not finite.
        """
        count = self._builder.clear_region(low, high)
        if count:
            self._announce_change()
        return f"cleared {count} occupied voxels"

    def move(self, given: PoseRecord) -> str:
        """Move what is in the map, voxel by voxel, and say so; scans move no more after that.

        Raises:
            InvalidInputError: the pose is none.
        """
        moved = moved_map(self._map, given.transform)
        moved.origin, moved.sessions = self._map.origin, self._map.sessions
        self._replace_by(moved)
        answer = f"moved {self._map.known_voxels} voxels {describe_move(given.transform)}"
        self._node.get_logger().info(answer)
        return answer

    def _announce_change(self) -> None:
        """The map has changed: it is not saved, its pictures are old, and listeners get it."""
        self._is_saved = False
        self.outputs.changed()
        self._updates.publish(self._map, self._stamp)

    def _replace_by(self, other: VoxelMap) -> None:
        self._is_saved = False
        self._updates.replace(self._map)
        self._builder.replace(_tracked(other))
        self.outputs.changed()
        self.publish_more()

    def _keep_scans_if_wanted(self) -> None:
        """Keep scans from now on if there is somebody who may correct them."""
        topic = self._node.resolve_topic_name(KEYFRAME_POSES)
        if not self._builder.keeps_scans and self._node.count_publishers(topic):
            self._builder.keep_scans(self._node.config(ScanStoreConfig))


def _tracked(voxel_map: VoxelMap) -> VoxelMap:
    """The map, whose changes are to be published."""
    voxel_map.track_changes(True)
    return voxel_map


def _keep_beside(path: Path) -> None:
    """Give a map file another name, so that it is not lost when a new one is written.

    Raises:
        MapFileError: that cannot be done.
    """
    try:
        path.replace(path.with_name(f"{path.stem}_previous{path.suffix}"))
    except OSError as error:
        raise MapFileError(f"cannot rename {path}: {error.strerror}") from error


def _save(voxel_map: VoxelMap, path: Path) -> str:
    """Write a map file; returns a sentence.

    Raises:
        MapFileError: it cannot be written.
    """
    try:
        voxel_map.save(path)
    except OSError as error:
        raise MapFileError(f"cannot write {path}: {error.strerror}") from error
    return f"saved {voxel_map.known_voxels} voxels to {path}"
