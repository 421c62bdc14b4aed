"""map_fusion hears of corrected camera poses, and puts its scans where they belong.

The work is cut into jobs of about one scan, so that new scans are integrated in between and the
map is served as it was until the corrected one is complete.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.keyframes import (
    KeyframePoses,
    decode_keyframe_covariances,
    decode_keyframe_poses,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.fusion.map_keeper import KEYFRAME_POSES, MapKeeper
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizerConfig
from infomap_ros.pipeline.stamped_parts import StampedParts

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
        for poses, told in complete:
            if told is not None and np.array_equal(told[1], poses.stamps):
                poses = replace(poses, origin=told[0], covariances=told[2])
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
