"""The inner part of Fig. 3: what is seen -> where the camera is -> map. Without ROS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from infomap_ros.errors import CapacityError, InfomapError
from infomap_ros.geometry import (
    JointStateRecord,
    PlacedSolid,
    PoseRecord,
    Record,
    quaternion_from_transform,
    transform_from_quaternion,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.config import KeptPoses
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.messages.motions import KeyframePoses
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, KeyframeChanges
from infomap_ros.pipeline.inertial import InertialSensor
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.perception import FramedView, Seen
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.robot_motion import RobotMotion
from infomap_ros.pipeline.scan_synchronizer import Scan, ScanSynchronizer
from infomap_ros.pipeline.view_synchronizer import PosturedView, ViewSynchronizer

END = 2**63 - 1  # [ns]


@dataclass(frozen=True, eq=False)
class Located:
    """What became of a view.

    Attributes:
        view: with what the robot knew of itself.
        result: where the camera was.
        kept: all keyframes as they are known now.
    """

    view: PosturedView[FramedView]
    result: LocalizedCamera
    kept: KeptPoses


@dataclass(frozen=True, eq=False)
class Fused:
    """A scan that is in the map.

    Attributes:
        scan: with its pose.
        report: what became of its points.
    """

    scan: Scan[RangeMeasurement]
    report: IntegrationReport


@dataclass(frozen=True)
class Localization:
    """What locates the camera.

    Attributes:
        views: wait until it is known how the robot stood.
        motion: of the robot; None where it is not used.
        localizer: that locates.
        inertial: sensor on the camera; None where there is none.
        changes: of its keyframes.
        others: bodies of teammates in the map at a time [ns]: they carry no fiducials.
    """

    views: ViewSynchronizer[FramedView]
    motion: RobotMotion | None
    localizer: CameraLocalizer
    inertial: InertialSensor | None = None
    changes: KeyframeChanges = field(default_factory=KeyframeChanges)
    others: Callable[[int], Sequence[PlacedSolid]] = lambda _: ()


@dataclass(frozen=True)
class Fusion:
    """What makes the map.

    Attributes:
        scans: wait until it is known where camera and bodies were.
        body: of the robot.
        builder: of the map.
        map_frame: frame of the map.
        pace: scans that a correction puts elsewhere with each view, as a node does beside its other
            work; None for all at once.
    """

    scans: ScanSynchronizer[RangeMeasurement]
    body: RobotBody
    builder: MapBuilder
    map_frame: str = "map"
    pace: int | None = None


class Pipeline:
    """Locates the camera by views, and fuses their range into a map; either may be left out.

    Args:
        localization: None where records say where the camera was.
        fusion: None where no map is made.

    Attributes:
        refused: records and results that could not be used, by reason.
    """

    def __init__(self, localization: Localization | None, fusion: Fusion | None) -> None:
        self._localization, self._fusion = localization, fusion
        self.refused: Counter[str] = Counter()

    def process(self, seen: Record | Seen) -> Iterator[Located | Fused]:
        """Take what came next, and do what can be done now.

        Raises:
            CapacityError: the map does not fit into its memory limit.
        """
        try:
            self._add(seen)
        except InfomapError as error:
            self.refused[str(error)] += 1
        yield from self._work()

    def finish(self) -> Iterator[Located | Fused]:
        """Do what can be done without anything that still waits; raises as `process`."""
        yield from self._work(END)
        if self._fusion is not None:
            self._fusion.builder.correct()

    def _add(self, seen: Record | Seen) -> None:
        """Let it wait for what belongs to it."""
        localization, fusion = self._localization, self._fusion
        if isinstance(seen, FramedView) and localization is not None:
            localization.views.add(seen)
        if isinstance(seen, FramedView | RangeMeasurement):
            cloud = seen.measurement if isinstance(seen, FramedView) else seen
            if fusion is not None and cloud is not None:
                fusion.scans.add_cloud(seen.stamp, seen.frame_id, cloud)
            return
        if fusion is not None and isinstance(seen, JointStateRecord):
            fusion.body.add(seen)
        if localization is None and fusion is not None:
            fusion.scans.add_pose(seen)
        elif localization is not None:
            for source in (localization.motion, localization.inertial):
                if source is not None:
                    source.add(seen)

    def _work(self, now: int | None = None) -> Iterator[Located | Fused]:
        if self._localization is not None:
            for view in self._localization.views.take(now):
                located = self._locate(self._localization, view)
                if located is not None:
                    yield located
                    yield from self._follow(self._localization, located)
        yield from self._fuse(now)

    def _locate(self, localization: Localization, view: PosturedView[FramedView]) -> Located | None:
        """Find out where a view was taken."""
        localizer = localization.localizer
        try:
            others = localization.others(view.stamp)
            robot = view.posture, view.body, others
            result = localizer.locate(view.images.view, *robot, inertial=view.inertial)
        except InfomapError as error:
            self.refused[str(error)] += 1
            return None
        kept = localizer.keyframes()
        return None if kept is None else Located(view, result, kept)

    def _follow(self, localization: Localization, located: Located) -> Iterator[Fused]:
        """Fuse what waited for the pose, and let the map follow the keyframes."""
        result, fusion = located.result, self._fusion
        if fusion is None or result.T_map_camera is None:
            return
        transform, frame = as_sent(result.T_map_camera), fusion.map_frame
        pose = result.stamp, frame, transform, result.covariance
        fusion.scans.add_pose(PoseRecord(*pose, uncertainty=result.uncertainty))
        yield from self._fuse()
        if (kept := localization.changes.after(result, located.kept)) is not None:
            sent = np.array([as_sent(pose) for pose in kept.transforms])
            origin = 0 if result.uncertainty is None else result.uncertainty.origin
            kept_poses = kept.stamps, sent, kept.covariances, origin
            keyframes = KeyframePoses(result.stamp, frame, *kept_poses)
            fusion.builder.add_keyframes(keyframes)
        fusion.builder.correct(fusion.pace)

    def _fuse(self, now: int | None = None) -> Iterator[Fused]:
        """Fuse the scans that are complete."""
        if self._fusion is None:
            return
        for scan in self._fusion.scans.take(now):
            try:
                report = self._fusion.builder.fuse(scan.with_cloud(scan.cloud.record))
            except CapacityError:
                raise
            except InfomapError as error:
                self.refused[str(error)] += 1
            else:
                yield Fused(scan, report)


def as_sent(transform: FloatArray) -> FloatArray:
    """A pose, shape (4, 4), rounded as by a message, whose rotation is a quaternion."""
    return transform_from_quaternion(quaternion_from_transform(transform), transform[:3, 3])
