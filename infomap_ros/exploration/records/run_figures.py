"""Figures of a run by its log: the pose as predicted and on arrival, and what stood in the way."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from infomap_ros.exploration.records.recorded_run import RecordedRun
from infomap_ros.exploration.records.run_log import Message
from infomap_ros.views.decision import count_reasons

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


_LISTED = 3


def hindrance_figures(run: RecordedRun) -> dict[str, str]:
    """The commonest reasons of a run with their counts, flat; what there was none of is left out.

    `ruled_out` counts candidates of all decisions, `went_wrong` motions and looks that ended early
    or failed, by the messages of the log. Reasons that differ in nothing but numbers count as one,
    by the text of the first.
    """
    decisions = (step.decision.rejections.items() for step in run.steps)
    ruled_out = commonest(chain.from_iterable(decisions))
    went_wrong = commonest((message.text, 1) for message in run.of(Message))
    found = {"ruled_out": ruled_out, "went_wrong": went_wrong}
    return {name: text for name, text in found.items() if text}


def commonest(reasons: Iterable[tuple[str, int]]) -> str:
    """The commonest reasons with their counts, the commonest first; empty for none."""
    common = count_reasons(reasons).most_common(_LISTED)
    return "; ".join(f"{reason} ({count})" for reason, count in common)
