"""One exploration by the simulated rover, and what of the true surface is mapped after each view.

Everything is that of ``infomap explore``; only images are smaller, and the pose is the true one
with a little noise, so that a run takes about a minute of one core.

Other raster scans; the paper prints neither the step nor the headings of its own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.contacts import ContactEvent
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.exploring.exploration_run import (
    ExplorationOptions,
    ExplorationRun,
    WorldConfig,
)
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobotConfig
from infomap_ros.simulation.exploring.visible_surface import (
    VisibleSurface,
    VisibleSurfaceConfig,
    covered,
    visible_surface,
)
from infomap_ros.simulation.simulator import SimulatorConfig
from infomap_ros.simulation.worlds.scenes import WORLDS
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategies import Raster
from infomap_ros.views.ranking.strategy import Scores

_ATTEMPTS, _ROUNDS = 60, 8  # views to which motions are planned, and how often others are drawn


@dataclass(frozen=True)
class RoverConfig:
    """World, camera, and what counts as mapped.

    Raises:
        ConfigError: a value is out of its range.
    """

    world: str = parameter("mars", "Name of the world.", choices=WORLDS)
    size: float = parameter(
        12.0, "Size of the world: of `mars`, diameter of the crater.", unit="m", low=4.0, high=40.0
    )
    width: int = parameter(256, "Image width.", unit="px", low=64, high=2048)
    height: int = parameter(192, "Image height.", unit="px", low=48, high=2048)
    surface: VisibleSurfaceConfig = field(default_factory=VisibleSurfaceConfig)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class RoverTask:
    """One exploration: implements `infomap_ros.studies.runs.Task`.

    Attributes:
        seed: of world and noise.
        strategy: name of a strategy, or dotted path of a class.
        views: at most so many.
        config: world and camera.
    """

    seed: int
    strategy: str
    views: int
    config: RoverConfig

    @property
    def label(self) -> str:
        """Name of the strategy for tables: that of its class where it is a dotted path."""
        return self.strategy.rpartition(".")[2]

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{self.config.world}_{self.seed}__{self.label}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def options(self) -> ExplorationOptions:
        """Of the product's own exploration, which ends when the views are used up."""
        camera = StereoCameraConfig(
            width=self.config.width, height=self.config.height, supersampling=1
        )
        return ExplorationOptions(
            world=WorldConfig(self.config.world, self.seed, self.config.size),
            task=TaskConfig(
                known_fraction=1.0, max_views=self.views, unproductive_views=self.views
            ),
            planner=self._planner(),
            robot=SimulatedRobotConfig(pose_source="simulator", images_while_moving=False),
            simulator=SimulatorConfig(camera=camera),
        )

    def _planner(self) -> ViewPlannerConfig:
        """The product's own, but that it tries more views before it says that there is none.

        A raster scan puts views first that can hardly be reached.
        """
        usual = ViewPlannerConfig(strategy=self.strategy, seed=self.seed, threads=1)
        selection = replace(usual.choice.selection, attempts=_ATTEMPTS)
        choice = replace(usual.choice, selection=selection)
        return replace(usual, choice=choice, rounds=_ROUNDS)

    def run(self) -> RoverExploration:
        """Explore."""
        return _explore(self)


@dataclass(frozen=True, eq=False)
class RoverExploration:
    """What became of an exploration; entry k is that after view k, shape (K,) each.

    Attributes:
        points: of the true surface that are mapped.
        distance: driven by the base until then [m].
        seconds: time of the processor since the start [s].
        cameras: where the views were taken from, shape (K, 4, 4), ``T_map_camera``.
        surface: points of the true surface that reachable views can see, shape (N, 3) [m].
        first_seen: number of the view after which each of them was first mapped, shape (N,); 0
            where never.
        contacts: that should not be.
        touched: what touched what in them, how deep, when and where.
        ended: why it ended.
    """

    points: FloatArray
    distance: FloatArray
    seconds: FloatArray
    cameras: FloatArray
    surface: NDArray[np.float32]
    first_seen: NDArray[np.int16]
    contacts: int
    touched: str
    ended: str

    def after(self, view: int) -> float:
        """Points mapped after so many views; what was reached at the end stays."""
        return float(self.points[min(view, len(self.points)) - 1])


