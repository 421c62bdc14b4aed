"""Follows fiducials from view to view.

Fig. 9 of Sujan and Dubowsky (2005), "track fiducials": pyramidal optical flow with a
forward-backward check leads to the neighborhood, the alignment with a template to the pixel. The
template stays that of the view in which the fiducial was chosen, so that the pixel does not creep.
Only when the camera has come so near or gone so far that the template has to be stretched a lot is
it renewed, from a view in which it is well seen, and what that adds to the pixel's variance is
kept. A fiducial that no longer looks like its template is not seen. After a step that the flow
cannot follow, fiducials are found again by their descriptors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.appearance import describe, descriptor_size, find_again
from infomap_ros.localization.fiducials.dormant import (
    SIGMA_FACTOR,
    DormantFiducials,
    at_scale,
    believed,
)
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.patch_alignment import (
    MARGIN,
    Alignment,
    OpticalFlow,
    align_templates,
    cut_templates,
)
from infomap_ros.localization.fiducials.range_view import RangeView, check_pixels
from infomap_ros.localization.fiducials.tracks import Tracks, new_tracks, tracks_from_arrays

# Whole pixels that are searched where flow or a descriptor leads, not the last sight [px].
_FLOW_SEARCH = 2

# How much an image may be blurred against the templates (sigma) [px].
_BLURS = (0.0, 1.2, 2.0, 3.0)

_TEMPLATE = 15  # side of a fiducial's template, odd [px]
_GOOD_CORRELATION = 0.9  # with which it is well seen, and may give a new template
_MAX_WARP = 1.8  # factor of stretching or shrinking from which on a template is renewed
_SEARCH_RADIUS = 6  # about the predicted place of a fiducial that flow has lost [px]
_MAX_MISSED_VIEWS = 5  # in a row, after which a fiducial is given up
_LARGE_STEP = 0.5  # share of fiducials that flow may lose before descriptors are compared
# Where a smaller share of what flow has found is well seen, the image is taken to be blurred.
_SHARP_SHARE = 0.7
_SIGMA_FLOOR = 0.05  # of pixels [px]


class FiducialTracker:
    """Follows fiducials from view to view; see the module's head."""

    def __init__(self) -> None:
        self._flow = OpticalFlow()
        self._tracks = _no_tracks()
        self._dormant = DormantFiducials(self._tracks)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Fiducials that are followed, those missed in the last views included, shape (N,)."""
        return self._tracks.ids.copy()

    @property
    def pixels(self) -> FloatArray:
        """Where they were last seen, in the order of `ids`, shape (N, 2) [px]."""
        return self._tracks.pixels.copy()

    def add(self, view: RangeView, ids: ArrayLike, pixels: ArrayLike) -> FiducialObservations:
        """Follow new fiducials from now on.

        Args:
            view: the last one that was tracked, or the first.
            ids: shape (N,), not followed yet; a dormant one of that name is forgotten.
            pixels: where they are in `view`, shape (N, 2) [px].

        Returns:
            Their observations in `view`; those too near to the border are left out and not
            followed.

        Raises:
            InvalidInputError: shapes do not fit, or an id is followed already.
        """
        names = float_array(ids, "ids", np.int64).ravel()
        places = check_pixels(pixels)
        if len(names) != len(places):
            raise InvalidInputError("ids", f"{len(names)} for {len(places)} pixels")
        twice = np.intersect1d(names, self._tracks.ids)
        if len(twice) or len(np.unique(names)) < len(names):
            raise InvalidInputError("ids", f"{twice.tolist()} are followed already or given twice")
        added = self._chosen(view, names, places)
        self._dormant.forget(names)
        self._flow.remember(view.image)
        self._tracks = self._tracks.joined(added)
        return self._observe(view, added, np.zeros(len(added)))

    def track(
        self, view: RangeView, predicted: Mapping[int, ArrayLike] | None = None
    ) -> FiducialObservations:
        """Find the fiducials in the next view.

        Args:
            view: the next one.
            predicted: where fiducials are expected, (u, v) by id [px], as far as that is known;
                others are expected where they were.

        Returns:
            Those that are seen, with range where there is one.
        """
        tracks = self._tracks
        start, known = self._start(predicted)
        places, found = self._flow.follow(view.image, tracks.flowed, start)
        found &= tracks.followed
        places = np.where(found[:, None], places, start)
        search = np.where(found | ~known, 0, _SEARCH_RADIUS)
        search[found & (tracks.missed > 0)] = _FLOW_SEARCH
        self._recover(view, places, search, found)
        aligned, seen = self._align(view.image, places, search, found)
        tracks.flowed[:] = np.where(seen[:, None], aligned.pixels, places)
        tracks.followed[:] = seen | found
        self._note(view.image, aligned, seen)
        observations = self._observe(view, tracks.select(seen), aligned.sigmas[seen])
        _note_ranges(tracks, seen, observations.inverse_depths)
        self._rest(tracks.missed > _MAX_MISSED_VIEWS)
        return observations

    def recall(
        self,
        view: RangeView,
        predicted: Mapping[int, ArrayLike] | None = None,
        radius: float | None = None,
        turns: Mapping[int, float] | None = None,
    ) -> FiducialObservations:
        """Find dormant fiducials again, and follow them from now on.

        They are found by descriptor (within a few pixels of their expected place by template) and
        aligned with their own template, so that the pixel is that of the point first chosen.

        Args:
            view: the last one that was tracked.
            predicted: where they are expected, (u, v) by id [px]; only those named are looked for.
                None: all, anywhere in the image.
            radius: how far from there they may be [px]; goes with `predicted`.
            turns: by which they look turned against when they were last followed, from u towards
                v, by id [rad]; not at all where it is not said.

        Returns:
            Those that were found.

        Raises:
            InvalidInputError: a prediction comes without a radius or the other way round.
        """
        if (predicted is None) != (radius is None):
            raise InvalidInputError("radius", "and predicted must come together")
        if predicted is None or radius is None:
            found, sigmas = self._dormant.find_anywhere(view)
        else:
            found, sigmas = self._dormant.find_near(view, predicted, radius, turns)
        self._dormant.forget(found.ids)
        self._flow.remember(view.image)
        self._tracks = self._tracks.joined(found)
        return self._observe(view, found, sigmas)

    def set_aside(self, ids: ArrayLike) -> None:
        """Stop following fiducials, shape (N,), but keep them for `recall`."""
        self._rest(np.isin(self._tracks.ids, float_array(ids, "ids", np.int64)))

    def remove(self, ids: ArrayLike) -> None:
        """Forget fiducials, shape (N,), followed or dormant; those not known are ignored."""
        names = float_array(ids, "ids", np.int64)
        self._tracks = self._tracks.select(~np.isin(self._tracks.ids, names))
        self._dormant.forget(names)

    def state(self) -> dict[str, NDArray[Any]]:
        """All fiducials as named arrays, for a file; see `from_state`."""
        return self._tracks.joined(self._dormant.tracks).arrays()

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[Any]]) -> FiducialTracker:
        """A tracker that knows the fiducials of another; all are dormant.

        Args:
            state: made by `state`; templates and descriptors must have the same size.

        Raises:
            InvalidInputError: an array is missing or does not fit.
        """
        tracker = cls()
        tracker._dormant.add(tracks_from_arrays(state, like=tracker._tracks))
        return tracker

    def _rest(self, which: NDArray[np.bool_]) -> None:
        """Make fiducials dormant, shape (N,)."""
        self._dormant.add(self._tracks.select(which))
        self._tracks = self._tracks.select(~which)

    def _chosen(self, view: RangeView, ids: NDArray[np.int64], pixels: FloatArray) -> Tracks:
        """Tracks of the new fiducials whose template lies inside the image."""
        warps = np.tile(np.eye(2), (len(ids), 1, 1))
        templates, inside = cut_templates(view.image, pixels, warps, _TEMPLATE)
        descriptors = describe(view.image, pixels)
        inverse = view.inverse_depths(pixels)[0]
        return new_tracks(ids, pixels, templates, inverse, descriptors).select(inside)

    def _start(
        self, predicted: Mapping[int, ArrayLike] | None
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Where fiducials are expected, shape (N, 2), and whether that was said, shape (N,)."""
        start = self._tracks.flowed.copy()
        known = np.zeros(len(start), np.bool_)
        for row, name in enumerate(self._tracks.ids):
            place = None if predicted is None else predicted.get(int(name))
            if place is not None and np.isfinite(place).all():
                start[row], known[row] = place, True
        return start, known

    def _recover(
        self,
        view: RangeView,
        places: FloatArray,
        search: NDArray[np.int64],
        found: NDArray[np.bool_],
    ) -> None:
        """After a large step, look for what flow has lost by descriptors; in place."""
        lost = np.flatnonzero(~found)
        if len(lost) <= _LARGE_STEP * len(found):
            return
        again = find_again(view, self._tracks.descriptors[lost])
        rows = lost[again.indices]
        places[rows] = again.pixels
        search[rows] = _FLOW_SEARCH

    def _align(
        self,
        image: NDArray[np.uint8],
        places: FloatArray,
        search: NDArray[np.int64],
        found: NDArray[np.bool_],
    ) -> tuple[Alignment, NDArray[np.bool_]]:
        """Align with the templates; where few fit well, blurred ones may fit a blurred image.

        Returns:
            The alignment of all, and which of them are believed, shape (N,).
        """
        tracks = self._tracks
        best, most = None, -1
        for blur in _BLURS:
            aligned = align_templates(image, tracks.templates, places, tracks.warps, search, blur)
            fitting = int(np.count_nonzero(aligned.correlations >= _GOOD_CORRELATION))
            if best is None or fitting > most:
                best, most = aligned, fitting
            if most > _SHARP_SHARE * np.count_nonzero(found):
                break
        assert best is not None
        return best, believed(best, places, search)

    def _note(self, image: NDArray[np.uint8], aligned: Alignment, seen: NDArray[np.bool_]) -> None:
        """Keep where fiducials are; renew templates that are stretched a lot but well seen."""
        tracks = self._tracks
        tracks.missed[:] = np.where(seen, 0, tracks.missed + 1)
        tracks.pixels[seen] = aligned.pixels[seen]
        tracks.warps[seen] = aligned.warps[seen]
        stretch = np.abs(np.log(np.linalg.svd(tracks.warps, compute_uv=False))).max(axis=1)
        well = seen & (stretch > np.log(_MAX_WARP))
        well[seen] &= aligned.correlations[seen] >= _GOOD_CORRELATION
        upright = np.tile(np.eye(2), (int(well.sum()), 1, 1))
        patches, inside = cut_templates(image, tracks.pixels[well], upright, _TEMPLATE)
        rows = np.flatnonzero(well)[inside]
        tracks.templates[rows], tracks.warps[rows] = patches[inside], np.eye(2)
        tracks.descriptors[rows] = describe(image, tracks.pixels[rows])
        tracks.inverse_depths[rows] = np.nan
        tracks.creep[rows] += np.square(SIGMA_FACTOR * aligned.sigmas[rows])

    def _observe(self, view: RangeView, tracks: Tracks, noise: FloatArray) -> FiducialObservations:
        noise = at_scale(noise, tracks.warps)
        sigmas = np.sqrt(np.square(SIGMA_FACTOR * noise) + tracks.creep)
        inverse, spread = view.inverse_depths(tracks.pixels)
        return FiducialObservations(
            tracks.ids, tracks.pixels, np.maximum(sigmas, _SIGMA_FLOOR), inverse, spread
        )


def _note_ranges(tracks: Tracks, seen: NDArray[np.bool_], inverse_depths: FloatArray) -> None:
    """Where the range of a template is not known, it follows from one now and the warp since."""
    scale = np.sqrt(np.abs(np.linalg.det(tracks.warps[seen])))
    known = tracks.inverse_depths[seen]
    tracks.inverse_depths[seen] = np.where(np.isnan(known), inverse_depths / scale, known)


def _no_tracks() -> Tracks:
    nothing = np.zeros((0, 2))
    side = _TEMPLATE + 2 * MARGIN
    templates = np.zeros((0, side, side), np.float32)
    descriptors = np.zeros((0, descriptor_size()), np.uint8)
    return new_tracks(np.zeros(0, np.int64), nothing, templates, np.zeros(0), descriptors)
