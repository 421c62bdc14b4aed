"""How far the camera's position drifts when scene fiducials alone tell of its motion (Fig. 15).

Fig. 15 of doi:10.1177/0278364905051774: the RMS position error over 50 steps grows with distance,
and falls with redundant fiducials (1, 2, 4 times the necessary number) and with their nearness
(mean distance 1,100 mm and 350 mm). Three methods see the same measurements:

- ``printed``: eq. (14), corrected (`printed_motion`), from each step to the next;
- ``weighted``: `estimate_motion` with covariances and gates, likewise from each step to the next;
- ``default``: `FiducialFilter`, which keeps what it knows of each fiducial.

    infomap study drift --out DIR

The figure of the drift study.

One walk of the drift study, and where each method believes the camera to be.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import free_motion
from infomap_ros.studies.camera_motion import estimate_motion, printed_motion
from infomap_ros.studies.fiducial_walk import CAMERA, WalkConfig, WalkFrame, walk
from infomap_ros.studies.figure_style import CONFIDENCE

NECESSARY = 4
"""Fiducials that eq. (14) needs for its 12 unknowns."""

_STEP_TIME = 0.2  # [s], for the prior of a camera that may move anywhere


@dataclass(frozen=True, eq=False)
class WalkErrors:
    """Distance from the true position by each method, shape (steps + 1,) each [m].

    Attributes:
        printed: by eq. (14).
        weighted: by `estimate_motion`.
        default: by `FiducialFilter`.
    """

    printed: FloatArray
    weighted: FloatArray
    default: FloatArray


METHODS = tuple(field.name for field in dataclasses.fields(WalkErrors))


@dataclass(frozen=True)
class WalkTask:
    """One walk: implements `infomap_ros.studies.runs.Task`.

    Attributes:
        distance: mean distance of the fiducials [m].
        redundancy: multiple of the necessary number of fiducials.
        number: of the walk.
        seed: of the study.
        walk: noise and steps.
    """

    distance: float
    redundancy: int
    number: int
    seed: int
    walk: WalkConfig

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{1e3 * self.distance:.0f}mm_{self.redundancy}x_{self.number}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def run(self) -> WalkErrors:
        """Walk and compare with the truth."""
        source = [self.seed, self.number, self.redundancy, int(1e3 * self.distance)]
        rng = np.random.default_rng(source)
        frames = list(walk(self.walk, NECESSARY * self.redundancy, self.distance, rng))
        truth = np.array([frame.T_map_camera[:3, 3] for frame in frames])
        found = _positions(frames)
        return WalkErrors(*(np.linalg.norm(found[m] - truth, axis=1) for m in METHODS))


def _positions(frames: Sequence[WalkFrame]) -> dict[str, FloatArray]:
    """Estimated positions by each method, shape (steps + 1, 3) [m]."""
    return {
        "printed": _composed(frames, _printed),
        "weighted": _composed(frames, _weighted),
        "default": _filtered(frames),
    }


Pair = tuple[FiducialObservations, FiducialObservations]


def _composed(frames: Sequence[WalkFrame], motion: Callable[[Pair], FloatArray]) -> FloatArray:
    """Positions from motions between neighboring frames."""
    pose = np.eye(4)
    positions = [pose[:3, 3]]
    for before, after in pairwise(frames):
        pair = tuple(
            frame.observations.select(_order(frame.observations, before.followed))
            for frame in (before, after)
        )
        pose = pose @ invert_transform(motion((pair[0], pair[1])))
        positions.append(pose[:3, 3])
    return np.array(positions)


def _order(observations: FiducialObservations, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of ids in observations."""
    order = np.argsort(observations.ids)
    return np.asarray(order[np.searchsorted(observations.ids, ids, sorter=order)])


def _printed(pair: Pair) -> FloatArray:
    try:
        return printed_motion(pair[0].points(CAMERA), pair[1].points(CAMERA))
    except InvalidInputError:  # four points in one plane: counts as no motion
        return np.eye(4)


