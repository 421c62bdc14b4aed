"""What stood in a run's way, in words: what ruled views out, and what went wrong."""

from __future__ import annotations

import re
from collections import Counter

from infomap_ros.exploration.records.log_records import Message
from infomap_ros.exploration.records.recorded_run import RecordedRun

_TOLD = 3


def hindrance_figures(run: RecordedRun) -> dict[str, str]:
    """The commonest reasons of a run with their counts, flat; what there was none of is left out.

    `ruled_out` counts candidates of all decisions, `went_wrong` motions and looks that ended early
    or failed, by the messages of the log. Reasons that differ in nothing but numbers count as one,
    by the text of the first.
    """
    ruled_out, went_wrong = Reasons(), Reasons()
    for step in run.steps:
        for reason, count in step.decision.rejections.items():
            ruled_out.add(reason, count)
    for message in run.of(Message):
        went_wrong.add(message.text)
    found = {"ruled_out": ruled_out.text, "went_wrong": went_wrong.text}
    return {name: text for name, text in found.items() if text}


class Reasons:
    """Counts reasons that differ in nothing but numbers as one."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._first: dict[str, str] = {}

    def add(self, reason: str, count: int = 1) -> None:
        """Count a reason."""
        kind = re.sub(r"[-+]?\d[\d.]*", "#", reason)
        self._counts[self._first.setdefault(kind, reason)] += count

    @property
    def text(self) -> str:
        """The commonest with their counts, the commonest first; empty for none."""
        common = self._counts.most_common(_TOLD)
        return "; ".join(f"{reason} ({count})" for reason, count in common)
