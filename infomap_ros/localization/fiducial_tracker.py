"""Follows fiducials from view to view.

Fig. 9 of Sujan and Dubowsky (2005), "track fiducials": pyramidal optical flow with a
forward-backward check leads to the neighbourhood, the alignment with a template to the pixel. The
template stays that of the view in which the fiducial was chosen, so that the pixel does not creep.
Only when the camera has come so near or gone so far that the template has to be stretched a lot is
it renewed, from a view in which it is well seen, and what that adds to the pixel's variance is
kept. A fiducial that no longer looks like its template is not seen. After a step that the flow
cannot follow, fiducials are found again by their descriptors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.appearance import AppearanceConfig, describe, find_again
from infomap_ros.localization.observations import FiducialObservations
from infomap_ros.localization.optical_flow import OpticalFlow, OpticalFlowConfig
from infomap_ros.localization.patch_alignment import Alignment, align_templates, cut_templates
from infomap_ros.localization.range_view import RangeView, check_pixels
from infomap_ros.localization.tracks import Tracks, new_tracks


@dataclass(frozen=True)
class FiducialTrackerConfig:
    """How fiducials are followed.

    Raises:
        ConfigError: a value is out of its range.
    """

    template: int = parameter(15, "Side of a fiducial's template, odd.", unit="px", low=7, high=41)
    min_correlation: float = parameter(
        0.8, "A fiducial must have this normalised correlation with its template.", low=0.3, high=1
    )
    good_correlation: float = parameter(
        0.9, "With this correlation it is well seen, and may give a new template.", low=0.3, high=1
    )
    max_shift: float = parameter(
        3.0,
        "Flow and template may disagree by this much about where a fiducial is.",
        unit="px",
        low=0.5,
        high=50.0,
    )
    max_sigma: float = parameter(
        0.3,
        "Fiducials whose pixel is less certain than this are not believed: they slide along edges.",
        unit="px",
        low=0.01,
        high=10.0,
    )
    max_warp: float = parameter(
        1.8,
        "A template is renewed when it has to be stretched or shrunk by more than this factor.",
        low=1.05,
        high=4.0,
    )
    search_radius: int = parameter(
        6,
        "How far about its predicted place a fiducial is searched for that flow has lost.",
        unit="px",
        low=0,
        high=30,
    )
    patience: int = parameter(
        5, "A fiducial that was not seen in more consecutive views is given up.", low=0, high=1000
    )
    large_step: float = parameter(
        0.5,
        "Share of fiducials that flow may lose before descriptors are compared.",
        low=0.0,
        high=1.0,
    )
    sigma_factor: float = parameter(
        3.0, "Calibrated multiple of the sigma that image noise leaves.", low=0.1, high=20.0
    )
    sigma_floor: float = parameter(
        0.05, "Pixel sigmas are never smaller.", unit="px", low=0.001, high=10.0
    )
    flow: OpticalFlowConfig = field(default_factory=OpticalFlowConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)

    def __post_init__(self) -> None:
        check_config(self)
        if self.template % 2 == 0:
            raise ConfigError("template", self.template, "an odd number")


class FiducialTracker:
    """Follows fiducials from view to view; see the module's head.

    Attributes:
        config: parameters.
    """

    def __init__(self, config: FiducialTrackerConfig | None = None) -> None:
        self.config = config or FiducialTrackerConfig()
        self._flow = OpticalFlow(self.config.flow)
        self._tracks = self._chosen(np.zeros((64, 64), np.uint8), [], [])

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
            ids: shape (N,), not followed yet.
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
        added = self._chosen(view.image, names, places)
        if len(self._tracks) == 0:
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
        places, found = self._flow.follow(view.image, tracks.pixels, start)
        found &= tracks.missed == 0
        places = np.where(found[:, None], places, start)
        search = np.where(found | ~known, 0, self.config.search_radius)
        self._recover(view, places, search, found)
        aligned = align_templates(view.image, tracks.templates, places, tracks.warps, search)
        seen = self._accept(aligned, places, search)
        self._note(view.image, aligned, seen)
        observations = self._observe(view, tracks.select(seen), aligned.sigmas[seen])
        self._tracks = tracks.select(tracks.missed <= self.config.patience)
        return observations

    def remove(self, ids: ArrayLike) -> None:
        """Stop following fiducials, shape (N,); those not followed are ignored."""
        names = float_array(ids, "ids", np.int64)
        self._tracks = self._tracks.select(~np.isin(self._tracks.ids, names))

    def _chosen(self, image: NDArray[np.uint8], ids: ArrayLike, pixels: ArrayLike) -> Tracks:
        """Tracks of the new fiducials whose template lies inside the image."""
        names, places = np.asarray(ids, np.int64), check_pixels(pixels)
        warps = np.tile(np.eye(2), (len(names), 1, 1))
        templates, inside = cut_templates(image, places, warps, self.config.template)
        descriptors = describe(image, places, self.config.appearance)
        return new_tracks(names, places, templates, descriptors).select(inside)

    def _start(
        self, predicted: Mapping[int, ArrayLike] | None
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Where fiducials are expected, shape (N, 2), and whether that was said, shape (N,)."""
        start = self._tracks.pixels.copy()
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
        if len(lost) <= self.config.large_step * len(found):
            return
        again = find_again(view, self._tracks.descriptors[lost], config=self.config.appearance)
        rows = lost[again.indices]
        places[rows] = again.pixels
        search[rows] = min(2, self.config.search_radius)

    def _accept(
        self, aligned: Alignment, places: FloatArray, search: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Which alignments are believed, shape (N,)."""
        config = self.config
        allowed = config.max_shift + np.sqrt(2.0) * search
        with np.errstate(invalid="ignore"):
            near = np.linalg.norm(aligned.pixels - places, axis=1) <= allowed
            sharp = config.sigma_factor * aligned.sigmas <= config.max_sigma
        return np.asarray(near & sharp & (aligned.correlations >= config.min_correlation))

    def _note(self, image: NDArray[np.uint8], aligned: Alignment, seen: NDArray[np.bool_]) -> None:
        """Keep where fiducials are; renew templates that are stretched a lot but well seen."""
        tracks, config = self._tracks, self.config
        tracks.missed[:] = np.where(seen, 0, tracks.missed + 1)
        tracks.pixels[seen] = aligned.pixels[seen]
        tracks.warps[seen] = aligned.warps[seen]
        stretch = np.abs(np.log(np.linalg.svd(tracks.warps, compute_uv=False))).max(axis=1)
        well = seen & (stretch > np.log(config.max_warp))
        well[seen] &= aligned.correlations[seen] >= config.good_correlation
        upright = np.tile(np.eye(2), (int(well.sum()), 1, 1))
        patches, inside = cut_templates(image, tracks.pixels[well], upright, config.template)
        rows = np.flatnonzero(well)[inside]
        tracks.templates[rows], tracks.warps[rows] = patches[inside], np.eye(2)
        tracks.creep[rows] += np.square(config.sigma_factor * aligned.sigmas[rows])

    def _observe(self, view: RangeView, tracks: Tracks, noise: FloatArray) -> FiducialObservations:
        config = self.config
        sigmas = np.sqrt(np.square(config.sigma_factor * noise) + tracks.creep)
        inverse, spread = view.inverse_depths(tracks.pixels)
        return FiducialObservations(
            tracks.ids, tracks.pixels, np.maximum(sigmas, config.sigma_floor), inverse, spread
        )
