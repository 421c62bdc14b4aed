"""One exploration of a planar world: look, choose, fly there, look again.

Several sensors explore one planar world and share their map: Fig. 12.

Each sensor maps its own scans, tells what changed in messages of the wire, and keeps a replica of
the map of all; by that it chooses, and knows where the others are and what they head for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import process_time

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.flight import FreeFlight
from infomap_ros.studies.planar.world import PlanarWorld, SensorConfig, level_pose, take_scan
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update
from infomap_ros.views.decision import UnproductiveLooks
from infomap_ros.views.information.view_information import ExpectedInformation, Metric
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.ranking.look_ahead import LookAheadConfig
from infomap_ros.views.ranking.rating import RatingConfig
from infomap_ros.views.ranking.strategy import Strategy
from infomap_ros.views.sampling.candidates import CandidateConfig
from infomap_ros.views.sampling.orientations import OrientationConfig
from infomap_ros.views.sampling.surroundings import SurroundingsConfig
from infomap_ros.views.selection import SelectionConfig
from infomap_ros.views.situation import RegionOfTask, Situation, Teammate

_RATING_ALONE, _DISCOUNTED = 0.4, 0.1  # what a distance of one range costs [full views]
_REFINED = 80  # views whose information is evaluated exactly


def planar_choice(
    max_range: float, cell: float, candidates: int = 400, strategy: str = ""
) -> NextBestViewConfig:
    """The choice for a sensor of this range [m] in a world with cells of this edge [m].

    The sensor has no body, no noise and knows its pose, so that neither room, margins nor the
    localization error count. All of the world is searched at once.

    Args:
        max_range: see above.
        cell: see above.
        candidates: number of candidate views.
        strategy: by which is chosen. One that ranks by the rating alone needs a higher cost of
            the distance than those that discount what comes late.
    """
    cost_of_range = _RATING_ALONE if strategy == "largest_information" else _DISCOUNTED
    return NextBestViewConfig(
        surroundings=SurroundingsConfig(
            surface_margin=0, camera_radius=0.0, start_radius=cell, horizon=1000.0, cell=cell
        ),
        candidates=CandidateConfig(
            candidates=candidates,
            local_radius=max_range,
            periphery_share=0.4,
            teammate_clearance=0.2 * max_range,
        ),
        orientations=OrientationConfig(
            directed=3, spread=1, lowest_elevation=0.0, highest_elevation=0.0
        ),
        rating=RatingConfig(
            distance_weight=cost_of_range / max_range,
            localization_weight=0.0,
            teammate_sigma=0.1 * max_range,
        ),
        selection=SelectionConfig(min_rating=-1e6, refined=_REFINED),
        look_ahead=LookAheadConfig(
            depth=8,
            views=_REFINED,
            beam=8,
            discount_distance=max_range,
            cost_of_view=max_range / 30.0,
            unlike_distance=0.15 * max_range,
        ),
    )


INFORMATION = InformationConfig(ray_spacing=0.03, min_range=0.0, range_noise=0.0, pixel_angle=1e-4)
"""How it is judged what views tell: at most half a voxel of 1 m between rays at 15 m, no noise."""

_DRAWS = 5  # of candidates, before an exploration ends


@dataclass(frozen=True)
class ExplorationConfig:
    """One exploration.

    Raises:
        ConfigError: a value is out of its range.
    """

    scans: int = parameter(100, "At most so many scans are taken.", low=2, high=100_000)
    enough: float = parameter(
        1.0, "The exploration ends when this share of the world is mapped.", low=0.0, high=1.0
    )
    min_scans: int = parameter(
        100_000,
        "It also ends when so many scans are taken and the sensor has moved `min_path_length`.",
        low=2,
        high=100_000,
    )
    min_path_length: float = parameter(0.0, "See `min_scans`.", unit="m", low=0.0, high=1e9)
    seed: int = parameter(0, "Of the candidates.", low=0)
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        check_config(self)

    def end(self, scans: int, fraction: float, distance: float) -> str:
        """Why an exploration ends that has taken so many scans; "" if it goes on.

        Args:
            scans: taken.
            fraction: mapped.
            distance: moved [m].
        """
        if fraction >= self.enough:
            return "enough is mapped"
        if scans >= self.min_scans and distance >= self.min_path_length:
            return "the figures are full"
        return "all scans are taken" if scans >= self.scans else ""


@dataclass(frozen=True, eq=False)
class Exploration:
    """What became of an exploration; entry k is that after scan k, shape (K,) each.

    Attributes:
        fraction: share of the mappable cells that are mapped, in [0, 1].
        distance: moved until then [m].
        seconds: that the choice of the view took, time of the processor [s], so that what else runs
            does not count; 0 for the first.
        corners: of the path flown, shape (N, 2) [m].
        views: place [m] and azimuth [rad] of each scan, shape (K, 3).
        ended: why it ended: see `ExplorationConfig.end`, or what the choice says.
    """

    fraction: FloatArray
    distance: FloatArray
    seconds: FloatArray
    corners: FloatArray
    views: FloatArray
    ended: str


class PlanarExplorer:
    """A sensor in a planar world, with its map and its choice of views.

    Args:
        world: to be explored.
        config: sensor and seed.
        strategy: name of a strategy, dotted path of a class, or a strategy.
        choice: configuration of the choice; that of the studies by default.
        start: where it begins, shape (2,) [m]; the world's start by default.
        metric: what counts as information, the name of one of `views.METRICS` or a function.
        look_limit: looks in vain after which a voxel is given up; without it none are.
    """

    def __init__(
        self,
        world: PlanarWorld,
        config: ExplorationConfig,
        strategy: str | Strategy,
        choice: NextBestViewConfig | None = None,
        start: FloatArray | None = None,
        metric: str | Metric = "expected_entropy_reduction",
        look_limit: float | None = None,
    ) -> None:
        self.world, self.config = world, config
        self.map = VoxelMap(config.sensor.map_config(world.cell))
        settings = choice or planar_choice(
            config.sensor.max_range,
            world.cell,
            strategy=strategy if isinstance(strategy, str) else "",
        )
        self._information = ExpectedInformation(metric, INFORMATION, threads=1)
        self._unproductive = None if look_limit is None else UnproductiveLooks(look_limit)
        self._thresholds = settings.surroundings.thresholds
        self._choice = NextBestView(settings, strategy, self._information)
        self._rng = np.random.default_rng(config.seed)
        place = world.start if start is None else start
        self.pose = level_pose(place, float(self._rng.uniform(-np.pi, np.pi)), world.cell)
        self.past: list[FloatArray] = []
        self.distance = 0.0

    def look(self) -> None:
        """Take a scan."""
        take_scan(self.world.truth, self.config.sensor, self.pose, self.map)
        self.past.append(self.pose)

    def views(self) -> FloatArray:
        """Place [m] and azimuth [rad] of the scans so far, shape (K, 3)."""
        poses = np.array(self.past)
        azimuths = np.arctan2(poses[:, 1, 2], poses[:, 0, 2])
        return np.column_stack([poses[:, :2, 3], azimuths])

    def situation(self, voxel_map: VoxelMap, teammates: Sequence[Teammate] = ()) -> Situation:
        """What is known, by a map that may hold more than the own scans.

        Args:
            voxel_map: to choose by; the own one, or that of a team.
            teammates: other sensors.
        """
        cell, size = self.world.cell, self.world.size
        return Situation(
            voxel_map,
            self.config.sensor.camera,
            self.config.sensor.max_range,
            self.pose,
            region=RegionOfTask(np.zeros(3), np.array([size[0], size[1], cell])),
            past_views=np.array(self.past),
            heights=(0.25 * cell, 0.75 * cell),
            teammates=teammates,
        )

    def move(self, situation: Situation) -> tuple[FloatArray | None, str]:
        """Choose the next view and fly there; candidates are drawn again where none will do.

        What the last view is still expected to tell is in vain: see `views.unproductive_looks`.

        Returns:
            Corners of the path, shape (N, 3) [m]; None where there is no view, and why.
        """
        if self._unproductive is not None:
            left = self._information.gains(situation, self.pose[None])[0]
            self._unproductive.note(
                left.keys, situation.voxel_map, self.pose[:3, 3], situation.max_range
            )
            promising = self._unproductive.without_them(situation.voxel_map)
            situation = replace(situation, promising=promising)
        flight = FreeFlight(situation.voxel_map, self.pose, situation.heights, self._thresholds)
        for _ in range(_DRAWS):
            decision = self._choice.select(situation, flight, self._rng)
            if decision.chosen is not None:
                break
        if decision.chosen is None or decision.reach is None:
            return None, decision.reason
        self.pose = decision.chosen.pose
        self.distance += decision.reach.travel
        corners = flight.path_to(self.pose[:3, 3])
        return corners, decision.reason


def explore(
    world: PlanarWorld,
    strategy: str | Strategy,
    config: ExplorationConfig | None = None,
    choice: NextBestViewConfig | None = None,
    progress: Callable[[int], None] | None = None,
    metric: str | Metric = "expected_entropy_reduction",
    look_limit: float | None = None,
) -> Exploration:
    """Explore a world with one sensor.

    Args:
        world: to be explored.
        strategy: name of a strategy, dotted path of a class, or a strategy.
        config: sensor, number of scans, seed.
        choice: configuration of the choice; that of the studies by default.
        progress: called with the number of scans taken.
        metric: what counts as information, the name of one of `views.METRICS` or a function.
        look_limit: see `PlanarExplorer`.
    """
    settings = config or ExplorationConfig()
    sensor = PlanarExplorer(world, settings, strategy, choice, metric=metric, look_limit=look_limit)
    rows: list[tuple[float, float, float]] = []
    flown, ended, seconds = [sensor.pose[None, :3, 3]], "", 0.0
    while not ended:
        sensor.look()
        rows.append((world.fraction_mapped(sensor.map), sensor.distance, seconds))
        if progress is not None:
            progress(len(rows))
        ended = settings.end(len(rows), *rows[-1][:2])
        if ended:
            break
        start = process_time()
        corners, reason = sensor.move(sensor.situation(sensor.map))
        seconds = process_time() - start
        if corners is None:
            ended = reason
            break
        flown.append(corners[1:])
    fraction, distance, times = np.array(rows).T
    corners_flown = np.concatenate(flown)[:, :2]
    return Exploration(fraction, distance, times, corners_flown, sensor.views(), ended)


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
    flown, ended = [team[0].explorer.pose[None, :3, 3]], "all scans are taken"
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
                flown.append(corners[1:])
        sensor.look(team)
        moved = sum(mate.explorer.distance for mate in team)
        rows.append((world.fraction_mapped(sensor.team_map), moved, seconds))
        if progress is not None:
            progress(len(rows))
        if rows[-1][0] >= config.enough:
            ended = "enough is mapped"
            break
    fraction, distance, times = np.array(rows).T
    corners_flown, views = np.concatenate(flown)[:, :2], team[0].explorer.views()
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
