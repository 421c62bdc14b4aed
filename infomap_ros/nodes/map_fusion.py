"""Node ``map_fusion``: clouds and camera poses in, the voxel map out.

Callbacks only receive: a cloud waits until the pose at its stamp is known and then goes to the
worker thread, which owns the map: it integrates, publishes, saves, loads and resets, in the order
in which it is sent. So no lock is needed and no callback blocks.

Localization corrects the poses of keyframes on keyframe_poses: scans follow, and the map is
corrected (`infomap_ros.nodes.map_fusion`).

When the clock jumps back (a bag that loops), the map is kept, or reset where
``reset_on_clock_jump`` says so. What becomes of clouds and poses then says
`infomap_ros.pipeline.scan_synchronizer`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from nav_msgs.srv import GetMap
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError
from infomap_ros.exploration.team.teammate_places import BodyInScan
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.geometry.records import WaitingQueueConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.files.export import DistanceConfig, ProjectionConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.messages.motions import (
    KeyframePoses,
    decode_keyframe_covariances,
    decode_keyframe_poses,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConfig
from infomap_ros.nodes.common.memory import MemoryConfig, reserve_heap
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.common.orders import offer_order, offer_service
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.fusion.map_keeper import KEYFRAME_POSES, MapKeeper, MapKeeperConfig
from infomap_ros.nodes.fusion.map_outputs import (
    OCTOMAP_BINARY,
    OCTOMAP_FULL,
    PROJECTED_MAP,
)
from infomap_ros.nodes.fusion.scan_inputs import ScanInputs
from infomap_ros.nodes.robot.robot_body import RobotBodyConfig
from infomap_ros.nodes.team.map_moves import listen_to_moves
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig
from infomap_ros.pipeline.scan_synchronizer import Scan, ScanSynchronizerConfig, StampedParts
from infomap_ros.team.config import TeamConfig


def offer_map(node: MonitoredNode, keeper: MapKeeper, worker: Worker) -> None:
    """Offer the services; those of octomap_msgs where that is installed.

    Args:
        node: that offers them.
        keeper: of the map.
        worker: whose thread owns the map.
    """

    def give(topic: str, _: Any, response: Any) -> None:
        response.map = keeper.picture(topic)

    def clear(request: Any, _: Any) -> None:
        corners = ((corner.x, corner.y, corner.z) for corner in (request.min, request.max))
        node.get_logger().info(keeper.clear_region(*corners))

    offer_service(node, GetMap, PROJECTED_MAP, worker, partial(give, PROJECTED_MAP))
    if not keeper.outputs.has_octomap:
        return
    for topic in (OCTOMAP_BINARY, OCTOMAP_FULL):
        kind = message_class("octomap_msgs/srv/GetOctomap")
        offer_service(node, kind, topic, worker, partial(give, topic))
    query = message_class("octomap_msgs/srv/BoundingBoxQuery")
    offer_service(node, query, "~/clear_region", worker, clear)


# map_fusion receives corrected camera poses, and puts its scans where they belong.
#
# The work is cut into jobs of about one scan, so that new scans are integrated in between and the
# map is served as it was until the corrected one is complete.

_COVARIANCES = "keyframe_covariances"
_Covariances = tuple[int, NDArray[np.int64], FloatArray]  # origin, stamps, covariances of keyframes


class MapCorrections:
    """Listens to keyframe_poses and has the worker correct the map.

    Covariances come beside the poses, with the same stamp, and poses wait for them.

    Args:
        node: that listens.
        keeper: of the map.
        worker: whose thread owns the map.
    """

    def __init__(self, node: MonitoredNode, keeper: MapKeeper, worker: Worker) -> None:
        self._node, self._keeper, self._worker = node, keeper, worker
        self._frame = node.config(ScanSynchronizerConfig).map_frame
        topic = node.resolve_topic_name(_COVARIANCES)
        self._parts: StampedParts[KeyframePoses, _Covariances] = StampedParts(
            lambda: node.count_publishers(topic) > 0
        )
        stream = qos.stream()
        node.listen(PointCloud2, _COVARIANCES, self._on_covariances, stream, required=False)
        node.listen(Path, KEYFRAME_POSES, self._on_poses, stream, required=False)

    def _on_covariances(self, message: PointCloud2) -> None:
        stamp, origin, stamps, covariances = decode_keyframe_covariances(message)
        self._hand_over(self._parts.add_part(stamp, (origin, stamps, covariances)))

    def _on_poses(self, message: Path) -> None:
        poses = decode_keyframe_poses(message)
        if poses.frame_id != self._frame:
            raise FrameError(f"poses in frame '{poses.frame_id}', the map is '{self._frame}'")
        self._hand_over(self._parts.add(poses.stamp, poses))

    def _hand_over(self, complete: list[tuple[KeyframePoses, _Covariances | None]]) -> None:
        for poses, given in complete:
            if given is not None and np.array_equal(given[1], poses.stamps):
                poses = replace(poses, origin=given[0], covariances=given[2])
            correct = partial(self._node.guard, KEYFRAME_POSES, partial(self._correct, poses))
            self._worker.submit_always(correct)

    def _correct(self, poses: KeyframePoses) -> None:
        was_correcting = self._keeper.is_correcting
        self._keeper.add_keyframes(poses)
        if self._keeper.is_correcting and not was_correcting:
            self._worker.submit_always(self._correct_more)

    def _correct_more(self) -> None:
        self._node.guard(KEYFRAME_POSES, self._keeper.correct_more)
        if self._keeper.is_correcting:
            self._worker.submit_always(self._correct_more)


_REPEAT_PERIOD = 0.1  # [s]


@dataclass(frozen=True)
class MapFusionConfig:
    """How map_fusion works through its input.

    Raises:
        ConfigError: a value is out of its range.
    """

    queue_size: int = setting(
        10, "Scans that wait for the worker at most; for one more, all give way.", low=1, high=1000
    )
    autosave_period: float = parameter(
        0.0,
        "Time between two saves to map_file; 0 for none but the one at the end.",
        unit="s",
        low=0.0,
        high=86400.0,
    )
    reset_on_clock_jump: bool = setting(
        False, "Forget the map when the clock jumps back, as when a bag starts again."
    )

    def __post_init__(self) -> None:
        check_config(self)


class MapFusionNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (MapFusionConfig, ""),
        (MapKeeperConfig, ""),
        (AssumedPoseConfig, ""),
        (TeamIdentityConfig, ""),
        (TeamConfig, "team_map."),
        (TeamRadioConfig, "team_map."),
        (ProjectionConfig, "projection."),
        (DistanceConfig, "distances."),
        (VoxelMapConfig, ""),
        (ScanStoreConfig, "scans."),
        (ScanSynchronizerConfig, ""),
        (PoseBufferConfig, "poses."),
        (WaitingQueueConfig, "waiting."),
        (RobotBodyConfig, ""),
        (BodyFilterConfig, "body."),
        (JointBufferConfig, "joints."),
        (MemoryConfig, ""),
        (LockstepConfig, ""),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("map_fusion", **node_arguments)
        self._config = self.config(MapFusionConfig)
        keeper = self._keeper = MapKeeper(self, self._publish_pictures)
        keeper.prepare()
        reserve_heap(self.config(MemoryConfig))
        self._worker = self.start_worker(self._config.queue_size)
        self._is_publishing = False
        keeper.team.listen(self._worker)
        MapCorrections(self, keeper, self._worker)
        frame = self.config(ScanSynchronizerConfig).map_frame
        listen_to_moves(self, frame, self._worker, keeper.move, "~/move")
        self._inputs = ScanInputs(self, self._on_scan, self._on_clock_jump, self._on_arrival)
        for order in (keeper.save, keeper.save_team, keeper.load, keeper.reset):
            name = f"~/{order.__name__}"
            offer_order(self, name, self._worker, partial(self._carry_out, order))
        offer_map(self, keeper, self._worker)
        offer_order(self, "~/team_hash", self._worker, keeper.team.account)
        self.repeat(keeper.outputs.pictures_period, self._publish_pictures)
        self.repeat(_REPEAT_PERIOD, self._publish_more)
        if self._config.autosave_period:
            self.repeat(self._config.autosave_period, self._autosave)

    def _on_scan(self, scan: Scan[PointCloud2]) -> None:
        self._worker.submit(partial(self._fuse, scan))

    def _fuse(self, scan: Scan[PointCloud2]) -> None:
        if self.guard("points2", partial(self._keeper.fuse, scan)):
            self.health.produced()

    def _on_arrival(self, body: BodyInScan) -> None:
        forget = partial(self._keeper.forget_body, body)
        self._worker.submit_always(lambda: self.guard("team/agents", forget))

    def _on_clock_jump(self) -> None:
        if self._config.reset_on_clock_jump:
            self._worker.submit_always(self._keeper.reset)

    def _publish_pictures(self) -> None:
        self._worker.submit_always(self._keeper.publish_pictures)

    def _publish_more(self) -> None:
        """Where no scan does it, send a new subscriber what it waits for."""

        def publish() -> None:
            self._is_publishing = False
            self._keeper.publish_more()

        if self._keeper.behind and not self._is_publishing:
            self._is_publishing = True
            self._worker.submit_always(publish)

    def _autosave(self) -> None:
        self._worker.submit_always(lambda: self.guard("map_file", self._keeper.save_meanwhile))

    def _carry_out(self, order: Callable[[], str]) -> str:
        """Carry out an order of the user, and say so."""
        answer = order()
        self.get_logger().info(answer)
        return answer

    def destroy_node(self) -> None:
        """Stop the worker, save what is not saved yet, and end."""
        self._worker.stop()
        self.guard("map_file", self._keeper.save_at_end)
        super().destroy_node()


def main() -> int:
    """Run the node."""
    return run_node(MapFusionNode)


if __name__ == "__main__":
    raise SystemExit(main())
