"""The relative origin of a team: robots that see each other's tags find one map.

Each sighting tells how the maps of two robots lie to each other (`map_alignment`). Where several
agree, and say that the two maps are not the same, one of the robots puts the frame of its map where
it belongs (`Localizer.move_map`). Where they say that the maps are the same, nothing is to be done.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.localization.target.map_alignment import (
    CONTRADICTION,
    Alignment,
    fuse_alignments,
    has_scale,
    squared_distance,
)
from infomap_ros.localization.target.robot_tags import RobotTags
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detector import TagTargetConfig

_POSE = 6  # numbers
_EXACT = Alignment(np.eye(4), np.zeros((_POSE, _POSE)))


@dataclass(frozen=True)
class TeamTagsConfig:
    """Which tags sit on which robots of the team, and where.

    Raises:
        ConfigError: a value is out of its range, or the lists do not fit each other.
    """

    robots: tuple[int, ...] = parameter(
        (), "For each tag of the team the robot_id of the robot that carries it; none where empty."
    )
    ids: tuple[int, ...] = parameter((), "For each tag its id.")
    poses: tuple[float, ...] = parameter(
        (),
        "For each tag six numbers: its middle [m] and its rotation vector [rad] in the base frame "
        "of its robot; a tag's own axes are x right and y up in the print, z out of it.",
    )
    family: str = setting("tag36h11", "Family of the tags.")
    side: float = parameter(
        0.16, "Edge of the black square of one tag.", unit="m", low=0.005, high=5.0
    )
    period: float = setting(
        0.5, "Shortest time between two looks for teammates.", unit="s", low=0.0, high=60.0
    )
    sightings: int = setting(
        4, "So many sightings of a teammate must agree before a map is moved.", low=1, high=100
    )

    def __post_init__(self) -> None:
        check_config(self)
        if len(self.ids) != len(self.robots):
            raise ConfigError("ids", self.ids, f"one id for each of {len(self.robots)} robots")
        if len(self.poses) != _POSE * len(self.robots):
            raise ConfigError("poses", self.poses, f"six numbers for each of {len(self.ids)} tags")
        self.carried()

    def carried(self, but: int | None = None) -> list[RobotTags]:
        """The tags of each robot, named by its id.

        Args:
            but: id of a robot that is left out: that which looks.

        Raises:
            ConfigError: the tags cannot be such tags.
        """
        poses = np.reshape(self.poses, (-1, _POSE))
        found = []
        for robot in sorted(set(self.robots) - {but}):
            own = [place for place, carrier in enumerate(self.robots) if carrier == robot]
            ids, flat = tuple(self.ids[i] for i in own), tuple(map(float, poses[own].ravel()))
            board = TagBoardConfig(family=self.family, side=self.side, ids=ids, poses=flat)
            found.append(RobotTags(str(robot), TagTargetConfig(board=board)))
        return found


class TeamAlignment:
    """Learns from sightings how the map of a teammate lies to the own one.

    Args:
        sightings: that must agree.

    Attributes:
        problem: why the last sightings told nothing; empty where they did.
    """

    def __init__(self, sightings: int) -> None:
        self._wanted, self.problem = sightings, ""
        self._heard: list[Alignment] = []

    def clear(self) -> None:
        """Forget all sightings, as when a map was moved."""
        self._heard.clear()

    def add(self, T_theirs_mine: Alignment) -> Alignment | None:
        """Learn from one sighting; one whose covariance is singular tells nothing.

        Repeated sightings share errors, those of the two robots' own poses. So they are no surer
        together than the surest of them.

        Returns:
            ``T_theirs_mine`` when the maps are not the same and enough sightings agree on it.
        """
        if not has_scale(T_theirs_mine):
            self.problem = "a sighting without an error in some direction"
            return None
        self.problem = ""
        self._heard = [*self._heard[1 - self._wanted :], T_theirs_mine][-self._wanted :]
        if len(self._heard) < self._wanted:
            return None
        fused = fuse_alignments(self._heard)
        self.problem = "" if fused.is_consistent else "sightings contradict each other"
        if not fused.is_consistent:
            return None
        agreeing = [one for one, fits in zip(self._heard, fused.agreeing, strict=True) if fits]
        surest = min(agreeing, key=lambda one: float(np.linalg.slogdet(one.covariance)[1]))
        found = Alignment(fused.alignment.T_a_b, surest.covariance)
        return found if squared_distance(found, _EXACT) > CONTRADICTION else None