def _weighted(pair: Pair) -> FloatArray:
    before, after = pair
    estimate = estimate_motion(
        before.points(CAMERA), before.covariances(CAMERA),
        after.points(CAMERA), after.covariances(CAMERA),
    )  # fmt: skip
    # A step without an estimate counts as no motion: its error stays in the result.
    return np.eye(4) if estimate.T_after_before is None else estimate.T_after_before


def _filtered(frames: Sequence[WalkFrame]) -> FloatArray:
    """Positions by the filter, from images alone."""
    config = FiducialFilterConfig(min_fiducials=NECESSARY, max_kept_poses=2)
    pose_filter = FiducialFilter(CAMERA, config)
    pose_filter.add(frames[0].observations)
    positions = [np.zeros(3)]
    for frame in frames[1:]:
        pose_filter.predict(free_motion(_STEP_TIME))
        update = pose_filter.update(frame.observations)
        new = np.isin(frame.observations.ids, update.unknown)
        pose_filter.add(frame.observations.select(new))
        positions.append(pose_filter.pose[0][:3, 3])
    return np.array(positions)


_RESAMPLES = 400


@dataclass(frozen=True)
class DriftConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    runs: int = parameter(100, "Random walks for each panel.", low=4, high=100000)
    distances: tuple[float, ...] = parameter(
        (1.1, 0.35), "Mean distances of the fiducials.", unit="m", low=0.05, high=50.0
    )
    redundancies: tuple[int, ...] = parameter(
        (1, 2, 4), "Fiducials, as multiples of the necessary number.", low=1, high=50
    )
    seed: int = parameter(0, "Seed of the first walk.", low=0)
    walk: WalkConfig = field(default_factory=WalkConfig)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class DriftPanel:
    """Position errors at one mean distance and redundancy.

    Attributes:
        distance: mean distance of the fiducials [m].
        redundancy: multiple of the necessary number of fiducials.
        errors: by method: distance from the true position, shape (runs, steps + 1) [m].
    """

    distance: float
    redundancy: int
    errors: dict[str, FloatArray]

    def rms(self, method: str) -> FloatArray:
        """RMS position error after each step, shape (steps + 1,) [m]."""
        return np.asarray(np.sqrt(np.mean(self.errors[method] ** 2, axis=0)))

    def band(self, method: str) -> tuple[FloatArray, FloatArray]:
        """Where `rms` lies with CONFIDENCE, by resampling the runs, two of shape (steps + 1,).

        B. Efron, Ann. Statist. 7(1), 1979, doi:10.1214/aos/1176344552.
        """
        squares = self.errors[method] ** 2
        rng = np.random.default_rng(0)
        chosen = rng.integers(0, len(squares), (_RESAMPLES, len(squares)))
        means = np.sqrt(np.array([squares[some].mean(axis=0) for some in chosen]))
        tail = 0.5 * (1.0 - CONFIDENCE)
        low, high = np.quantile(means, [tail, 1.0 - tail], axis=0)
        return np.asarray(low), np.asarray(high)

    @property
    def ratio(self) -> float:
        """RMS error of the default at the last step, by that of the printed method."""
        return float(self.rms("default")[-1] / self.rms("printed")[-1])


def tasks_of(config: DriftConfig) -> list[WalkTask]:
    """All walks: one of each panel in turn."""
    panels = list(product(config.distances, config.redundancies))
    return [
        WalkTask(*panel, number, config.seed, config.walk)
        for number in range(config.runs)
        for panel in panels
    ]


def panels_of(results: Mapping[WalkTask, WalkErrors]) -> list[DriftPanel]:
    """One panel per distance and redundancy of which there are walks."""
    walks: dict[tuple[float, int], list[WalkErrors]] = {}
    for task, errors in results.items():
        walks.setdefault((task.distance, task.redundancy), []).append(errors)
    return [
        DriftPanel(*key, {m: np.array([getattr(one, m) for one in found]) for m in METHODS})
        for key, found in walks.items()
    ]


