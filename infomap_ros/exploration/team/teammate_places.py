"""Where teammates were at a time, and which points of a scan lie on their bodies.

It is interpolated between what they told before and after. Where that is not known, a teammate is
within its speed times the time of where it was.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import (
    Cylinder,
    JointStateRecord,
    PlacedSolid,
    PoseBuffer,
    PoseBufferConfig,
    PoseRecord,
    make_transform,
)
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.team.agents import Agent


@dataclass(frozen=True, eq=False)
class BodyInScan:
    """A teammate's body.

    Attributes:
        robot: its id.
        solids: placed in the camera's frame.
        margin: by which they are to be grown [m].
        is_sure: whether it is known where it was at the scan's stamp.
        ground: (n, d), shape (4,): what lies at p with ``n . p < d`` [m] is its ground;
            None where it is of no matter.
    """

    robot: int
    solids: Sequence[PlacedSolid]
    margin: float
    is_sure: bool
    ground: FloatArray | None = None


def on_bodies(
    points: ArrayLike,
    covariances: ArrayLike | None,
    bodies: Sequence[BodyInScan],
    config: BodyFilterConfig,
) -> NDArray[np.bool_]:
    """Mark the points of a scan that may lie on one of several bodies.

    Args:
        points: shape (..., 3), camera frame [m].
        covariances: as `mapping.scans.body.body_mask` takes them.
        bodies: placed in the camera's frame, each with its margin.
        config: how points' errors count.
    """
    mask = np.zeros(np.shape(points)[:-1], np.bool_)
    for body in bodies:
        grown = replace(config, margin=body.margin)
        mask |= body_mask(points, covariances, body.solids, grown)
    return mask


def largest_variance(covariance: FloatArray, lever: float) -> float:
    """Largest variance of a point at a lever [m] from a pose's origin, from above [m^2]."""
    position = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    rotation = np.linalg.eigvalsh(covariance[3:, 3:])[-1]
    # Whatever the two have to do with each other, the deviations add at the most.
    return float((np.sqrt(max(position, 0.0)) + lever * np.sqrt(max(rotation, 0.0))) ** 2)


def cylinder_about(agent: Agent, growth: float) -> PlacedSolid:
    """The cylinder about a robot's body, grown, in the frame of its base."""
    height = max(agent.top - agent.bottom, 0.01) + 2.0 * growth
    middle = make_transform(np.eye(3), (0.0, 0.0, 0.5 * (agent.top + agent.bottom)))
    return PlacedSolid(Cylinder(agent.radius + max(growth, 0.01), height), middle, "robot")


_MOST_AROUND = 0.3  # [m] about a teammate where no fiducials are chosen: others are needed
_RECENT = 10  # messages whose postures count for the cylinder about a teammate
_NANOSECONDS = 1e9


@dataclass(frozen=True)
class TeammatePlacesConfig:
    """Where teammates may have been at a time.

    Raises:
        ConfigError: a value is out of its range.
    """

    max_gap: float = setting(
        0.6,
        "Longest time between two messages of a teammate across which its place is interpolated.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    speed: float = setting(
        0.7,
        "How fast any part of a teammate moves at the most: so much its body grows for each second "
        "for which it is not known where it was.",
        unit="m/s",
        low=0.0,
        high=100.0,
    )
    max_growth: float = setting(
        1.5, "It grows no further by that: it is taken to have stopped.", unit="m", low=0.0,
        high=100.0,
    )  # fmt: skip
    unknown_sigma: ClassVar[float] = 0.1
    """Standard deviation of the place of a teammate that does not tell it [m]."""

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Place:
    """Where a teammate was at a time.

    Attributes:
        pose: of its base in the map.
        joints: positions by name [rad or m].
        growth: how far it may have been from there, as that was told for another time [m].
        is_sure: whether it is known for that time.
    """

    pose: PoseRecord
    joints: dict[str, float]
    growth: float = 0.0
    is_sure: bool = True


