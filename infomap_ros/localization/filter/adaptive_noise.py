"""How much larger the errors of a camera's measurements are than their stated noise.

The stated sigmas are those of image and matching noise. Imperfect calibration, a rolling shutter or
the systematic error of a depth camera come on top and are not known beforehand, but show: fiducials
disagree by more than their sigmas. The sigmas are multiplied by a common factor that follows what
is seen (innovation-based adaptation: R. K. Mehra, IEEE Transactions on Automatic Control 17(5),
1972, doi:10.1109/TAC.1972.1100100), never below 1.
"""

from __future__ import annotations

from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.hypothesis_choice import AMBIGUITY, DISAGREEMENT, MINORITY
from infomap_ros.localization.filter.records import FilterUpdate

_DISAGREE = 1.2  # mean squared distance from which on the factor grows
_AGREE = 0.7  # below which it shrinks
_REJECTED = 0.2  # share of rejected fiducials from which on it grows
_GROWTH, _DECAY, _STEP = 1.2, 0.97, 2.0


class AdaptiveNoise:
    """Follows the factor.

    Attributes:
        factor: by which sigmas are multiplied.

    Args:
        largest: limit of the factor.
    """

    def __init__(self, largest: float) -> None:
        self._largest = largest
        self.factor = 1.0

    def applied(self, observations: FiducialObservations) -> FiducialObservations:
        """Observations with the sigmas that they are believed to have."""
        if self.factor == 1.0 or not len(observations):
            return observations
        return FiducialObservations(
            observations.ids,
            observations.pixels,
            observations.pixel_sigmas * self.factor,
            observations.inverse_depths,
            observations.inverse_depth_sigmas * self.factor,
        )

    def note(self, update: FilterUpdate) -> None:
        """Learn from a consistent update with the present factor."""
        mean = update.nis / max(update.degrees_of_freedom, 1)
        every = len(update.used) + len(update.rejected)
        rejected = len(update.rejected) / max(every, 1)
        if mean > _DISAGREE or rejected > _REJECTED:
            self.factor = min(self.factor * _GROWTH, self._largest)
        elif mean < _AGREE and rejected < 0.5 * _REJECTED:
            self.factor = max(self.factor * _DECAY, 1.0)

    def may_explain(self, reason: str) -> bool:
        """Whether larger sigmas may be why the filter has refused an image.

        Two groups that show different motions may be one group with a little more noise, but with
        much more noise everything would be one group.

        Args:
            reason: of `FilterUpdate`.
        """
        if reason == AMBIGUITY:
            return self.factor < _STEP
        return reason in (DISAGREEMENT, MINORITY)

    def grow(self) -> bool:
        """Try a clearly larger factor; False where the limit is reached."""
        if self.factor >= self._largest:
            return False
        self.factor = min(self.factor * _STEP, self._largest)
        return True
