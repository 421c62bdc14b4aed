"""What a robot touches, and which of it it must not touch."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from infomap_ros.simulation.body.trial import TrialModel

import mujoco  # isort: skip  # after the backend has been chosen


_SAME_TOUCH = 1.0  # [s] within which a touch that comes again is the same


@dataclass(frozen=True)
class ContactEvent:
    """A forbidden touch, at its beginning.

    Attributes:
        time: from the start of the simulation [s].
        link: of the robot.
        other: body or thing that it touched.
        depth: how deep they were in each other [m].
        place: in the world [m].
    """

    time: float
    link: str
    other: str
    depth: float
    place: tuple[float, float, float]


class ContactMonitor:
    """Counts forbidden touches of one robot.

    Wheels and casters may touch the ground, and other things up to the height of a step above
    their lowest point; a wheel that touches a thing higher up has driven against it. Everything
    else must not be touched, nor links each other, nor other robots. What touches on and on
    counts once.

    Args:
        model: the compiled world.
        prefix: of the robot's names.
        trial: the robot, measured.
        casters: links that may touch the ground too.
        step_height: see above [m].
        teammates: names of the other robots.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        prefix: str,
        trial: TrialModel,
        casters: tuple[str, ...],
        step_height: float,
        teammates: Iterable[str] = (),
    ) -> None:
        self._model, self._prefix, self._step_height = model, prefix, step_height
        names = [model.body(index).name for index in range(model.nbody)]
        self._is_robot = np.array([name.startswith(prefix) for name in names])[model.geom_bodyid]
        others = tuple(f"{name}/" for name in teammates)
        self._is_teammate = np.array([n.startswith(others) for n in names])[model.geom_bodyid]
        radius = {prefix + wheel.body: wheel.radius for wheel in trial.wheels}
        radius |= dict.fromkeys((prefix + link for link in casters), np.inf)
        self._radius = np.array([radius.get(name, 0.0) for name in names])[model.geom_bodyid]
        self._ground = model.geom("ground").id
        self._last_touch: dict[tuple[int, int], float] = {}
        self.events: list[ContactEvent] = []

    def update(self, data: mujoco.MjData) -> None:
        """Look at the present contacts."""
        contacts = data.contact
        for index in range(data.ncon):
            first, second = contacts.geom[index]
            if not (self._is_robot[first] or self._is_robot[second]):
                continue
            if not self._is_robot[first] or self._radius[second] > 0.0:
                first, second = second, first
            place, depth = contacts.pos[index], -float(contacts.dist[index])
            if depth < 0.0 or self._may_touch(data, first, second, place):
                continue
            pair = (int(first), int(second))
            if data.time - self._last_touch.get(pair, -np.inf) > _SAME_TOUCH:
                self.events.append(self._event(data, pair, depth, place))
            self._last_touch[pair] = data.time

    def _may_touch(self, data: mujoco.MjData, first: int, second: int, place: np.ndarray) -> bool:
        radius = self._radius[first]
        if radius == 0.0 or self._is_robot[second] or self._is_teammate[second]:
            return False
        lowest = data.geom_xpos[first, 2] - radius
        return bool(second == self._ground or place[2] - lowest <= self._step_height)

    def _event(
        self, data: mujoco.MjData, pair: tuple[int, int], depth: float, place: np.ndarray
    ) -> ContactEvent:
        x, y, z = (float(value) for value in place)
        return ContactEvent(data.time, self._name(pair[0]), self._name(pair[1]), depth, (x, y, z))

    def _name(self, geom: int) -> str:
        body = self._model.body(int(self._model.geom_bodyid[geom])).name
        if self._is_robot[geom]:
            return str(body[len(self._prefix) :])
        return str(self._model.geom(geom).name or body)
