"""A recorded bag becomes a trajectory: the offline counterpart of the localisation node."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import BagError, InfomapError
from infomap_ros.geometry import PlacedSolid, PoseRecord, WaitingQueue, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.localization.localizer import Localisation, Localizer
from infomap_ros.localization.target.config import make_detector
from infomap_ros.replay.bags.background import in_background
from infomap_ros.replay.bags.reader import BagReader, BagRecord
from infomap_ros.replay.localizing.localize_inputs import (
    LocalizeInputs,
    LocalizeOptions,
    find_localize_inputs,
)
from infomap_ros.replay.localizing.trajectory import Trajectory, TrajectoryRecorder
from infomap_ros.replay.measuring.range_sources import measure_all
from infomap_ros.replay.measuring.view_meters import FramedView

Progress = Callable[[int, int], None]
"""Told how many of how many views are done."""


class LocalizeRun:
    """Follows the camera through a bag, view by view as its records come.

    Attributes:
        inputs: what the bag offers.
        localisations: one for each view, in order.
        refused: records that could not be used, by reason.
        without_motion: views for which odometry was wanted and not known, by reason.
        seconds: how long `run` took [s].
        seconds_locating: of these, how long the localizer worked [s].
    """

    def __init__(self, bag: BagReader, options: LocalizeOptions | None = None) -> None:
        """Look through the bag.

        Raises:
            BagError: it lacks what localisation needs.
            RobotModelError: its robot description cannot be used.
        """
        self._bag = bag
        self._options = options or LocalizeOptions()
        self.inputs: LocalizeInputs = find_localize_inputs(bag, self._options)
        self.localisations: list[Localisation] = []
        self.refused: Counter[str] = Counter()
        self.without_motion: Counter[str] = Counter()
        self.seconds = self.seconds_locating = 0.0
        self._motion = KinematicMotion(self._options.odometry)
        self._posture: RobotPosture | None = None
        self._localizer: Localizer | None = None
        self._recorder = TrajectoryRecorder()
        self._blind: list[FramedView] = []
        self._waiting: WaitingQueue[FramedView] = WaitingQueue(
            self._odometry_at, self._options.waiting, self._note_blind
        )

    def run(self, progress: Progress | None = None) -> None:
        """Read the whole bag; one thread reads and rectifies, this one locates.

        Args:
            progress: told after every view.

        Raises:
            BagError: the camera was never located; says why.
        """
        start = time.perf_counter()
        records = self._bag.records(self.inputs.topics)
        with closing(in_background(measure_all(records, self.inputs.source))) as entries:
            for entry in entries:
                self._take(entry)
                if progress is not None and isinstance(entry, FramedView):
                    progress(len(self.localisations), self.inputs.frames)
        self._locate_ready(2**63 - 1)
        self.seconds = time.perf_counter() - start
        if not len(self.trajectory):
            raise BagError(f"the camera was never located: {self._why_never()}")

    @property
    def trajectory(self) -> Trajectory:
        """The camera's poses as they were known at their stamps."""
        return self._recorder.known_then()

    @property
    def corrected_trajectory(self) -> Trajectory:
        """The camera's poses after all that was learnt later."""
        return self._recorder.known_now()

    def _take(self, entry: BagRecord | FramedView) -> None:
        if isinstance(entry, FramedView):
            self._waiting.push(entry.stamp, entry)
        elif self.inputs.motion is not None:
            try:
                self.inputs.motion.add(entry.record)
            except InfomapError as error:
                self.refused[str(error)] += 1
        self._locate_ready()

    def _locate_ready(self, now: int | None = None) -> None:
        """Locate the views whose odometry is known, and those for which it never will be."""
        ready = [view for view, _ in self._waiting.take(now)]
        blind, self._blind = self._blind, []
        for view in sorted([*ready, *blind], key=lambda one: one.stamp):
            self._locate(view, has_motion=view in ready)

    def _odometry_at(self, stamp: int) -> PoseRecord:
        """Whether the robot's posture is known at a time; see `WaitingQueue`."""
        motion = self.inputs.motion
        pose = np.eye(4) if motion is None else motion.posture(stamp).T_odom_camera
        return PoseRecord(stamp, "odom", pose)

    def _note_blind(self, view: FramedView, reason: str) -> None:
        self.without_motion[reason] += 1
        self._blind.append(view)

    def _locate(self, framed: FramedView, has_motion: bool) -> None:
        prior = self._prior(framed.stamp, has_motion)
        start = time.perf_counter()
        if self._localizer is None:
            self._localizer = self._begin(framed)
        try:
            body = self._body(framed.stamp) if has_motion else []
            result = self._localizer.locate(framed.view, prior, body=body)
        except InfomapError as error:
            self.refused[str(error)] += 1
            return
        self.seconds_locating += time.perf_counter() - start
        self.localisations.append(result)
        if result.T_map_camera is not None and result.covariance is not None:
            kept = self._localizer.keyframes()
            self._recorder.add(result.stamp, result.T_map_camera, result.covariance, kept)

    def _prior(self, stamp: int, has_motion: bool) -> MotionPrior | None:
        """The expected motion since the view before; None where odometry does not tell."""
        before, self._posture = self._posture, None
        if self.inputs.motion is None or not has_motion:
            return None
        self._posture = self.inputs.motion.posture(stamp)
        return None if before is None else self._motion.between(before, self._posture)

    def _body(self, stamp: int) -> list[PlacedSolid]:
        return [] if self.inputs.motion is None else self.inputs.motion.body(stamp)

    def _begin(self, framed: FramedView) -> Localizer:
        """A localizer whose map is the target's frame, or odometry's, or level by assumption."""
        start = looking_along_x(self._options.input.start_tilt)
        if self._posture is not None:
            start = self._posture.T_odom_camera
        detector = make_detector(self._options.target)
        return Localizer(framed.view.camera, self._options.localizer, detector, start)

    def _why_never(self) -> str:
        reasons = Counter(one.reason for one in self.localisations) + self.refused
        reasons += self.inputs.source.dropped
        listed = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common(3))
        return listed or "the bag has no views"

    def summary(self) -> dict[str, int | float | str]:
        """Figures of the run, flat; ``dropped: <reason>`` counts images."""
        states = Counter(one.state for one in self.localisations)
        trajectory = self.trajectory
        steps = np.diff(trajectory.transforms[:, :3, 3], axis=0)
        last = trajectory.covariances[-1] if len(trajectory) else np.full((6, 6), np.nan)
        figures: dict[str, int | float | str] = {
            "views": len(self.localisations),
            "poses": len(trajectory),
            "tracking": states["tracking"],
            "coasting": states["coasting"],
            "lost": states["lost"],
            "searching": states["searching"],
            "keyframes": sum(one.is_keyframe for one in self.localisations),
            "target_sightings": sum(one.target_seen for one in self.localisations),
            "mean_fiducials": round(_mean([o.tracked for o in self.localisations]), 1),
            "path_length": round(float(np.linalg.norm(steps, axis=1).sum()), 4),
            "final_position_sigma": round(float(np.sqrt(np.trace(last[:3, :3]))), 6),
            "final_rotation_sigma": round(float(np.sqrt(np.trace(last[3:, 3:]))), 6),
            "image_topic": self.inputs.source.image_topic,
            "odometry_topic": self.inputs.odometry_topic,
            "camera_frame": self.inputs.camera_frame,
            "views_without_odometry": sum(self.without_motion.values()),
            "records_refused": sum(self.refused.values()),
            "images_dropped": sum(self.inputs.source.dropped.values()),
            "messages_skipped": sum(self._bag.skipped.values()),
            "bag_problems": len(self._bag.problems),
            "seconds": round(self.seconds, 3),
            "seconds_locating": round(self.seconds_locating, 3),
        }
        dropped = self.inputs.source.dropped
        return figures | {f"dropped: {reason}": count for reason, count in dropped.items()}


def looking_along_x(tilt: float) -> FloatArray:
    """Optical frame at the origin of a level map, looking along x and down by `tilt` [rad].

    Returns:
        ``T_map_camera``, shape (4, 4).
    """
    down = Rotation.from_euler("y", tilt).as_matrix()
    return make_transform(down @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 0.0])


def _mean(values: list[int]) -> float:
    return float(np.mean(values)) if values else 0.0