def drift_table(panels: Sequence[DriftPanel]) -> str:
    """RMS errors at the last step as a Markdown table [mm]."""
    percent = f"{100 * CONFIDENCE:.0f} %"
    lines = [
        f"| mean distance | fiducials | printed (14) | weighted | default | {percent} band "
        "| default / printed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for panel in panels:
        printed, weighted, default = (1e3 * panel.rms(method)[-1] for method in METHODS)
        low, high = (1e3 * edge[-1] for edge in panel.band("default"))
        count = NECESSARY * panel.redundancy
        cells = [
            f"{1e3 * panel.distance:.0f} mm",
            f"{panel.redundancy}x ({count})",
            *(f"{value:.2f} mm" for value in (printed, weighted, default)),
            f"{low:.2f} to {high:.2f} mm",
            f"{panel.ratio:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def drift_rows(panels: Sequence[DriftPanel]) -> list[str]:
    """All curves as lines of a CSV file."""
    rows = ["distance_m,redundancy,method,step,rms_m,low_m,high_m"]
    for panel in panels:
        for method in METHODS:
            curves = zip(panel.rms(method), *panel.band(method), strict=True)
            rows += [
                f"{panel.distance:g},{panel.redundancy},{method},{step},{rms:.6g},{low:.6g},{high:.6g}"
                for step, (rms, low, high) in enumerate(curves)
            ]
    return rows


def drift_summary(panels: Sequence[DriftPanel], seconds: float) -> dict[str, float | str]:
    """The last step as one flat object of figures."""
    runs = min((len(panel.errors["default"]) for panel in panels), default=0)
    figures: dict[str, float | str] = {"runs": runs, "seconds": round(seconds, 1)}
    for panel in panels:
        key = f"{1e3 * panel.distance:.0f}mm_{panel.redundancy}x"
        for method in METHODS:
            figures[f"rms_{method}_{key}_mm"] = float(1e3 * panel.rms(method)[-1])
        figures[f"ratio_{key}"] = panel.ratio
    return figures


_COLORS = {"printed": "#d55e00", "weighted": "#009e73", "default": "#08519c"}
_LABELS = {
    "printed": "printed method, eq. (14)",
    "weighted": "weighted, step by step",
    "default": "default (filter)",
}


def draw_drift(panels: Sequence[DriftPanel], paths: Sequence[str | Path]) -> None:
    """Draw the RMS position error over the steps, one panel per distance and redundancy.

    Args:
        panels: of `panels_of`.
        paths: files to write, PNG or SVG by their suffix.
    """
    distances = sorted({panel.distance for panel in panels}, reverse=True)
    redundancies = sorted({panel.redundancy for panel in panels})
    figure = Figure(figsize=(3.6 * len(redundancies), 3.1 * len(distances)), layout="constrained")
    axes = figure.subplots(
        len(distances), len(redundancies), sharex=True, sharey="row", squeeze=False
    )
    for panel in panels:
        axis = axes[distances.index(panel.distance)][redundancies.index(panel.redundancy)]
        steps = np.arange(len(panel.rms("default")))
        for method in METHODS:
            low, high = (1e3 * edge[1:] for edge in panel.band(method))
            axis.fill_between(steps[1:], low, high, color=_COLORS[method], alpha=0.25, linewidth=0)
            axis.plot(
                steps[1:], 1e3 * panel.rms(method)[1:], color=_COLORS[method],
                label=_LABELS[method], linewidth=1.4,
            )  # fmt: skip
        axis.set_yscale("log")
        axis.grid(True, which="both", linewidth=0.3)
        count = NECESSARY * panel.redundancy
        axis.set_title(
            f"{1e3 * panel.distance:.0f} mm, {panel.redundancy}x ({count} fiducials)", fontsize=10
        )
    for axis in axes[-1]:
        axis.set_xlabel("step [-]")
    for row in axes:
        row[0].set_ylabel("RMS position error [mm]")
    runs = len(panels[0].errors["default"])
    axes[0][-1].legend(  # most fiducials, smallest errors: there is room above the curves
        fontsize=7, loc="upper right", title=f"{runs} runs, {100 * CONFIDENCE:.0f} % bands",
        title_fontsize=7,
    )  # fmt: skip
    for path in paths:
        save_figure(figure, path, 120)
