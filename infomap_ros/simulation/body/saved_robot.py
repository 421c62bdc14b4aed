"""A simulated robot that was switched off, in a file: it goes on from where it stood."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from infomap_ros.errors import SimulationError
from infomap_ros.geometry.atomic_file import MALFORMED, write_json
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class SavedRobot:
    """What is left of a robot when its power goes: where all is, and what it had counted.

    Attributes:
        seconds: simulated time [s].
        contacts: forbidden contacts so far.
        body: arrays of `RobotBody.state`.
        odometry: arrays of `WheelOdometry.state`.
        world: in which it stands, as whoever saves it calls it.
    """

    seconds: float
    contacts: int
    body: Mapping[str, FloatArray]
    odometry: Mapping[str, FloatArray]
    world: str = ""

    def save(self, path: Path) -> None:
        """Write it to a file, atomically.

        Raises:
            SimulationError: the file cannot be written.
        """
        content = {
            "seconds": self.seconds,
            "contacts": self.contacts,
            "body": _lists(self.body),
            "odometry": _lists(self.odometry),
            "world": self.world,
        }
        try:
            write_json(path, content)
        except OSError as error:
            raise SimulationError(f"cannot write robot file {path}: {error.strerror}") from error

    @classmethod
    def load(cls, path: Path) -> SavedRobot:
        """Read what `save` wrote.

        Raises:
            SimulationError: the file is missing or malformed, or a number in it is not finite.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            saved = cls(
                float(content["seconds"]),
                int(content["contacts"]),
                _arrays(content["body"]),
                _arrays(content["odometry"]),
                str(content["world"]),
            )
        except (OSError, *MALFORMED) as error:
            raise SimulationError(f"robot file {path}: {error!r}") from error
        numbers = [np.array(saved.seconds), *saved.body.values(), *saved.odometry.values()]
        if not all(np.isfinite(each).all() for each in numbers) or saved.seconds < 0.0:
            raise SimulationError(f"robot file {path}: holds impossible numbers")
        return saved


def _lists(arrays: Mapping[str, FloatArray]) -> dict[str, object]:
    return {name: np.asarray(array).tolist() for name, array in arrays.items()}


def _arrays(content: Mapping[str, object]) -> dict[str, FloatArray]:
    return {name: np.array(rows, dtype=np.float64) for name, rows in content.items()}
