"""What a robot did from one moment of a run to the next."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.exploration.records.log_records import Decision, Motion, Start
from infomap_ros.exploration.records.recorded_run import RecordedRun

CHOOSE, ARM, DRIVE, LOOK = "choose", "arm", "drive", "look"
ACTIVITIES = (CHOOSE, ARM, DRIVE, LOOK)
"""Kinds of activities; to choose includes to wait until what was seen is in the map."""

_OF_MOTIONS = {"look": LOOK, "last look": LOOK, "arm": ARM}


@dataclass(frozen=True)
class Activity:
    """A stretch of a run.

    Attributes:
        kind: one of `ACTIVITIES`.
        step: number of the decision that it belongs to, from 0; None before the first.
        begin: since the start of the run [s].
        end: likewise [s].
        clock_begin: of the robot [s]; NaN where the log does not tell.
        clock_end: likewise [s].
        problem: why it failed; empty where it did not.
    """

    kind: str
    step: int | None
    begin: float
    end: float
    clock_begin: float
    clock_end: float
    problem: str = ""

    @property
    def seconds(self) -> float:
        """How long it took [s]."""
        return max(0.0, self.end - self.begin)

    @property
    def clock_seconds(self) -> float:
        """How long it took by the robot's clock [s]; NaN where the log does not tell."""
        return max(self.clock_end - self.clock_begin, 0.0)


def activities(run: RecordedRun) -> list[Activity]:
    """Everything that the robot did, in its order, without gaps but where a run was continued.

    The log tells when a choice was made and when a motion ended; each has lasted since the one
    before.
    """
    found: list[Activity] = []
    step: int | None = None
    before: Start | Decision | Motion = run.of(Start)[0]
    for record in run.records:
        if isinstance(record, Decision):
            kind, problem, step = CHOOSE, "", 0 if step is None else step + 1
        elif isinstance(record, Motion):
            kind, problem = _OF_MOTIONS.get(record.action, DRIVE), record.outcome
        elif isinstance(record, Start):
            before = record
            continue
        else:
            continue
        times = before.time, record.time, before.clock, record.clock
        found.append(Activity(kind, step, *times, problem))
        before = record
    return found
