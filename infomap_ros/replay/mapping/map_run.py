"""A recorded bag becomes a map: the offline counterpart of the nodes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing

from infomap_ros.errors import BagError, CapacityError, InfomapError
from infomap_ros.geometry import PoseRecord, WaitingQueue
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.bags.background import in_background
from infomap_ros.replay.bags.reader import BagReader, BagRecord
from infomap_ros.replay.localizing.localize_run import LocalizeRun
from infomap_ros.replay.localizing.trajectory_poses import TrajectoryPoses
from infomap_ros.replay.mapping.map_inputs import (
    MapInputs,
    MapOptions,
    find_inputs,
    localize_options,
)
from infomap_ros.replay.measuring.range_meters import Measurement
from infomap_ros.replay.measuring.range_sources import measure_all

Progress = Callable[[int, int], None]
"""Told how many of how many frames are done."""


class MapRun:
    """Maps a bag, frame by frame as its records come.

    Attributes:
        map: the voxel map.
        inputs: what the bag offers.
        frames: number of frames that are in the map.
        points: number of points that are in the map.
        dropped: frames that are not, by reason.
        refused: poses and transforms that could not be used, by reason.
        first: the first measurement in the map.
        seconds: how long `run` took [s].
        full: why the map could not take more, empty while it could.
        assumed_poses: number of poses whose covariance was assumed.
        localisation: how the camera was located, None where the bag tells its poses.
    """

    def __init__(self, bag: BagReader, options: MapOptions | None = None) -> None:
        """Look through the bag.

        Raises:
            BagError: it lacks what mapping needs.
            RobotModelError: its robot description cannot be used.
        """
        self._bag = bag
        self._options = options or MapOptions()
        self.inputs: MapInputs = find_inputs(bag, self._options)
        self.map = VoxelMap(self._options.map)
        self.frames = self.points = self.assumed_poses = 0
        self.dropped: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.first: Measurement | None = None
        self.seconds = 0.0
        self.full = ""
        self.localisation: LocalizeRun | None = None
        self._waiting: WaitingQueue[Measurement] = WaitingQueue(
            self._pose_at, self._options.waiting
        )

    def run(self, progress: Progress | None = None) -> None:
        """Read the whole bag.

        One thread reads and measures range, this one fuses: both let go of the interpreter where
        the work is.

        Args:
            progress: told after every frame.

        Raises:
            BagError: no frame could be mapped; says why.
            CapacityError: the first frame is too large for the map's memory limit.
        """
        start = time.perf_counter()
        self._locate()
        records = self._bag.records(self.inputs.topics)
        with closing(in_background(measure_all(records, self.inputs.source))) as entries:
            for entry in entries:
                self._take(entry)
                if progress is not None and isinstance(entry, Measurement):
                    progress(self.frames + sum(self.dropped.values()), self.inputs.frames)
                if self.full:
                    break
        self._finish()
        self.seconds = time.perf_counter() - start

    def _locate(self) -> None:
        """Find the camera's poses, where the bag does not tell them: as corrected in the end."""
        if isinstance(self.inputs.poses, TrajectoryPoses):
            self.localisation = LocalizeRun(self._bag, localize_options(self._options))
            self.localisation.run()
            self.inputs.poses.take(self.localisation.corrected_trajectory)

    def _take(self, entry: BagRecord | Measurement) -> None:
        if isinstance(entry, Measurement):
            self._push(entry)
        else:
            self.inputs.body.add(entry.record)
            self._add_pose(entry)
        for measurement, pose in self._waiting.take():
            self._fuse(measurement, pose)

    def _push(self, measurement: Measurement) -> None:
        expected = self.inputs.poses.camera_frame
        if measurement.frame_id == expected:
            self._waiting.push(measurement.stamp, measurement)
        else:
            self.dropped[f"image in frame '{measurement.frame_id}', not '{expected}'"] += 1

    def _add_pose(self, entry: BagRecord) -> None:
        try:
            self.inputs.poses.add(entry.record)
        except InfomapError as error:
            self.refused[str(error)] += 1

    def _pose_at(self, stamp: int) -> PoseRecord:
        """Pose of the camera, once the place of the robot's body is known too."""
        self.inputs.body.check_known_at(stamp, self.inputs.poses.camera_frame)
        return self.inputs.poses.at(stamp)

    def _fuse(self, measurement: Measurement, pose: PoseRecord) -> None:
        try:
            self._integrate(measurement, pose)
        except CapacityError as error:
            self.full = str(error)
        except InfomapError as error:
            self.dropped[str(error)] += 1

    def _integrate(self, measurement: Measurement, pose: PoseRecord) -> None:
        cloud = measurement.cloud
        covariance = pose.covariance
        if covariance is None:
            covariance = self._options.assumed.covariance()
            self.assumed_poses += 1
        report = self.map.integrate(
            self.inputs.body.remove(measurement),
            pose.transform,
            cloud.covariance_triangles,
            covariance,
            camera=cloud.camera,
            error_correlation=cloud.error_correlation,
        )
        self.frames += 1
        self.points += report.points_used
        self.first = self.first or measurement

    def _finish(self) -> None:
        """Give up on what still waits, and count everything that was dropped on the way."""
        self._waiting.take(now=2**63 - 1)
        self.dropped.update(self._waiting.dropped)
        self.dropped.update(self.inputs.source.dropped)
        if self.frames == 0 and self.full:
            raise CapacityError(f"not one frame fits: {self.full}")
        if self.frames == 0:
            reasons = self.dropped + self.refused
            why = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common(3))
            raise BagError(f"no frame could be mapped: {why or 'the bag has none'}")

    def summary(self) -> dict[str, int | float | str]:
        """Figures of the run, flat; ``dropped: <reason>`` counts frames."""
        figures: dict[str, int | float | str] = {
            "frames": self.frames,
            "points": self.points,
            "known_voxels": self.map.known_voxels,
            "surface_voxels": self.map.surface_voxels,
            "seconds": round(self.seconds, 3),
            "memory_bytes": self.map.memory_bytes(),
            "frames_dropped": sum(self.dropped.values()),
            "voxel_size": self.map.config.voxel_size,
            "map_frame": self.inputs.poses.map_frame,
            "range_topic": self.inputs.source.image_topic,
            "pose_topic": self.inputs.pose_topic or "(localisation)",
            "assumed_poses": self.assumed_poses,
            "poses_refused": sum(self.refused.values()),
            "body_points_dropped": self.inputs.body.dropped_points,
            "messages_skipped": sum(self._bag.skipped.values()),
            "bag_problems": len(self._bag.problems),
        }
        if self.localisation is not None:
            located = self.localisation.summary()
            names = ("tracking", "coasting", "lost", "keyframes", "path_length")
            figures |= {f"localisation_{name}": located[name] for name in names}
        figures |= {f"dropped: {reason}": count for reason, count in self.dropped.items()}
        return figures
