"""Node ``map_fusion``: clouds and camera poses in, the voxel map out.

Callbacks only receive: a cloud waits until the pose at its stamp is known and then goes to the
worker thread, which owns the map: it integrates, publishes, saves, loads and resets, in the order
in which it is told. So no lock is needed and no callback blocks.

When the clock jumps back (a bag that loops), what waits for a pose is dropped and the map is kept,
or reset where ``reset_on_clock_jump`` says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.clock import Clock, ClockType
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from infomap_ros.errors import FrameError, InfomapError
from infomap_ros.geometry import PointCloudRecord, PoseRecord
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.nodes import qos
from infomap_ros.nodes.base import MonitoredNode, run_node
from infomap_ros.nodes.map_keeper import MapKeeper, MapKeeperConfig
from infomap_ros.nodes.map_outputs import MapOutputsConfig
from infomap_ros.replay.messages import decode_point_cloud, decode_pose_with_covariance


@dataclass(frozen=True)
class MapFusionConfig:
    """How map_fusion treats its inputs.

    Raises:
        ConfigError: a value is out of its range.
    """

    camera_frame: str = parameter(
        "",
        "Optical frame of which camera_pose is the pose. Clouds in another frame are dropped. "
        "Empty: that of the first cloud.",
    )
    queue_size: int = parameter(
        10, "Scans that wait for the worker at most; the oldest gives way.", low=1, high=1000
    )
    autosave_period: float = parameter(
        0.0,
        "Time between two saves to map_file, and one more at the end; 0 for none.",
        unit="s",
        low=0.0,
        high=86400.0,
    )
    reset_on_clock_jump: bool = parameter(
        False, "Forget the map when the clock jumps back, as when a bag starts again."
    )

    def __post_init__(self) -> None:
        check_config(self)


class MapFusionNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (MapFusionConfig, ""),
        (MapKeeperConfig, ""),
        (MapOutputsConfig, ""),
        (VoxelMapConfig, ""),
        (PoseBufferConfig, "poses."),
        (WaitingQueueConfig, "waiting."),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("map_fusion", **node_arguments)
        self._config = self.config(MapFusionConfig)
        self._map_frame = self.config(MapOutputsConfig).map_frame
        self._keeper = MapKeeper(self)
        self._poses = PoseBuffer(self.config(PoseBufferConfig))
        waiting = self.config(WaitingQueueConfig)
        self._waiting: WaitingQueue[PointCloudRecord] = WaitingQueue(
            self._poses.at, waiting, lambda _, why: self.drop("no pose at the stamp", why)
        )
        self._jump = round(waiting.max_wait * 1e9)
        self._newest = 0
        self._frame = self._config.camera_frame
        self._keeper.prepare()
        self._worker = self.start_worker(self._config.queue_size)
        self._open()

    def _open(self) -> None:
        """Subscribe, offer the services and start the timers, now that the kernels are warm."""
        pose_type = PoseWithCovarianceStamped
        self.listen(PointCloud2, "points2", self._on_cloud, qos.sensor_data())
        self.listen(pose_type, "camera_pose", self._on_pose, qos.sensor_data(depth=50))
        keeper = self._keeper
        for name, order in (("save", keeper.save), ("load", keeper.load), ("reset", keeper.reset)):
            self.create_service(Trigger, f"~/{name}", self._service(order))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(keeper.pictures_period, self._publish_pictures, clock=steady)
        if self._config.autosave_period:
            self.create_timer(self._config.autosave_period, self._autosave, clock=steady)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        if pose.frame_id != self._map_frame:
            raise FrameError(f"pose in frame '{pose.frame_id}', the map is '{self._map_frame}'")
        if self._poses.add(pose):
            self._waiting.drop_all("time went backwards")
        self._hand_over()

    def _on_cloud(self, message: PointCloud2) -> None:
        cloud = decode_point_cloud(message)
        self._frame = self._frame or cloud.frame_id
        if cloud.frame_id != self._frame:
            raise FrameError(
                f"cloud in frame '{cloud.frame_id}', camera_pose is of '{self._frame}'"
            )
        if cloud.stamp < self._newest - self._jump:
            self._on_clock_jump(cloud.stamp)
        self._newest = max(self._newest, cloud.stamp)
        self._waiting.push(cloud.stamp, cloud)
        self._hand_over()

    def _on_clock_jump(self, stamp: int) -> None:
        """The rule of the module; poses are forgotten unless they have jumped already."""
        self.get_logger().warning("time went backwards")
        self._newest = stamp
        if (self._poses.newest_stamp or 0) > stamp + self._jump:
            self._poses.clear()
        if self._config.reset_on_clock_jump:
            self._worker.submit_always(self._keeper.reset)

    def _hand_over(self) -> None:
        """Give the worker the clouds whose pose is known."""
        for cloud, pose in self._waiting.take():
            self._worker.submit(partial(self._fuse, cloud, pose))

    def _fuse(self, cloud: PointCloudRecord, pose: PoseRecord) -> None:
        if self.guard("points2", lambda: self._keeper.integrate(cloud, pose)):
            self.health.produced()

    def _publish_pictures(self) -> None:
        self._worker.submit_always(self._keeper.publish_pictures)

    def _autosave(self) -> None:
        self._worker.submit_always(lambda: self.guard("map_file", self._keeper.save))

    def _service(self, order: Callable[[], str]) -> Callable[[Any, Any], Any]:
        """A service that has the worker carry out an order and answers when it is done."""

        async def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            done: Future = Future(executor=self.executor)

            def work() -> None:
                try:
                    done.set_result((True, order()))
                except InfomapError as error:
                    done.set_result((False, str(error)))
                self.executor.wake()

            self._worker.submit_always(work)
            response.success, response.message = await done
            self.get_logger().info(response.message)
            return response

        return serve

    def destroy_node(self) -> None:
        """Stop the worker, save once more if it is wanted, and end."""
        self._worker.stop()
        if self._config.autosave_period:
            self.guard("map_file", self._keeper.save)
        super().destroy_node()


def main() -> int:
    """Run the node."""
    return run_node(MapFusionNode)


if __name__ == "__main__":
    raise SystemExit(main())
