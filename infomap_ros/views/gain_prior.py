"""What share of what a view could tell it has told.

A stereo camera that looks into the sky, or at a wall closer than it can match, is told nothing, and
the map goes on promising as much. What the map has gained by a view, against what the view still
promises, says how far views of its kind are to be trusted; see `views.ranking.terms.Repetition`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


class GainPrior:
    """The shares of the views that were taken, in their order.

    Attributes:
        shares: of each view, 0 to 1; NaN where it is not known.
    """

    def __init__(self) -> None:
        self.shares: list[float] = []
        self._entropy = math.nan

    def note(self, left: Sequence[float], entropy: float) -> None:
        """Count views since the last call; of several it is not known which has told what.

        Args:
            left: what each of them is still expected to tell, oldest first [bits]; NaN for one
                that was wanted, and the robot looked from beside it.
            entropy: of the region of the task with them [bits].
        """
        told = max(self._entropy - entropy, 0.0)
        self._entropy = entropy
        taken = [each for each in left if not math.isnan(each)]
        known = len(taken) == 1 and told + taken[0] > 0.0
        self.shares += [told / (told + each) if known else math.nan for each in left]
