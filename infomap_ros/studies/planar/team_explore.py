"""Several sensors explore one planar world and share their map: Fig. 12.

Each sensor maps its own scans, tells what changed in messages of the wire, and keeps a replica of
the map of all; by that it chooses, and knows where the others are and what they head for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import process_time

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.planar.explore import Exploration, ExplorationConfig, PlanarExplorer
from infomap_ros.studies.planar.world import PlanarWorld
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update
from infomap_ros.views.next_best_view import NextBestViewConfig
from infomap_ros.views.ranking.strategy import Strategy
from infomap_ros.views.situation import Teammate

_APART = 2.0  # between the sensors at the start [m]


class TeamSensor:
    """A sensor with its own map and a replica of the team's.

    Args:
        number: its id on the wire, from 0.
        explorer: sensor and choice.
    """

    def __init__(self, number: int, explorer: PlanarExplorer) -> None:
        self.number, self.explorer = number, explorer
        self.replica = MapReplica(explorer.map.config)
        self._version = 0
        explorer.map.track_changes(True)

    @property
    def team_map(self) -> VoxelMap:
        """What all sensors know, as far as it was heard."""
        return self.replica.voxel_map

    def look(self, team: list[TeamSensor]) -> int:
        """Take a scan and tell everybody, oneself included; returns the bytes of the messages."""
        self.explorer.look()
        self._version += 1
        changes = self.explorer.map.take_changes()
        size = self.explorer.map.config.voxel_size
        update = MapUpdate.of_changes(changes, size, self.number, self._version)
        sent = 0
        for rows in encode_update(update):
            sent += rows.nbytes
            for mate in team:
                mate.replica.apply(decode_update(rows))
        return sent

    def move(self, team: list[TeamSensor]) -> tuple[FloatArray | None, str]:
        """Choose the next view, knowing where the others are, and fly there."""
        others = [mate for mate in team if mate is not self]
        mates = [self._teammate(mate) for mate in others]
        return self.explorer.move(self.explorer.situation(self.team_map, mates))

    def _teammate(self, mate: TeamSensor) -> Teammate:
        """Another sensor, which looks from where it is, or is going to."""
        sensor, pose = mate.explorer.config.sensor, mate.explorer.pose
        return Teammate(pose[:3, 3], pose, sensor.max_range, sensor.camera)


def explore_together(
    world: PlanarWorld,
    strategy: str | Strategy,
    config: ExplorationConfig,
    choice: NextBestViewConfig | None = None,
    sensors: int = 2,
    progress: Callable[[int], None] | None = None,
) -> Exploration:
    """Explore a world with several sensors that take turns.

    Args:
        world: to be explored; the sensors start beside each other in its middle.
        strategy: of each sensor, by name or dotted path.
        config: of each sensor; `scans` counts those of all.
        choice: configuration of the choice; that of the studies by default.
        sensors: their number.
        progress: called with the number of scans taken.

    Returns:
        Fraction and distance of all together after each scan; corners and views of the first.
    """
    team = _team(world, strategy, config, choice, sensors)
    rows: list[tuple[float, float, float]] = []
    way, ended = [team[0].explorer.pose[None, :3, 3]], "all scans are taken"
    for scan in range(config.scans):
        sensor, seconds = team[scan % sensors], 0.0
        if scan >= sensors:
            start = process_time()
            corners, reason = sensor.move(team)
            seconds = process_time() - start
            if corners is None:
                ended = reason
                break
            if sensor is team[0]:
                way.append(corners[1:])
        sensor.look(team)
        moved = sum(mate.explorer.distance for mate in team)
        rows.append((world.fraction_mapped(sensor.team_map), moved, seconds))
        if progress is not None:
            progress(len(rows))
        if rows[-1][0] >= config.enough:
            ended = "enough is mapped"
            break
    fraction, distance, times = np.array(rows).T
    corners_flown, views = np.concatenate(way)[:, :2], team[0].explorer.views()
    return Exploration(fraction, distance, times, corners_flown, views, ended)


def _team(
    world: PlanarWorld,
    strategy: str | Strategy,
    config: ExplorationConfig,
    choice: NextBestViewConfig | None,
    sensors: int,
) -> list[TeamSensor]:
    """Sensors on a small circle about the start, each with its own seed."""
    team = []
    for number in range(sensors):
        angle = 2.0 * np.pi * number / sensors
        offset = 0.5 * _APART * np.array([np.cos(angle), np.sin(angle)])
        start = (np.floor((world.start + offset) / world.cell) + 0.5) * world.cell
        own = replace(config, seed=config.seed * sensors + number)
        team.append(TeamSensor(number, PlanarExplorer(world, own, strategy, choice, start)))
    return team
