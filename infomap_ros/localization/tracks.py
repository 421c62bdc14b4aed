"""What the tracker remembers of each fiducial."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray


@dataclass(eq=False)
class Tracks:
    """Fiducials that are followed, one row each.

    Attributes:
        ids: shape (N,).
        pixels: where they were last seen, shape (N, 2) [px].
        missed: images since they were last seen, shape (N,).
        templates: what they look like, shape (N, P, P).
        warps: offsets in the image from offsets in the template, shape (N, 2, 2).
        creep: variance of the pixel by which the template's centre is off the point that was first
            chosen, shape (N,) [px^2]; grows when a template is renewed.
        descriptors: for finding them after a large step, shape (N, D).
    """

    ids: NDArray[np.int64]
    pixels: FloatArray
    missed: NDArray[np.int64]
    templates: NDArray[np.float32]
    warps: FloatArray
    creep: FloatArray
    descriptors: NDArray[np.generic]

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, mask: NDArray[np.bool_]) -> Tracks:
        """Some of the rows."""
        return Tracks(*(getattr(self, field.name)[mask] for field in dataclasses.fields(self)))

    def joined(self, other: Tracks) -> Tracks:
        """The rows of both."""
        if len(self) == 0:
            return other
        names = [field.name for field in dataclasses.fields(self)]
        return Tracks(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in names))


def new_tracks(
    ids: NDArray[np.int64],
    pixels: FloatArray,
    templates: NDArray[np.float32],
    descriptors: NDArray[np.generic],
) -> Tracks:
    """Tracks of fiducials that were just chosen."""
    count = len(ids)
    return Tracks(
        ids,
        pixels,
        np.zeros(count, np.int64),
        templates,
        np.tile(np.eye(2), (count, 1, 1)),
        np.zeros(count),
        descriptors,
    )
