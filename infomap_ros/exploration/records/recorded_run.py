"""A whole run log, read back."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from infomap_ros.errors import CalibrationError, RunLogError
from infomap_ros.exploration.records.run_log import (
    Candidate,
    Decision,
    End,
    Message,
    Motion,
    Progress,
    Record,
    Start,
)
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray

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
    def views(self) -> int:
        """How many views were taken."""
        looks = sum(motion.action == "look" and not motion.outcome for motion in self.of(Motion))
        return max(looks, *(record.views for record in self.of(Progress)[-1:]), 0)

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


Fields = Mapping[str, Any]


def parse_record(fields: object) -> Record:
    """Make a record of a decoded line.

    Raises:
        RunLogError: the line lacks a field or holds what does not belong there; names the field.
    """
    if not isinstance(fields, Mapping):
        raise RunLogError("is not a JSON object")
    kind = fields.get("kind")
    parser = _PARSERS.get(kind) if isinstance(kind, str) else None
    if parser is None:
        raise RunLogError(f"kind {kind!r} is not one of {', '.join(_PARSERS)}")
    return parser(_number(fields, "t"), fields)


def _start(time: float, fields: Fields) -> Start:
    return Start(
        time,
        _mapping(fields, "task"),
        _text(fields, "robot", ""),
        _text(fields, "world", ""),
        _text(fields, "strategy", ""),
        _number(fields, "voxel_size", math.nan),
        _camera(fields.get("camera")),
        _number(fields, "max_range", math.nan),
        _clock(fields),
    )


def _progress(time: float, fields: Fields) -> Progress:
    return Progress(
        time,
        _count(fields, "views"),
        _number(fields, "distance"),
        _number(fields, "known_fraction"),
        _number(fields, "entropy_bits"),
        _number(fields, "mean_sigma"),
        _count(fields, "surface_voxels"),
        _count(fields, "known_voxels"),
        _number(fields, "precise_fraction"),
        _text(fields, "state", ""),
    )


def _decision(time: float, fields: Fields) -> Decision:
    pose = None if fields.get("pose") is None else _vector(fields, "pose", 16).reshape(4, 4)
    listed = fields.get("candidates", ())
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise RunLogError("'candidates' is not a list")
    candidates = tuple(_candidate(entry) for entry in listed)
    rejections = dict(Counter(c.rejection for c in candidates if c.rejection))
    if "rejections" in fields:
        counted = _mapping(fields, "rejections")
        rejections = {reason: _count(counted, reason) for reason in counted}
    possible = sum(not candidate.rejection for candidate in candidates)
    least = possible + sum(rejections.values())
    return Decision(
        time,
        _count(fields, "view"),
        pose,
        None if fields.get("base") is None else _vector(fields, "base", 3),
        _text(fields, "strategy", ""),
        _number(fields, "rating", math.nan),
        _numbers(fields, "terms"),
        _text(fields, "reason", ""),
        _numbers(fields, "seconds"),
        candidates,
        _count(fields, "considered") if "considered" in fields else least,
        rejections,
        _number(fields, "position_sigma", math.nan),
        _clock(fields),
        _text(fields, "surface", ""),
    )


def _candidate(fields: object) -> Candidate:
    if not isinstance(fields, Mapping):
        raise RunLogError("a candidate is not a JSON object")
    direction = _vector(fields, "direction", 3)
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise RunLogError("'direction' of a candidate has no length")
    return Candidate(
        _vector(fields, "position", 3),
        direction / length,
        _number(fields, "rating", math.nan),
        _numbers(fields, "terms"),
        _text(fields, "rejection", ""),
    )


def _motion(time: float, fields: Fields) -> Motion:
    try:
        path = np.array(fields.get("path") or np.empty((0, 3)), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RunLogError("'path' is not a list of points") from error
    if path.ndim != 2 or path.shape[1] != 3 or not np.isfinite(path).all():
        raise RunLogError("'path' is not a list of points [x, y, z]")
    action, outcome = _text(fields, "action"), _text(fields, "outcome", "")
    return Motion(time, action, outcome, path, _clock(fields))


def _message(time: float, fields: Fields) -> Message:
    return Message(time, _text(fields, "text"), _text(fields, "level", "info"))


def _end(time: float, fields: Fields) -> End:
    return End(time, _text(fields, "reason"), _text(fields, "detail", ""))


_PARSERS: dict[str, Callable[[float, Fields], Record]] = {
    "start": _start,
    "progress": _progress,
    "decision": _decision,
    "motion": _motion,
    "message": _message,
    "end": _end,
}


def _clock(fields: Fields) -> float:
    return _number(fields, "clock", math.nan)


def _camera(value: object) -> PinholeCamera | None:
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise RunLogError("'camera' is not a JSON object")
    try:
        return PinholeCamera(
            _count(value, "width"),
            _count(value, "height"),
            *(_number(value, name) for name in ("fx", "fy", "cx", "cy")),
        )
    except CalibrationError as error:
        raise RunLogError(f"'camera': {error}") from error


def _value(fields: Fields, name: str) -> object:
    if name not in fields:
        raise RunLogError(f"lacks '{name}'")
    return fields[name]


def _number(fields: Fields, name: str, default: float | None = None) -> float:
    value = _value(fields, name) if default is None else fields.get(name, default)
    if value is None:  # JSON has no NaN
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RunLogError(f"'{name}' is {_short(value)}, expected a number")
    return float(value)


def _count(fields: Fields, name: str) -> int:
    value = _value(fields, name)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise RunLogError(f"'{name}' is {_short(value)}, expected a whole number")
    return value


def _text(fields: Fields, name: str, default: str | None = None) -> str:
    value = _value(fields, name) if default is None else fields.get(name, default)
    if not isinstance(value, str):
        raise RunLogError(f"'{name}' is {_short(value)}, expected text")
    return value


def _mapping(fields: Fields, name: str) -> Fields:
    value = fields.get(name, {})
    if not isinstance(value, Mapping):
        raise RunLogError(f"'{name}' is {_short(value)}, expected a JSON object")
    return value


def _numbers(fields: Fields, name: str) -> dict[str, float]:
    values = _mapping(fields, name)
    return {key: _number(values, key) for key in values}


def _vector(fields: Fields, name: str, length: int) -> FloatArray:
    value = _value(fields, name)
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RunLogError(f"'{name}' is {_short(value)}, expected numbers") from error
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise RunLogError(f"'{name}' is {_short(value)}, expected {length} finite numbers")
    return vector


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
