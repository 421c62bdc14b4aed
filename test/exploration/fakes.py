"""A robot on paper and a planner with a script."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from infomap_ros.exploration.robot import (
    Choice,
    FailedView,
    Interrupted,
    KnownPlace,
    MapProgress,
    Motion,
    RobotState,
)
from infomap_ros.geometry import make_transform
from infomap_ros.motion.route import ArmPath, Route

JOINTS = ("pan", "tilt")


def progress(known: float = 0.5, sigma: float = 0.01, precise: float | None = None) -> MapProgress:
    """A share that is known; all of it precisely where not given."""
    precise = known if precise is None else precise
    return MapProgress(known, 1000.0 * (1.0 - known), sigma, 100, 1000, precise)


def pose_at(x: float, y: float) -> np.ndarray:
    return make_transform(np.eye(3), (x, y, 0.5))


def route_to(x: float, y: float = 0.0, start: Sequence[float] = (0.0, 0.0)) -> Route:
    """Fold the arm, drive straight, unfold."""
    arm = ArmPath(JOINTS, np.array([[0.0, 0.0], [0.5, 0.1]]), np.array([0.0, 1.0]))
    path = np.array([[*start, 0.0], [x, y, 0.0]])
    poses = np.stack([make_transform(np.eye(3), (px, py, 0.0)) for px, py, _ in path])
    return Route(arm, path, poses, arm, pose_at(x, y))


class FakeRobot:
    """Does what it is told; may fail, and may call a function while it moves."""

    def __init__(self) -> None:
        self.deeds: list[str] = []
        self.place = (0.0, 0.0)
        self.problems: dict[str, str] = {}
        self.during: Callable[[str], None] = lambda deed: None
        self.sigma = 0.001

    def state(self) -> RobotState:
        T_map_base = make_transform(np.eye(3), (*self.place, 0.0))
        return RobotState(
            T_map_base, pose_at(*self.place), self.sigma**2 * np.eye(6), dict.fromkeys(JOINTS, 0.0)
        )

    def look(self, interrupted: Interrupted) -> str:
        return self._do("look", interrupted)

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        return Motion(self._do("arm", interrupted))

    def drive(self, poses: np.ndarray, interrupted: Interrupted) -> Motion:
        start, problem = self.place, self._do("drive", interrupted)
        if not problem:
            self.place = (float(poses[-1, 0]), float(poses[-1, 1]))
        return Motion(problem, [[*start, 0.0], [*self.place, 0.0]])

    def _do(self, deed: str, interrupted: Interrupted) -> str:
        self.deeds.append(deed)
        self.during(deed)
        return "interrupted" if interrupted() else self.problems.get(deed, "")


class FakePlanner:
    """Gives the choices of a script one after the other, the last one again and again."""

    def __init__(self, *script: Choice) -> None:
        self.script = list(script)
        self.failures: list[str] = []
        self.states: list[RobotState] = []
        self.home: Choice | None = None
        self.aims: list[np.ndarray] = []
        self.blocked = self.why_not_there = ""

    def choose(self, state: RobotState) -> Choice:
        self.states.append(state)
        return self.script.pop(0) if len(self.script) > 1 else self.script[0]

    def route_to(self, state: RobotState, place: KnownPlace) -> Choice:
        x, y, _ = place.base
        route = route_to(x, y, state.T_map_base[:2, 3])
        return self.home or Choice(progress(), pose_at(x, y), route, "")

    def plan_arm(self, state: RobotState, T_map_camera: np.ndarray) -> Choice:
        self.aims.append(T_map_camera)
        staying = ArmPath.staying(JOINTS, np.zeros(2))
        arm = ArmPath(JOINTS, np.array([[0.0, 0.0], [0.5, 0.1]]), np.array([0.0, 1.0]))
        route = Route(staying, np.zeros((0, 3)), np.zeros((0, 4, 4)), arm, T_map_camera)
        return Choice(progress(), T_map_camera, route, self.why_not_there)

    def route_problem(self, state: RobotState) -> str:
        return self.blocked

    def failed(self, view: FailedView) -> None:
        self.failures.append(view.reason)


def view(x: float, known: float = 0.5, precise: float | None = None) -> Choice:
    return Choice(progress(known, precise=precise), pose_at(x, 0.0), route_to(x), f"view at {x}")


def nothing(reason: str = "no candidate tells anything", known: float = 0.5) -> Choice:
    return Choice(progress(known), None, None, reason)


class Notes:
    """A run log in memory."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, dict[str, Any]]] = []

    def write(self, kind: str, **content: Any) -> None:
        self.entries.append((kind, content))

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [content for name, content in self.entries if name == kind]
