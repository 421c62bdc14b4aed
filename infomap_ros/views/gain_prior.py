"""What share of what a view could tell it has told.

A stereo camera that looks into the sky, or at a wall closer than it can match, is told nothing, and
the map goes on promising as much of that view as before. What the map has gained by a view, against
what the view still promises, says how far views of its kind are to be trusted, wherever they look;
`views.ranking.terms.Repetition` takes off what they are not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infomap_ros.geometry.transforms import FloatArray


class GainPrior:
    """The shares of the views that were taken, in their order."""

    def __init__(self) -> None:
        self._shares: list[float] = []
        self._entropy = float("nan")

    def note(self, left: Sequence[float], entropy: float) -> None:
        """Count views taken since the last call.

        Where they are several, it is not known which has told what, and the share of none is known.

        Args:
            left: what each of them is still expected to tell, oldest first [bits].
            entropy: of the region of the task with them [bits].
        """
        told = max(self._entropy - entropy, 0.0)
        self._entropy = entropy
        share = float("nan")
        if len(left) == 1 and told + left[0] > 0.0:
            share = told / (told + left[0])
        self._shares += [share] * len(left)

    @property
    def shares(self) -> FloatArray:
        """Of each view, shape (V,), 0 to 1; NaN where it is not known."""
        return np.array(self._shares)
