"""Fiducials that are out of sight, and how they are found again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.appearance import AppearanceMatches, find_again
from infomap_ros.localization.fiducials.patch_alignment import Alignment, align_templates
from infomap_ros.localization.fiducials.range_view import RangeView, check_pixels
from infomap_ros.localization.fiducials.tracks import Tracks

# Descriptors find a corner near the fiducial, not the fiducial itself [px].
_DESCRIPTOR_SEARCH = 3
# Largest difference between the scale that descriptors and ranges tell, as a logarithm.
_SCALE_TOLERANCE = 0.5
# A template is not compared at a scale further off than this.
_LARGEST_SCALE = 3.0
SIGMA_FACTOR = 3.0
"""Calibrated multiple of the sigma that image noise leaves."""
_MIN_CORRELATION = 0.8  # normalized, of a fiducial with its template
_MAX_SHIFT = 3.0  # by which flow and template may disagree about where a fiducial is [px]
_MAX_SIGMA = 0.7  # pixels less certain than this are not believed: they slide along edges [px]
# Likewise of those found again: of those less certain every third was another thing [px].
_MAX_RECALLED_SIGMA = 0.3
# A dormant fiducial that is expected within this is searched for by its template, otherwise by its
# descriptor [px].
_DIRECT_RADIUS = 12.0


class DormantFiducials:
    """Keeps fiducials that are not followed.

    Attributes:
        tracks: the fiducials.
    """

    def __init__(self, nothing: Tracks) -> None:
        """Begin with `nothing`, tracks of no fiducials."""
        self.tracks = nothing

    def add(self, tracks: Tracks) -> None:
        """Keep fiducials; older ones of the same names are forgotten."""
        self.forget(tracks.ids)
        self.tracks = self.tracks.joined(tracks)

    def forget(self, ids: NDArray[np.int64]) -> None:
        """Drop fiducials, shape (N,)."""
        self.tracks = self.tracks.select(~np.isin(self.tracks.ids, ids))

    def find_anywhere(self, view: RangeView) -> tuple[Tracks, FloatArray]:
        """Look for all of them in the whole image.

        Returns:
            The tracks of those found, as of this view, and the sigmas that image noise leaves,
            shape (M,) [px].
        """
        rows = np.arange(len(self.tracks))
        found = find_again(view, self.tracks.descriptors)
        return self._verified(view, rows, np.zeros(len(rows)), found)

    def find_near(
        self,
        view: RangeView,
        predicted: Mapping[int, ArrayLike],
        radius: float,
        turns: Mapping[int, float] | None = None,
    ) -> tuple[Tracks, FloatArray]:
        """Look for some of them where they are expected; see `find_anywhere`.

        Args:
            view: where to look.
            predicted: (u, v) by id [px].
            radius: how far from there they may be [px].
            turns: by which they look turned against when they were last followed, from u towards
                v, by id [rad]; not at all where it is not said.
        """
        rows = np.flatnonzero(np.isin(self.tracks.ids, list(predicted)))
        expected = [np.asarray(predicted[name]) for name in self.tracks.ids[rows].tolist()]
        places = check_pixels(np.array(expected), "predicted")
        finite = np.isfinite(places).all(axis=1)
        rows, places = rows[finite], places[finite]
        since = [(turns or {}).get(name, 0.0) for name in self.tracks.ids[rows].tolist()]
        angles = _turn_of(self.tracks.warps[rows]) + np.array(since)
        if radius <= _DIRECT_RADIUS:
            return self._aligned(view, rows, places, angles, int(np.ceil(radius)))
        descriptors = self.tracks.descriptors[rows]
        found = find_again(view, descriptors, places, radius, angles)
        return self._verified(view, rows, angles, found)

    def _verified(
        self, view: RangeView, rows: NDArray[np.int64], angles: FloatArray, found: AppearanceMatches
    ) -> tuple[Tracks, FloatArray]:
        """Align what descriptors have found, if it is as much nearer or farther as it looks."""
        rows, angles = rows[found.indices], angles[found.indices]
        scale = self._scale(view, rows, found.pixels)
        fits = ~(np.abs(np.log(scale / found.scales)) > _SCALE_TOLERANCE)
        return self._aligned(view, rows[fits], found.pixels[fits], angles[fits], _DESCRIPTOR_SEARCH)

    def _scale(self, view: RangeView, rows: NDArray[np.int64], places: FloatArray) -> FloatArray:
        """How much nearer the camera is now by the ranges, shape (M,); NaN without a range."""
        inverse = view.inverse_depths(places)[0]
        near = np.where(inverse > 0.0, inverse, np.nan)
        return np.asarray(near / self.tracks.inverse_depths[rows])

    def _aligned(
        self,
        view: RangeView,
        rows: NDArray[np.int64],
        places: FloatArray,
        angles: FloatArray,
        reach: int,
    ) -> tuple[Tracks, FloatArray]:
        """Align with the templates, turned, and scaled by how much nearer the camera is now."""
        tracks = self.tracks.select(rows)
        scale = self._scale(view, rows, places)
        scale = np.where(scale > 0.0, scale, 1.0)
        scale = np.clip(scale, 1.0 / _LARGEST_SCALE, _LARGEST_SCALE)
        search = np.full(len(rows), reach)
        warps = scale[:, None, None] * _turned(angles)
        aligned = align_templates(view.image, tracks.templates, places, warps, search)
        seen = aligned._replace(sigmas=at_scale(aligned.sigmas, aligned.warps))
        found = believed(seen, places, search, _MAX_RECALLED_SIGMA)
        tracks.pixels[:], tracks.warps[:] = aligned.pixels, aligned.warps
        tracks.flowed[:], tracks.followed[:], tracks.missed[:] = aligned.pixels, True, 0
        return tracks.select(found), aligned.sigmas[found]


def _turn_of(warps: FloatArray) -> FloatArray:
    """By how much warps turn, from u towards v, shape (N,) [rad]."""
    turn, shear = warps[:, 1, 0] - warps[:, 0, 1], warps[:, 0, 0] + warps[:, 1, 1]
    return np.asarray(np.arctan2(turn, shear))


def _turned(angles: FloatArray) -> FloatArray:
    """Warps that only turn, shape (N, 2, 2)."""
    c, s = np.cos(angles), np.sin(angles)
    return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)


def at_scale(sigmas: FloatArray, warps: FloatArray) -> FloatArray:
    """Sigmas of templates, shape (N,), that are seen from elsewhere, through warps (N, 2, 2).

    From farther away a template covers fewer pixels, and fits as much worse.
    """
    scale = np.sqrt(np.abs(np.linalg.det(warps)))
    return np.asarray(sigmas / np.clip(scale, 1.0 / _LARGEST_SCALE, 1.0))


def believed(
    aligned: Alignment,
    places: FloatArray,
    search: NDArray[np.int64],
    max_sigma: float = _MAX_SIGMA,
) -> NDArray[np.bool_]:
    """Which alignments are believed, shape (N,).

    Args:
        aligned: N alignments.
        places: where they were expected, shape (N, 2) [px].
        search: whole pixels that were searched about them, shape (N,).
        max_sigma: largest sigma [px].
    """
    allowed = _MAX_SHIFT + np.sqrt(2.0) * search
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(aligned.pixels - places, axis=1) <= allowed
        sharp = SIGMA_FACTOR * aligned.sigmas <= max_sigma
    return np.asarray(near & sharp & (aligned.correlations >= _MIN_CORRELATION))