class _Track:
    """What one teammate has told of late."""

    def __init__(self, config: TeammatePlacesConfig) -> None:
        self.poses = PoseBuffer(PoseBufferConfig(max_gap=config.max_gap, capacity=100))
        self.joints = JointBuffer(JointBufferConfig(max_gap=config.max_gap, capacity=100))
        self.recent: deque[Agent] = deque(maxlen=_RECENT)

    def add(self, agent: Agent) -> None:
        self.recent.append(agent)
        self.poses.add(PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance))
        names = tuple(agent.joints)
        positions = np.array([agent.joints[name] for name in names], dtype=np.float64)
        self.joints.add(JointStateRecord(agent.stamp, "", names, positions))

    def about(self, growth: float) -> PlacedSolid:
        """The cylinder about its body in all postures of late, grown, in the frame of its base."""
        largest = replace(
            self.recent[-1],
            radius=max(agent.radius for agent in self.recent),
            bottom=min(agent.bottom for agent in self.recent),
            top=max(agent.top for agent in self.recent),
        )
        return cylinder_about(largest, growth)


class TeammatePlaces:
    """Remembers where each teammate told that it was.

    Args:
        config: how long and how fast they may move unseen.
        body: how much what is about them is grown.
    """

    def __init__(
        self, config: TeammatePlacesConfig | None = None, body: BodyFilterConfig | None = None
    ) -> None:
        self.config, self._body = config or TeammatePlacesConfig(), body or BodyFilterConfig()
        self._tracks: dict[int, _Track] = {}

    def hear(self, agent: Agent) -> None:
        """A teammate has told where it is."""
        self._tracks.setdefault(agent.robot, _Track(self.config)).add(agent)

    def keep(self, robots: Collection[int]) -> list[Agent]:
        """Forget all robots but these; returns what the forgotten ones told last."""
        gone = self._tracks.keys() - set(robots)
        return [self._tracks.pop(robot).recent[-1] for robot in sorted(gone)]

    @property
    def agents(self) -> dict[int, Agent]:
        """What each teammate told last, by its id."""
        return {robot: track.recent[-1] for robot, track in sorted(self._tracks.items())}

    def told_at(self, robot: int, stamp: int) -> Place:
        """Where a teammate was, as it told it.

        Args:
            robot: its id.
            stamp: [ns].

        Raises:
            PoseUnavailableError: it has not told that; its `may_arrive` says whether it still may.
        """
        if robot not in self._tracks:
            text = f"nothing was heard of robot {robot}"
            raise PoseUnavailableError(text, "place of a teammate", may_arrive=True)
        track = self._tracks[robot]
        agent = track.recent[-1]
        if agent.since <= stamp <= agent.stamp:
            pose = PoseRecord(stamp, "map", agent.T_map_base, agent.covariance)
            return Place(pose, dict(agent.joints))
        pose = track.poses.at(stamp)
        return Place(pose, track.joints.at(stamp) if len(track.joints) else {})

    def place(self, robot: int, stamp: int) -> Place:
        """Where a teammate was that has been heard, or where it told that it was nearest in time.

        Args:
            robot: its id.
            stamp: [ns].
        """
        try:
            return self.told_at(robot, stamp)
        except PoseUnavailableError:
            agent = self._tracks[robot].recent[-1]
            pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
            away = abs(stamp - agent.stamp) / _NANOSECONDS
            growth = min(self.config.speed * away, self.config.max_growth)
            return Place(pose, dict(agent.joints), growth, is_sure=False)

    def variance(self, pose: PoseRecord, lever: float) -> float:
        """Largest variance of a point of a teammate's body at a lever [m] from its base [m^2]."""
        if pose.covariance is None:
            return self.config.unknown_sigma**2
        return largest_variance(pose.covariance, lever)

    def about(self, stamp: int) -> list[PlacedSolid]:
        """An upright cylinder about each teammate, in which any of it was at a time.

        A teammate that is silent or lost takes no more room than `_MOST_AROUND` about its body.

        Args:
            stamp: [ns].

        Returns:
            Placed in the map, grown as the solids are for a scan, but for the error of its pose.
        """
        cylinders = []
        for robot, agent in self.agents.items():
            place = self.place(robot, stamp)
            sigma = float(np.sqrt(self.variance(place.pose, agent.radius)))
            margin = self._body.margin + place.growth + self._body.sigmas * sigma
            about = self._tracks[robot].about(min(margin, _MOST_AROUND))
            transform = place.pose.transform @ about.transform
            cylinders.append(PlacedSolid(about.solid, transform, about.name))
        return cylinders
