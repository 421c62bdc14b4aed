"""What the tracker remembers of each fiducial."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray


@dataclass(eq=False)
class Tracks:
    """Fiducials that are followed, one row each.

    Attributes:
        ids: shape (N,).
        pixels: where they were last seen, shape (N, 2) [px].
        flowed: where flow has followed them to, seen or not, shape (N, 2) [px].
        followed: whether flow has followed them to the last image, shape (N,), bool.
        missed: images since they were last seen, shape (N,).
        templates: what they look like, with a margin, shape (N, Q, Q).
        warps: offsets in the image from offsets in the template, shape (N, 2, 2).
        creep: variance of the pixel by which the template's center is off the point that was first
            chosen, shape (N,) [px^2]; grows when a template is renewed.
        inverse_depths: 1/z where the template was cut, shape (N,) [1/m]; NaN = unknown.
        descriptors: for finding them after a large step, shape (N, D).
    """

    ids: NDArray[np.int64]
    pixels: FloatArray
    flowed: FloatArray
    followed: NDArray[np.bool_]
    missed: NDArray[np.int64]
    templates: NDArray[np.float32]
    warps: FloatArray
    creep: FloatArray
    inverse_depths: FloatArray
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, mask: NDArray[np.bool_] | NDArray[np.int64]) -> Tracks:
        """Some of the rows, by a mask, shape (N,), or by their numbers, shape (M,)."""
        return Tracks(*(getattr(self, field.name)[mask] for field in dataclasses.fields(self)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The columns by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def joined(self, other: Tracks) -> Tracks:
        """The rows of both."""
        names = [field.name for field in dataclasses.fields(self)]
        return Tracks(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in names))


def new_tracks(
    ids: NDArray[np.int64],
    pixels: FloatArray,
    templates: NDArray[np.float32],
    inverse_depths: FloatArray,
    descriptors: NDArray[np.uint8],
) -> Tracks:
    """Tracks of fiducials that were just chosen."""
    count = len(ids)
    return Tracks(
        ids,
        pixels,
        pixels.copy(),
        np.ones(count, np.bool_),
        np.zeros(count, np.int64),
        templates,
        np.tile(np.eye(2), (count, 1, 1)),
        np.zeros(count),
        inverse_depths,
        descriptors,
    )


def tracks_from_arrays(arrays: Mapping[str, NDArray[Any]], like: Tracks) -> Tracks:
    """Tracks from `Tracks.arrays`.

    Args:
        arrays: columns by name.
        like: whose types and sizes they must have.

    Raises:
        InvalidInputError: a column is missing, or has another size or length; names it.
    """
    columns = {}
    for name, model in like.arrays().items():
        if name not in arrays:
            raise InvalidInputError(name, "is missing")
        column = np.asarray(arrays[name])
        expected = (len(arrays["ids"]), *model.shape[1:])
        if column.shape != expected or column.dtype != model.dtype:
            raise InvalidInputError(
                name, f"is {column.dtype} {column.shape}, expected {model.dtype} {expected}"
            )
        columns[name] = column.copy()
    return Tracks(**columns)
