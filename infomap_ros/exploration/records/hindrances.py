"""What stood in a run's way, in words: what ruled views out, and what went wrong."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

from infomap_ros.exploration.records.log_records import Message
from infomap_ros.exploration.records.recorded_run import RecordedRun
from infomap_ros.views.decision import count_reasons

_TOLD = 3


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
    common = count_reasons(reasons).most_common(_TOLD)
    return "; ".join(f"{reason} ({count})" for reason, count in common)
