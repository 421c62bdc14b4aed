"""Keeps the file with what is left of a simulated robot, and lets it go on from there."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

from infomap_ros.errors import SimulationError
from infomap_ros.simulation.body.saved_robot import SavedRobot
from infomap_ros.simulation.simulator import Simulator

_PERIOD = 1.0  # [s] of simulated time between two saves


class RobotAccount:
    """The file of one robot.

    Args:
        simulator: the robot.
        path: the file; empty for none.
        world: description of the world; a robot of another one is not resumed.
    """

    def __init__(self, simulator: Simulator, path: str, world: str) -> None:
        self._simulator = simulator
        self._path = Path(path).absolute() if path else None
        self._world = hashlib.sha256(world.encode()).hexdigest()
        self._due = 0.0

    def resume(self) -> bool:
        """Go on from the file, where there is one; tells whether there was.

        Simulated time goes on later than it can have come to, so that it never goes back.

        Raises:
            SimulationError: the file cannot be used, or is of another world or robot.
        """
        if self._path is None or not self._path.exists():
            return False
        saved = SavedRobot.load(self._path)
        if saved.world != self._world:
            raise SimulationError(f"robot file {self._path} is of another world")
        self._simulator.resume(saved, off=2.0 * _PERIOD)
        return True

    def save_when_due(self) -> None:
        """Write the file, once per period.

        Raises:
            SimulationError: it cannot be written.
        """
        if self._path is None or self._simulator.time < self._due:
            return
        self._due = self._simulator.time + _PERIOD
        dataclasses.replace(self._simulator.saved, world=self._world).save(self._path)
