"""Who is where and wants what: what the robots of a team report of themselves.

Each robot reports, a few times a second, its pose with covariance, its joints, its state, the
view that it is heading for and the path there. So others plan around it, leave to it what it is
about to see, and cut its body from their scans.

A goal is claimed: claims are numbered by versions, and each says which claims of the others were
known when it was made. Of two claims that were made without knowledge of each other, that of the
smaller id holds; no clocks are compared.

How robots learn of each other: the parameters.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, check_covariance, check_transform
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray, float_array
from infomap_ros.team.update import MAX_ORIGIN, MAX_ROBOT, MAX_SESSION, MAX_VERSION, is_newer

_MOST_WAYPOINTS, _MOST_JOINTS, _MOST_KNOWN = 200, 200, 1024
_LONGEST_STATE, _LONGEST_NAME = 80, 255
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_HASH = re.compile(r"[0-9a-f]{64}")
_FARTHEST, _LARGEST = 1e6, 100.0  # [m]
_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Agent:
    """What a robot reports of itself.

    Attributes:
        robot: its id, unique in its team.
        session: number that it draws when it starts.
        version: of this message, see `team.versions`.
        stamp: time of pose and joints [ns].
        since: time since when, as far as it knows, it has not moved [ns].
        T_map_base: pose of its base, shape (4, 4).
        T_map_camera: pose of its left optical frame, shape (4, 4).
        covariance: of that pose, shape (6, 6), convention of `geometry.transforms`; None if
            unknown.
        camera: its rectified left camera.
        max_range: how far it sees [m].
        state: what it is doing, in words.
        joints: positions by name [rad or m].
        goal: ``T_map_camera`` of the view that it is heading for, shape (4, 4); None without one.
        path: base poses (x, y, yaw) on the path there, shape (K, 3) [m, rad, map]; the last one is
            where it is going to stand.
        claim: version at which that goal was claimed, or the one before was given up.
        claims: claims of the others that it knew when it chose, by their ids.
        radius: no point of its body is farther from the axis of its base [m].
        bottom: lowest point of its body in its base frame [m].
        top: highest point of its body in its base frame [m].
        description: full name of the topic of its robot_description; empty without one.
        description_hash: of the text on that topic, see `hash_of_description`; who does not know
            it cannot trust what it reads there. Empty where nothing was read.
        base_frame: link whose pose `T_map_base` is; the root link where empty.
        origin: names the frame of its map, in which all this is, as in `PoseUncertainty`.

    Raises:
        InvalidInputError: something is impossible; names it.
    """

    robot: int
    session: int
    version: int
    stamp: int
    since: int
    T_map_base: FloatArray
    T_map_camera: FloatArray
    covariance: FloatArray | None
    camera: PinholeCamera
    max_range: float
    state: str = "idle"
    joints: Mapping[str, float] = field(default_factory=dict)
    goal: FloatArray | None = None
    path: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    claim: int = 0
    claims: Mapping[int, int] = field(default_factory=dict)
    radius: float = 0.5
    bottom: float = -0.1
    top: float = 1.0
    description: str = ""
    description_hash: str = ""
    base_frame: str = ""
    origin: int = 0

    def __post_init__(self) -> None:
        _check_numbers(self)
        _check_words(self)
        for name in ("T_map_base", "T_map_camera", "goal"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _checked_pose(getattr(self, name), name))
        if self.covariance is not None:
            checked = check_covariance(self.covariance, 6, "agent covariance")
            if np.abs(checked).max() > _FARTHEST**2:
                raise InvalidInputError("agent covariance", "is larger than any error can be")
            object.__setattr__(self, "covariance", checked)
        path = float_array(self.path, "agent path").reshape(-1, 3)
        if len(path) > _MOST_WAYPOINTS or not (np.abs(path) <= _FARTHEST).all():
            raise InvalidInputError("agent path", f"{len(path)} places, or one is impossible")
        object.__setattr__(self, "path", path)

    @property
    def versions(self) -> NDArray[np.uint32]:
        """Of all that it reports, shape (1,)."""
        return np.array([self.version], np.uint32)

    @property
    def sender(self) -> int | None:
        """Each robot speaks for itself alone."""
        return None

    @property
    def position_sigma(self) -> float:
        """Largest standard deviation of its position [m]; 0 where unknown."""
        if self.covariance is None:
            return 0.0
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def reach(self) -> float:
        """How far its body may be from where it says its axis is, by three sigmas [m]."""
        return self.radius + _SIGMAS * self.position_sigma


def knows(mate: Agent, robot: int, claim: int) -> bool:
    """Whether a teammate knew a claim of a robot, or a later one, when it chose its own goal."""
    known = mate.claims.get(robot, 0)
    return known == claim or (known != 0 and bool(is_newer(known, claim)))


def _check_numbers(agent: Agent) -> None:
    numbers = (
        ("robot", agent.robot, 0, MAX_ROBOT),
        ("session", agent.session, 0, MAX_SESSION),
        ("version", agent.version, 1, MAX_VERSION),
        ("stamp", agent.stamp, 0, 2**63 - 1),
        ("since", agent.since, 0, agent.stamp),
        ("claim", agent.claim, 0, MAX_VERSION),
        ("origin", agent.origin, 0, MAX_ORIGIN),
        ("max_range", agent.max_range, 1e-3, _FARTHEST),
        ("radius", agent.radius, 0.0, _LARGEST),
        ("bottom", agent.bottom, -_LARGEST, _LARGEST),
        ("top", agent.top, agent.bottom, _LARGEST),
    )
    for name, value, low, high in numbers:
        if not low <= value <= high:
            raise InvalidInputError(f"agent {name}", f"{value}, expected {low} to {high}")
    known = all(0 <= r <= MAX_ROBOT and 0 <= n <= MAX_VERSION for r, n in agent.claims.items())
    if len(agent.claims) > _MOST_KNOWN or not known:
        raise InvalidInputError("agent claims", f"{len(agent.claims)} robots")
    positions = np.array(list(agent.joints.values()), dtype=np.float64)
    if len(positions) > _MOST_JOINTS or not (np.abs(positions) <= _FARTHEST).all():
        raise InvalidInputError("agent joints", f"{dict(list(agent.joints.items())[:5])}")


def _check_words(agent: Agent) -> None:
    words = (
        ("state", agent.state, _LONGEST_STATE),
        ("base_frame", agent.base_frame, _LONGEST_NAME),
    )
    names = (("joint", name, _LONGEST_NAME) for name in agent.joints)
    topic = agent.description
    if topic and (len(topic) > _LONGEST_NAME or not _TOPIC.fullmatch(topic) or "__" in topic):
        raise InvalidInputError("agent description", f"'{topic[:40]}' is not the name of a topic")
    if agent.description_hash and not _HASH.fullmatch(agent.description_hash):
        text = f"'{agent.description_hash[:80]}' is not a hash"
        raise InvalidInputError("agent description_hash", text)
    for name, text, longest in (*words, *names):
        if len(text) > longest or not (text.isprintable() or not text):
            raise InvalidInputError(f"agent {name}", f"'{text[:40]}' is too long or not printable")


def _checked_pose(pose: FloatArray, name: str) -> FloatArray:
    checked = check_transform(pose, f"agent {name}")
    if not (np.abs(checked[:3, 3]) <= _FARTHEST).all():
        raise InvalidInputError(f"agent {name}", f"is at {checked[:3, 3].tolist()} m")
    return checked


@dataclass(frozen=True)
class AgentsConfig:
    """What a robot makes of what the others report.

    Raises:
        ConfigError: a value is out of its range.
    """

    idle_timeout: float = setting(
        120.0,
        "Where teammates leave no view that is worth its cost, this robot waits as long as they go "
        "from view to view, and so long after that; then it has nothing left to do.",
        unit="s",
        low=0.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