class _Watcher:
    """Measures the map whenever the run log tells of progress, which is once after each view."""

    def __init__(self) -> None:
        self.run: ExplorationRun | None = None
        self.rows: list[tuple[float, float, float]] = []
        self.cameras: list[FloatArray] = []
        self._start = process_time()

    def begin(self, run: ExplorationRun, surface: VisibleSurface) -> None:
        self.run, self.surface = run, surface
        self.first_seen = np.zeros(len(surface.points), np.int16)

    def note(self, entry: Mapping[str, Any]) -> None:
        """Take an entry of the run log."""
        if entry["kind"] != "progress" or self.run is None:
            return
        if entry["views"] <= len(self.rows):  # the last choice led nowhere: nothing new was seen
            return
        mapped = covered(self.run.map, self.surface.points)
        seconds = process_time() - self._start
        self.rows.append((float(np.count_nonzero(mapped)), float(entry["distance"]), seconds))
        self.first_seen[mapped & (self.first_seen == 0)] = len(self.rows)
        self.cameras.append(self.run.audit.poses[-1].pose.transform)


def surface_of(run: ExplorationRun, config: RoverConfig) -> VisibleSurface:
    """The true surface that reachable views can see, one point for each `spacing` squared."""
    reach = run.options.planner.max_range
    return visible_surface(run.simulator.world, reach, config.surface)


def _explore(task: RoverTask) -> RoverExploration:
    watcher = _Watcher()
    with tempfile.TemporaryDirectory() as folder:
        run = ExplorationRun(task.options(), Path(folder), watcher.note)
        try:
            watcher.begin(run, surface_of(run, task.config))
            ending = run.run()
            events = run.simulator.contact_events
        finally:
            run.close()
    points, distance, seconds = np.array(watcher.rows).T
    cameras, surface = np.array(watcher.cameras), watcher.surface.points.astype(np.float32)
    return RoverExploration(
        points,
        distance,
        seconds,
        cameras,
        surface,
        watcher.first_seen,
        contacts=len(events),
        touched="; ".join(map(_contact_text, events)),
        ended=f"{ending.reason.value}: {ending.detail}",
    )


def _contact_text(event: ContactEvent) -> str:
    """A contact in words."""
    x, y, z = event.place
    depth = 1e3 * event.depth
    return (
        f"{event.link} touched {event.other}, {depth:.1f} mm deep, after {event.time:.1f} s, "
        f"at ({x:.2f}, {y:.2f}, {z:.2f}) m"
    )


_VOXEL_STEP = 0.0125  # of the camera's range: a voxel of 5 cm for a range of 4 m
_SHORT_STEP = 0.1  # likewise: about the length of the rover


class VoxelRaster(Raster):
    """Every voxel is a place, by the letter of the paper.

    It takes "the next free location in the known environment from which measurements have not yet
    been made", and the center of each voxel that is known to be free is a location.
    """

    def __init__(self) -> None:
        super().__init__(_VOXEL_STEP)


class SweepRaster(Raster):
    """Goes on from where the camera is, by short steps along rows, and keeps its heading."""

    def __init__(self) -> None:
        super().__init__(_SHORT_STEP)

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the places ahead in the sequence; the smallest turn among views of one place."""
        situation = options.situation
        places = self._places(options, options.poses)
        here = self._places(options, situation.T_map_camera[None])[0]
        taken = np.isin(places, self._places(options, situation.past_views))
        whole = places.max(initial=here) + 1.0
        ahead = np.mod(places - here, whole) + whole * taken
        axes = options.poses[:, :3, 2] @ situation.T_map_camera[:3, 2]
        turns = np.arccos(np.clip(axes, -1.0, 1.0)) / math.pi
        return Scores(-(ahead + 0.5 * turns))

    def _places(self, options: Options, poses: FloatArray) -> FloatArray:
        """Place of poses in the sequence, whatever their heading: (M, 4, 4) -> (M,)."""
        opening = options.situation.camera.field_of_view[0]
        sectors = max(1, math.ceil(2.0 * math.pi / opening))
        return np.floor(self._order(options, poses) / sectors)


class OneDirectionRaster(SweepRaster):
    """As the sweep, but looks in the direction of the first view until no such place is left.

    So the camera sees the same part of the scene from places side by side, as the region that the
    paper's scan has mapped in 41 steps suggests.
    """

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Those of the sweep; views that look in another direction come after all others."""
        values = super().score(options, ratings).values
        situation = options.situation
        first = situation.past_views[0] if len(situation.past_views) else situation.T_map_camera
        along = options.poses[:, :3, 2] @ first[:3, 2]
        narrowest = math.cos(0.5 * situation.camera.field_of_view[0])
        return Scores(values - (along < narrowest) * (1.0 - values.min(initial=0.0)))
