"""A whole run log, read back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from infomap_ros.exploration.records.log_parsing import RunLogError, parse_record
from infomap_ros.exploration.records.log_records import (
    Decision,
    End,
    Motion,
    Record,
    Start,
)

RUN_ENDED = "planned next (run ended)"
"""What came of the last choice, where the run ended before it was carried out."""

_Kind = TypeVar("_Kind", bound=Record)


@dataclass(frozen=True)
class Step:
    """A decision and what came of it.

    Attributes:
        decision: the choice.
        motions: that followed before the next decision.
        outcome: "taken", "no view", `RUN_ENDED`, or why the robot did not get there
            or see.
    """

    decision: Decision
    motions: tuple[Motion, ...]
    outcome: str

    @property
    def taken(self) -> bool:
        """Whether the robot looked from there."""
        return self.outcome == "taken"


@dataclass(frozen=True)
class RecordedRun:
    """What a run log tells.

    Attributes:
        records: in the order of the log; at least one is a `Start`, the first.
        problems: lines that could not be used, with their number and the reason.
    """

    records: tuple[Record, ...]
    problems: tuple[str, ...]

    def of(self, kind: type[_Kind]) -> tuple[_Kind, ...]:
        """The records of one kind, in their order."""
        return tuple(record for record in self.records if isinstance(record, kind))

    @property
    def start(self) -> Start:
        """What the run was asked to do; the last time, where it was continued."""
        return self.of(Start)[-1]

    @property
    def end(self) -> End | None:
        """Why it ended; None where the log does not say."""
        last = [record for record in self.records if isinstance(record, Start | End)][-1]
        return last if isinstance(last, End) else None

    @property
    def seconds(self) -> float:
        """Time of the last record [s]."""
        return max(record.time for record in self.records)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """The decisions with what came of each."""
        places = [i for i, record in enumerate(self.records) if isinstance(record, Decision)]
        ends = [*places[1:], len(self.records)][: len(places)]
        return tuple(_step(self.records[a:b]) for a, b in zip(places, ends, strict=True))


def read_run(path: str | Path) -> RecordedRun:
    """Read a run log.

    Lines that cannot be used, such as a last one that was cut off, are left out and named in
    ``problems``.

    Raises:
        RunLogError: the file is not a run log: it cannot be read, is empty, or does not begin
            with ``start``; names the line and the reason.
    """
    records: list[Record] = []
    problems: list[str] = []
    for number, line in enumerate(_lines(Path(path)), start=1):
        try:
            records.append(_parse_line(line))
        except RunLogError as error:
            problems.append(f"line {number}: {error}")
        if not records:
            raise RunLogError(f"{path} is not a run log: {problems[0]}")
        if not isinstance(records[0], Start):
            raise RunLogError(f"{path} is not a run log: line 1: its kind is not 'start'")
    if not records:
        raise RunLogError(f"{path} is not a run log: it is empty")
    return RecordedRun(tuple(records), tuple(problems))


def _lines(path: Path) -> list[bytes]:
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise RunLogError(f"{path} cannot be read: {error.strerror}") from error
    return lines if lines[-1] else lines[:-1]


def _parse_line(line: bytes) -> Record:
    try:
        fields = json.loads(line.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise RunLogError("is not text") from error
    except (ValueError, RecursionError) as error:
        cut = line.startswith(b"{") and not line.rstrip().endswith(b"}")
        raise RunLogError("is cut off" if cut else "is not JSON") from error
    return parse_record(fields)


def _step(records: Sequence[Record]) -> Step:
    decision = records[0]
    assert isinstance(decision, Decision)
    motions = tuple(record for record in records if isinstance(record, Motion))
    failures = [f"{m.action}: {m.outcome}" for m in motions if m.outcome]
    looked = any(m.action == "look" and not m.outcome for m in motions)
    if decision.pose is None:
        outcome = "no view"
    elif failures and not looked:
        outcome = failures[-1]
    else:
        outcome = "taken" if looked else RUN_ENDED
    return Step(decision, motions, outcome)
