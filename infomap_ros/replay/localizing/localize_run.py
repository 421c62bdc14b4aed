"""A recorded bag becomes a trajectory."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import chain, takewhile

from infomap_ros.errors import BagError
from infomap_ros.geometry import Record
from infomap_ros.localization.filter.motion_prior import KinematicMotion
from infomap_ros.localization.target.config import make_detector
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, CameraLocalizerConfig
from infomap_ros.pipeline.pipeline import Localization, Pipeline
from infomap_ros.pipeline.view_estimator import FramedView
from infomap_ros.pipeline.view_synchronizer import ViewSynchronizer
from infomap_ros.replay.bags.background import in_background
from infomap_ros.replay.bags.reader import Recording
from infomap_ros.replay.localizing.localization_log import LocalizationLog
from infomap_ros.replay.localizing.localize_inputs import (
    LocalizeInputs,
    LocalizeOptions,
    find_localize_inputs,
)

Progress = Callable[[int, int], None]
"""Told how many of how many views are done."""


class LocalizeRun:
    """Follows the camera through a bag, view by view as its records come.

    Attributes:
        inputs: what the bag offers.
        log: what became of each view.
        dropped: views before the first odometry, where that is wanted, by reason.
        without_motion: views for which odometry was wanted and not known, by reason.
        seconds: how long `run` took [s].
        stopped: whether it was asked to end before the bag does.
    """

    def __init__(self, bag: Recording, options: LocalizeOptions | None = None) -> None:
        """Look through the bag.

        Raises:
            BagError: it lacks what localization needs.
            RobotModelError: its robot description cannot be used.
        """
        self._bag, settings = bag, options or LocalizeOptions()
        self.inputs: LocalizeInputs = find_localize_inputs(bag, settings)
        self.log = LocalizationLog()
        self.dropped: Counter[str] = Counter()
        self.without_motion: Counter[str] = Counter()
        self.seconds, self.stopped = 0.0, False
        localization = make_localization(self.inputs, settings, self.dropped, self.without_motion)
        self._pipeline = Pipeline(localization, None)

    @property
    def refused(self) -> Counter[str]:
        """Records that could not be used, by reason."""
        return self._pipeline.refused

    def stop(self) -> None:
        """Let `run` end after the record it is at, with the trajectory of what it has read."""
        self.stopped = True

    def run(self, progress: Progress | None = None) -> None:
        """Read the whole bag; one thread reads and rectifies, this one locates.

        Args:
            progress: told after every view.

        Raises:
            BagError: the camera was never located; says why.
        """
        start = time.perf_counter()
        seen = self.inputs.perception.see(records_of(self._bag, self.inputs.topics))
        with closing(in_background(seen)) as items:
            wanted = takewhile(lambda _: not self.stopped, items)
            work = chain.from_iterable(self._pipeline.process(item) for item in wanted)
            for done in chain(work, self._pipeline.finish()):
                self.log.add(done)
                if progress is not None:
                    progress(len(self.log.localizations), self.inputs.frames)
        self.seconds = time.perf_counter() - start
        if not len(self.log.trajectory):
            if self.stopped:
                raise BagError("interrupted before the camera was located")
            raise BagError(f"the camera was never located: {self._why_never()}")

    def _why_never(self) -> str:
        reasons = Counter(one.reason for one in self.log.localizations) + self.refused
        reasons += self.inputs.perception.dropped + self.dropped
        listed = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common(3))
        return listed or "the bag has no views"

    def summary(self) -> dict[str, int | float | str]:
        """Figures of the run, flat; ``dropped: <reason>`` counts images."""
        dropped = self.inputs.perception.dropped + self.dropped
        figures = self.log.figures() | {
            "image_topic": self.inputs.perception.sources.images[0],
            "odometry_topic": self.inputs.odometry_topic,
            "camera_frame": self.inputs.camera_frame,
            "views_without_odometry": sum(self.without_motion.values()),
            "records_refused": sum(self.refused.values()),
            "interrupted": int(self.stopped),
            "images_dropped": sum(dropped.values()),
            "messages_skipped": sum(self._bag.skipped.values()),
            "bag_problems": len(self._bag.problems),
            "seconds": round(self.seconds, 3),
        }
        return figures | {f"dropped: {reason}": count for reason, count in dropped.items()}


def records_of(bag: Recording, topics: tuple[str, ...]) -> Iterator[tuple[str, Record]]:
    """Records of a bag with their topics, in order of time."""
    return ((entry.topic, entry.record) for entry in bag.records(topics))


def make_localization(
    inputs: LocalizeInputs,
    options: LocalizeOptions,
    dropped: Counter[str],
    without_motion: Counter[str],
) -> Localization:
    """What locates the camera of a bag.

    Args:
        inputs: what the bag offers.
        options: how it is used.
        dropped: counts views that are not located, by reason.
        without_motion: counts views that are located without odometry, by reason.
    """
    views: ViewSynchronizer[FramedView] = ViewSynchronizer(
        inputs.motion,
        waiting=options.waiting,
        on_drop=lambda reason, _: dropped.update([reason]),
        on_unknown_motion=lambda reason: without_motion.update([reason]),
    )
    motion, detector = KinematicMotion(options.odometry), make_detector(options.target)
    config = CameraLocalizerConfig(options.localizer, motion, detector, options.input.start_tilt)
    return Localization(views, inputs.motion, CameraLocalizer(config))
