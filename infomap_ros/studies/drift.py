"""How far the camera's position drifts when scene fiducials alone tell of its motion (Fig. 15).

Fig. 15 of doi:10.1177/0278364905051774: the RMS position error over 50 steps grows with the way,
and falls with redundant fiducials (1, 2, 4 times the necessary number) and with their nearness
(mean distance 1,100 mm and 350 mm). Three methods see the same measurements:

- ``printed``: eq. (14), corrected (`printed_motion`), from each step to the next;
- ``weighted``: `estimate_motion` with covariances and gates, likewise from each step to the next;
- ``default``: `FiducialFilter`, which keeps what it knows of each fiducial.

    infomap study drift --out DIR
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import CONFIDENCE
from infomap_ros.studies.drift_walk import METHODS, NECESSARY, WalkErrors, WalkTask
from infomap_ros.studies.fiducial_walk import WalkConfig

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
