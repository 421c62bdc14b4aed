"""A recorded bag becomes a map."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

from infomap_ros.errors import BagError, CapacityError
from infomap_ros.geometry import Record
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.pipeline import Fused, Fusion, Localization, Located, Pipeline
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizer
from infomap_ros.replay.bags.background import in_background
from infomap_ros.replay.bags.reader import Recording
from infomap_ros.replay.localize_run import (
    LocalizationLog,
    make_localization,
    records_of,
)
from infomap_ros.replay.map_inputs import (
    MapInputs,
    MapOptions,
    find_inputs,
    fitted_to_scene,
    localize_options,
)

_LIKELY_CAUSES = {
    "match density": "the rows of the two images do not agree (calibration, --rectify yes or no, "
    "left and right swapped), or there is too little texture",
    "gap between poses": "poses are rarer than --set poses.max_gap=",
    "has no place in": "no transform leads from the frame of the pose to the camera: record "
    "/tf_static, or name the camera's own frame with --pose-frame",
    "without its partner": "the stamps of left and right image differ by more than "
    "--set input.pairing_tolerance=",
    "no camera info": "images have no camera info: name it with --left-info, --right-info or "
    "--info",
    "after the last pose": "poses and images have different clocks, or the poses end before the "
    "images",
    "before the first pose": "poses and images have different clocks, or the images begin before "
    "the poses",
    "no pose": "the poses begin after the images or end before them",
    "joint": "joint states are missing at the images' stamps: --set input.remove_body=false "
    "maps without them",
}
"""What a reason for dropping a frame usually comes from, by words in it."""

Progress = Callable[[int, int], None]
"""Told how many of how many frames are done."""

Records = Callable[[Recording, MapInputs], Iterator[tuple[str, Record]]]
"""Those of a part of a bag with their topics, in order of time."""


class MapRun:
    """Maps a bag, frame by frame as its records come.

    Attributes:
        name: of the bag.
        inputs: what the bag offers.
        options: its settings, with the sizes that the scene needs.
        fitted: whether the map's range and voxels were made as large as the scene needs.
        builder: of the map.
        log: how the camera was located, empty where the bag tells its poses.
        frames: number of frames that are in the map.
        points: number of points that are in the map.
        points_beyond: number of points that were too far for it.
        dropped: frames that are not, by reason.
        first: the first measurement in the map.
        T_map_camera: pose of the camera at the newest frame, shape (4, 4); None before the first.
        camera_path: positions of the camera at the frames in the map, (x, y, z) each [m].
        assumed: covariance of poses that have none.
        seconds: how long `run` took [s].
        stopped: whether it was asked to end before the bag does.
        full: why the map could not take more, empty while it could.
    """

    def __init__(
        self, bag: Recording, options: MapOptions | None = None, part: Records | None = None
    ) -> None:
        """Look through the bag.

        Args:
            bag: to be mapped.
            options: all settings.
            part: of the bag, in which there need be no frame; all where not given.

        Raises:
            BagError: it lacks what mapping needs.
            RobotModelError: its robot description cannot be used.
        """
        self._bag, self.name, self._part = bag, bag.path.resolve().name, part
        given = options or MapOptions()
        settings = fitted_to_scene(bag, given)
        self.fitted = settings is not given
        self.options = replace(settings, input=replace(settings.input, fit_scene=False))
        self.inputs: MapInputs = find_inputs(bag, settings)
        self.log = LocalizationLog()
        self.frames = self.points = self.points_beyond = 0
        self.dropped: Counter[str] = Counter()
        self.first: RangeMeasurement | None = None
        self.camera_path: list[FloatArray] = []
        self.T_map_camera: FloatArray | None = None
        self.assumed = settings.assumed
        self.seconds, self.full, self.stopped = 0.0, "", False
        localization = self._make_localization(settings)
        store = settings.scans if localization is not None else None
        self.builder = MapBuilder(VoxelMap(settings.map), store, settings.body, settings.assumed)
        self._pipeline = Pipeline(localization, self._make_fusion(settings))

    def _make_localization(self, options: MapOptions) -> Localization | None:
        if self.inputs.located is None:
            return None
        views: Counter[str] = Counter()  # their clouds are counted
        return make_localization(self.inputs.located, localize_options(options), views, views)

    def _make_fusion(self, options: MapOptions) -> Fusion:
        inputs = self.inputs
        scans: ScanSynchronizer[RangeMeasurement] = ScanSynchronizer(
            inputs.poses,
            inputs.body,
            waiting=options.waiting,
            on_drop=self._on_drop,
        )
        return Fusion(scans, inputs.body, self.builder)

    @property
    def map(self) -> VoxelMap:
        """The voxel map."""
        return self.builder.map

    @property
    def refused(self) -> Counter[str]:
        """Records that could not be used, by reason."""
        return self._pipeline.refused

    def stop(self) -> None:
        """Let `run` end after the record it is at, with the map of what it has read."""
        self.stopped = True

    def run(self, progress: Progress | None = None) -> None:
        """Read the whole bag.

        One thread reads and measures range, this one locates and fuses: both let go of the
        interpreter where the work is.

        Args:
            progress: told after every frame.

        Raises:
            BagError: no frame could be mapped; says why.
            CapacityError: the first frame is too large for the map's memory limit.
        """
        start = time.perf_counter()
        try:
            for done in self.results():
                self._note(done)
                if progress is not None and isinstance(done, Fused):
                    progress(self.frames + sum(self.dropped.values()), self.inputs.frames)
        except CapacityError as error:
            self.full = str(error)
        self._finish()
        self.seconds = time.perf_counter() - start

    def results(self) -> Iterator[Located | Fused]:
        """What becomes of the bag's records, one after the other.

        Raises:
            CapacityError: a frame does not fit into the map's memory limit.
        """
        records = self._part or (lambda bag, inputs: records_of(bag, inputs.topics))
        seen = self.inputs.perception.see(records(self._bag, self.inputs))
        with closing(in_background(seen)) as items:
            for item in items:
                yield from self._pipeline.process(item)
                if self.stopped:
                    break
        yield from self._pipeline.finish()

    def _note(self, done: Located | Fused) -> None:
        self.log.add(done)
        if isinstance(done, Fused):
            self.frames += 1
            self.points += done.report.points_used
            self.points_beyond += done.report.points_out_of_range
            self.first = self.first or done.scan.cloud
            self.T_map_camera = done.scan.pose.transform
            self.camera_path.append(self.T_map_camera[:3, 3])

    def _on_drop(self, reason: str, sentence: str) -> None:
        self.dropped[sentence if reason == "robot description" else reason] += 1

    def _finish(self) -> None:
        """Count everything that was dropped on the way."""
        self.dropped.update(self.inputs.perception.dropped)
        if self._part is None:
            self.check_frames()

    def check_frames(self) -> None:
        """Raise what `run` raises where no frame could be mapped."""
        if self.frames == 0 and self.full:
            raise CapacityError(f"not one frame fits: {self.full}")
        if self.frames == 0:
            if self.stopped:
                raise BagError("interrupted before the first frame was mapped")
            reasons = self.dropped + self.refused
            why = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common(3))
            cause = self.why_mostly_dropped().partition(". Likely")[2]
            hint = f". Likely{cause}" if cause else ""
            raise BagError(f"no frame could be mapped: {why or 'the bag has none'}{hint}")

    def why_mostly_dropped(self) -> str:
        """Where more frames were dropped than mapped, why, with the likely cause; else empty."""
        count = sum(self.dropped.values())
        if count <= self.frames:
            return ""
        reason = self.dropped.most_common(1)[0][0]
        cause = next((cause for key, cause in _LIKELY_CAUSES.items() if key in reason), "")
        text = f"{count} of {count + self.frames} frames dropped, mostly: {reason}"
        return f"{text}. Likely cause: {cause}" if cause else text

    def summary(self) -> dict[str, int | float | str]:
        """Figures of the run, flat; ``dropped: <reason>`` counts frames."""
        figures: dict[str, int | float | str] = {
            "frames": self.frames,
            "points": self.points,
            "known_voxels": self.map.known_voxels,
            "surface_voxels": self.map.surface_voxels,
            "seconds": round(self.seconds, 3),
            "memory_bytes": self.map.memory_bytes(),
            "interrupted": int(self.stopped),
            "frames_dropped": sum(self.dropped.values()),
            "voxel_size": self.map.config.voxel_size,
            "max_range": self.map.config.max_range,
            "map_frame": self.inputs.map_frame,
            "range_topic": self.inputs.perception.sources.images[0],
            "pose_topic": self.inputs.pose_topic or "(localization)",
            "assumed_poses": self.builder.assumed_poses,
            "poses_refused": sum(self.refused.values()),
            "body_points_dropped": self.builder.points_cut,
            "messages_skipped": sum(self._bag.skipped.values()),
            "bag_problems": len(self._bag.problems),
        }
        if self.log.localizations:
            located = self.log.figures()
            names = ("tracking", "coasting", "lost", "keyframes", "path_length")
            figures |= {f"localization_{name}": located[name] for name in names}
            figures["corrections"] = self.builder.corrections
        figures |= {f"dropped: {reason}": count for reason, count in self.dropped.items()}
        return figures
