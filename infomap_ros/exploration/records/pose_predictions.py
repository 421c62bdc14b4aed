"""What was predicted of the pose's uncertainty at chosen views, and what it was on arrival."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from infomap_ros.exploration.records.recorded_run import RecordedRun

_TERM = "localization_error"


@dataclass(frozen=True)
class PosePrediction:
    """Position sigmas (roots of the trace) of a view that was taken.

    Attributes:
        before: when the view was chosen [m].
        predicted: for the arrival [m].
        arrived: at the next choice, after the look [m].
    """

    before: float
    predicted: float
    arrived: float


def pose_predictions(run: RecordedRun) -> list[PosePrediction]:
    """Of all views of a run that were taken and after which another choice was made.

    The log tells both numbers: each decision has the sigma at which it was made and the growth that
    was predicted for the chosen view; the next decision has the sigma on arrival.
    """
    found = []
    for step, later in pairwise(run.steps):
        before, arrived = step.decision.position_sigma, later.decision.position_sigma
        predicted = before + step.decision.terms.get(_TERM, np.nan)
        if step.taken and np.isfinite([predicted, arrived]).all():
            found.append(PosePrediction(before, predicted, arrived))
    return found


def prediction_figures(run: RecordedRun) -> dict[str, float]:
    """Medians of the prediction and of the ratio arrived / predicted, flat; empty without any."""
    sigmas = pose_predictions(run)
    if not sigmas:
        return {}
    predicted = np.array([each.predicted for each in sigmas])
    arrived = np.array([each.arrived for each in sigmas])
    ratios = arrived / np.maximum(predicted, 1e-9)
    return {
        "predicted_sigmas": len(sigmas),
        "predicted_sigma_median": round(float(np.median(predicted)), 6),
        "arrived_sigma_median": round(float(np.median(arrived)), 6),
        "arrived_over_predicted_median": round(float(np.median(ratios)), 3),
    }
