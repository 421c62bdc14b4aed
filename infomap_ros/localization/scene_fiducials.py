"""The scene's fiducials as the filter knows them and as the tracker sees them, kept in step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import (
    PinholeCamera,
    invert_transform,
    transform_points,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations, no_observations
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.fiducials.selection import select_fiducials
from infomap_ros.localization.fiducials.tracker import FiducialTracker
from infomap_ros.localization.fiducials.tracks import (
    look_the_same,
    moved_viewpoint,
    turns_since,
    viewpoint,
)
from infomap_ros.localization.filter.config import Fiducials, FilterUpdate
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localized_camera import Choice
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.scene_tags import SceneTags
from infomap_ros.mapping.scans.body import body_mask

_SEEN_THROUGH = 3  # contradictions in a row after which a fiducial is given up
_SAME_RANGE = 0.1  # share by which something that hides a fiducial is nearer
_STILL = 0.3  # [px]
_BORDER = 12.0  # [px] within which a fiducial need not be seen


class SceneFiducials:
    """Names, follows, finds again and gives up the fiducials of a filter.

    Args:
        camera: that sees them.
        config: how many are wanted.
        pose_filter: knows where they are.
        tags: of the scene.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        config: LocalizerConfig,
        pose_filter: FiducialFilter,
        tags: SceneTags,
    ) -> None:
        self._camera, self._config, self._filter = camera, config, pose_filter
        self._tags = tags
        self._tracker = FiducialTracker()
        self._next = 0
        self._contradicted: dict[int, int] = {}  # times in a row
        self._seen_from: dict[int, FloatArray] = {}  # the camera's viewpoint
        self._at_update: dict[int, FloatArray] = {}  # pixels in the last update

    def clear(self) -> None:
        """Forget all; the filter is left as it is."""
        self._tracker = FiducialTracker()
        self._contradicted.clear()
        self._seen_from.clear()
        self._at_update.clear()

    def follow(self, view: RangeView, T_map_camera: FloatArray | None) -> FiducialObservations:
        """Find the followed fiducials in the next view.

        Args:
            view: the next one.
            T_map_camera: where the camera is expected, shape (4, 4); None where it may be
                anywhere near.
        """
        expected: Mapping[int, FloatArray] | None = None
        if T_map_camera is not None:
            known = self._filter.fiducials()
            followed = np.isin(known.ids, self._tracker.ids)
            expected = self._pixels_by_id(known, followed, T_map_camera)
        return joined(self._tracker.track(view, expected), self._tags.observe(view))

    def recall(
        self, view: RangeView, T_map_camera: FloatArray, radius: float
    ) -> FiducialObservations:
        """Find again what ought to be in view but is not followed.

        Args:
            view: that was tracked last.
            T_map_camera: where the camera is, shape (4, 4).
            radius: how far from its expected place a fiducial may be [px].
        """
        known = self._filter.fiducials()
        missing = self.expected_in_view(known, T_map_camera)
        missing &= ~np.isin(known.ids, self._tracker.ids)
        if not missing.any():
            return no_observations()
        pixels = self._pixels_by_id(known, missing, T_map_camera)
        return self._tracker.recall(view, pixels, radius, self._turns(known, missing, T_map_camera))

    def recall_anywhere(self, view: RangeView) -> FiducialObservations:
        """Find again what is not followed, wherever it may be."""
        return self._tracker.recall(view)

    def expected_in_view(self, known: Fiducials, T_map_camera: FloatArray) -> NDArray[np.bool_]:
        """Which fiducials lie within the image of a camera, shape (N,)."""
        pixels = self._project(known.positions, T_map_camera)
        size = np.array([self._camera.width, self._camera.height])
        with np.errstate(invalid="ignore"):
            inside = (pixels >= _BORDER) & (pixels <= size - 1.0 - _BORDER)
        return np.asarray(inside.all(axis=1))

    def ought_to_be_seen(
        self, view: RangeView, T_map_camera: FloatArray
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Fiducials that would be found in a view if the camera were at a pose.

        Those that lie within the image where a range is measured, and look as they did when they
        were seen before.

        Args:
            view: the last one.
            T_map_camera: shape (4, 4).

        Returns:
            Their ids, shape (N,), and whether something that is nearer may hide them, shape (N,).
        """
        known = self._filter.fiducials()
        rows = np.flatnonzero(self.expected_in_view(known, T_map_camera))
        rows = rows[[int(number) in self._seen_from for number in known.ids[rows]]]
        if not len(rows):
            return np.zeros(0, np.int64), np.zeros(0, np.bool_)
        positions = known.positions[rows]
        before = np.stack([self._seen_from[int(number)] for number in known.ids[rows]])
        similar = look_the_same(positions, before, T_map_camera)
        inside = transform_points(invert_transform(T_map_camera), positions)
        measured = view.inverse_depths(self._camera.project(inside))[0]
        chosen = similar & np.isfinite(measured)
        hidden = measured[chosen] * inside[chosen, 2] > 1.0 + _SAME_RANGE
        return known.ids[rows][chosen], hidden

    def set_aside(self, ids: NDArray[np.int64] | None = None) -> None:
        """Follow these, or all, no longer; they may be recalled."""
        self._tracker.set_aside(self._tracker.ids if ids is None else ids)

    def stands_still(self, seen: FiducialObservations, prior: MotionPrior | None) -> bool:
        """Whether the camera is where it was when the filter was last updated.

        A view from the same place has the same errors: counting it again would make the pose too
        certain. It is taken to be the same place when no motion is expected and the fiducials are
        where they were.

        Args:
            seen: in the new view.
            prior: of the motion, None where nothing is expected.
        """
        if prior is not None and not prior.is_rest:
            return False
        shifts = [
            np.abs(pixel - self._at_update[number]).max()
            for number, pixel in zip(seen.ids.tolist(), seen.pixels, strict=True)
            if number in self._at_update
        ]
        if len(shifts) < self._config.filter.min_fiducials:
            return False
        return bool(np.quantile(shifts, 0.7) < _STILL)

    def shows_enough(self, view: RangeView) -> bool:
        """Whether a view has texture and range to choose as many fiducials as are needed."""
        wanted = self._config.fewest_fiducials
        nothing = np.zeros((0, 2))
        return len(select_fiducials(view, nothing, wanted, config=self._config.selection)) >= wanted

    def note(self, seen: FiducialObservations, update: FilterUpdate) -> None:
        """Remember an update, and give up what contradicts the others again and again."""
        self._at_update = dict(zip(seen.ids.tolist(), seen.pixels, strict=True))
        place = viewpoint(self._filter.pose[0])
        for number in update.used.tolist():
            self._contradicted.pop(number, None)
            if number >= 0:
                self._seen_from[number] = place
        for number in update.rejected.tolist():
            self._contradicted[number] = self._contradicted.get(number, 0) + 1
        bad = [n for n, count in self._contradicted.items() if count >= _SEEN_THROUGH]
        self._give_up(np.array(bad, np.int64))

    def replenish(
        self,
        view: RangeView,
        count: int,
        chosen: Choice,
    ) -> int:
        """Choose new fiducials and tell the filter where they are, and where new tags are.

        Args:
            view: that was tracked last.
            count: most new fiducials.
            chosen: what decides on them.

        Returns:
            Number of new fiducials.
        """
        known = self._filter.fiducials().ids
        for ids, points, covariance, in_map in self._tags.unknown(view, known):
            if in_map or self._is_of_scene(points, chosen).all():
                self._filter.add_landmarks(ids, points, covariance, in_map=in_map)
        added = self._choose(view, count, chosen) if count else np.zeros(0, np.int64)
        forgotten = np.setdiff1d(known, self._filter.fiducials().ids)
        self._tracker.remove(forgotten)
        for number in forgotten.tolist():
            self._seen_from.pop(number, None)
        self._seen_from.update(dict.fromkeys(added.tolist(), viewpoint(self._filter.pose[0])))
        return len(added)

    def _choose(self, view: RangeView, count: int, chosen: Choice) -> NDArray[np.int64]:
        voxel_map, T_map_camera = chosen.voxel_map, self._filter.pose[0]
        pose = None if voxel_map is None else T_map_camera
        pixels = select_fiducials(
            view, self._tracker.pixels, count, voxel_map, pose, self._config.selection
        )
        ids = np.arange(self._next, self._next + len(pixels))
        self._next += len(pixels)
        seen = self._tracker.add(view, ids, pixels)
        seen = seen.select(self._is_of_scene(seen.points(self._camera), chosen))
        added = self._filter.add(seen)
        self._tracker.remove(np.setdiff1d(ids, added))
        return added

    def _is_of_scene(self, points: FloatArray, chosen: Choice) -> NDArray[np.bool_]:
        """Which points in the camera frame are on no robot, shape (N,)."""
        free = np.ones(len(points), bool)
        bodies = (chosen.body, np.eye(4), True), (chosen.others, self._filter.pose[0], False)
        for solids, frame, own in bodies:
            if len(solids):
                placed = transform_points(frame, points)
                free &= ~body_mask(placed, None, solids, self._config.body, rays=own)
        return free

    def move(self, T_new_old: FloatArray) -> None:
        """The map's frame was put elsewhere, shape (4, 4)."""
        self._seen_from = {
            name: moved_viewpoint(T_new_old, seen) for name, seen in self._seen_from.items()
        }

    def state(self) -> dict[str, NDArray[Any]]:
        """All that it knows beside the filter, as arrays for a file."""
        places = list(self._seen_from.values())
        own = {
            "scene_next": np.array(self._next),
            "scene_ids": np.array(list(self._seen_from), np.int64),
            "scene_viewpoints": np.array(places).reshape(-1, 2, 3),
        }
        return own | {f"tracker_{name}": array for name, array in self._tracker.state().items()}

    def resume(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on with the fiducials of another one's `state`; none is followed at first.

        Raises:
            InvalidInputError: an array is missing or does not fit the configuration.
        """
        self.clear()
        tracker = {
            name.removeprefix("tracker_"): array
            for name, array in state.items()
            if name.startswith("tracker_")
        }
        self._tracker = FiducialTracker.from_state(tracker)
        self._next = int(state["scene_next"])
        places = zip(state["scene_ids"].tolist(), state["scene_viewpoints"], strict=True)
        self._seen_from = dict(places)

    def _give_up(self, ids: NDArray[np.int64]) -> None:
        if len(ids):
            self._tracker.remove(ids)
            self._filter.remove(ids)
            for number in ids.tolist():
                self._contradicted.pop(number, None)
                self._seen_from.pop(number, None)

    def _pixels_by_id(
        self, known: Fiducials, chosen: NDArray[np.bool_], T_map_camera: FloatArray
    ) -> Mapping[int, FloatArray]:
        pixels = self._project(known.positions[chosen], T_map_camera)
        return dict(zip(known.ids[chosen].tolist(), pixels, strict=True))

    def _turns(
        self, known: Fiducials, chosen: NDArray[np.bool_], T_map_camera: FloatArray
    ) -> Mapping[int, float]:
        """By how much fiducials look turned since they were last seen, by id [rad]."""
        chosen = chosen & np.isin(known.ids, list(self._seen_from))
        ids = known.ids[chosen].tolist()
        before = np.array([self._seen_from[number] for number in ids]).reshape(-1, 2, 3)
        turns = turns_since(known.positions[chosen], before, T_map_camera)
        return dict(zip(ids, turns.tolist(), strict=True))

    def _project(self, positions: FloatArray, T_map_camera: FloatArray) -> FloatArray:
        return self._camera.project(transform_points(invert_transform(T_map_camera), positions))


def joined(first: FiducialObservations, second: FiducialObservations) -> FiducialObservations:
    """Observations of one view put together."""
    names = ("ids", "pixels", "pixel_sigmas", "inverse_depths", "inverse_depth_sigmas")
    return FiducialObservations(
        *(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names)
    )
