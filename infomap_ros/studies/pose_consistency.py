"""Are the poses as sure as they should be? Their errors against their own covariances.

The normalized estimation error squared (NEES) of a pose, e^T C^-1 e, has the mean 6 if the
covariance is right, that of a fiducial 3; more means too sure. Y. Bar-Shalom, X.-R. Li,
T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley 2001, section
5.4.2. In two more scenarios half of the fiducials in view begin to move as one body.

    infomap study pose-consistency --runs 100 --out DIR

The figure of the study of pose consistency.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import special, stats
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    PinholeCamera,
    invert_transform,
    make_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FilterUpdate
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import free_motion
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.studies.runs import markdown

CONFIDENCE = 0.95
_WRONG = 0.9999  # probability beyond which an error is not explained by the covariance
_WRONG_ERROR = 0.03  # [m]
_TIME = 0.3  # [s] between images, for a camera of which nothing else is known
_START = np.diag([0.01**2] * 3 + [0.003**2] * 3)
_REJECTIONS = 3  # after which a fiducial is given up


@dataclass(frozen=True)
class Scenario:
    """One kind of run.

    Attributes:
        name: for the table.
        with_odometry: or images alone.
        speed: of the body on which half of the fiducials are [m per image]; 0: nothing moves.
        turns: of the camera's circle.
    """

    name: str
    with_odometry: bool
    speed: float
    turns: float


SCENARIOS = (
    Scenario("odometry, loop", True, 0.0, 1.2),
    Scenario("images alone, loop", False, 0.0, 1.2),
    Scenario("odometry, half moves 50 mm an image", True, 0.05, 0.3),
    Scenario("images alone, half moves 50 mm an image", False, 0.05, 0.3),
)


@dataclass(frozen=True)
class PoseConsistencyConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    runs: int = parameter(100, "Random runs of each scenario.", low=2, high=100000)
    steps: int = parameter(40, "Images of each run.", low=10, high=10000)
    fiducials: int = parameter(250, "Fiducials in the room.", low=50, high=10000)
    measured: int = parameter(40, "Most fiducials measured in an image.", low=8, high=500)
    seed: int = parameter(0, "Seed of the first run.", low=0)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """What came of the runs of a scenario.

    Attributes:
        scenario: its description.
        halfway: NEES of the pose half way, shape (runs,).
        last: NEES of the last pose, shape (runs,).
        kept: of one kept pose of each run, drawn at random, at the end, shape (runs,).
        fiducial: of one fiducial likewise, shape (runs,).
        updated: share of images by which the pose was updated.
        wrong: number of updated poses whose error is beyond the covariance and 3 cm.
        images: number of all images.
        last_error: RMS position error of the last poses [m].
    """

    scenario: Scenario
    halfway: FloatArray
    last: FloatArray
    kept: FloatArray
    fiducial: FloatArray
    updated: float
    wrong: int
    images: int
    last_error: float

    @property
    def is_consistent(self) -> bool:
        """Whether all means lie in their bands; with a moving body, whether no pose is wrong."""
        if self.scenario.speed > 0.0:
            return self.wrong == 0
        checks = ((self.halfway, 6), (self.last, 6), (self.kept, 6), (self.fiducial, 3))
        return all(
            low <= values.mean() <= high
            for values, freedom in checks
            for low, high in [mean_band(len(values), freedom)]
        )


def mean_band(samples: int, freedom: int) -> tuple[float, float]:
    """Band of the mean of so many independent chi-square values of so many degrees of freedom."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = special.chdtri(samples * freedom, [1.0 - tail, tail]) / samples
    return float(low), float(high)


def run_pose_consistency(
    config: PoseConsistencyConfig, progress: Callable[[int], None] | None = None
) -> list[ScenarioResult]:
    """Run all scenarios.

    Args:
        config: size of the study.
        progress: called with the number of runs done.
    """
    results, done = [], 0
    for scenario in SCENARIOS:
        runs = []
        for number in range(config.runs):
            runs.append(_Run(scenario, config, np.random.default_rng([config.seed, number])))
            done += 1
            if progress is not None:
                progress(done)
        results.append(_summarize(scenario, runs))
    return results


class _Run:
    """One run: the filter in the room, and its errors."""

    def __init__(
        self, scenario: Scenario, config: PoseConsistencyConfig, rng: np.random.Generator
    ) -> None:
        self.scenario, self.config, self.rng = scenario, config, rng
        self.room = Room.random(config.fiducials, scenario.speed, rng)
        self.poses = circle(config.steps, scenario.turns)
        self.filter = FiducialFilter(CAMERA)
        self.nees: list[float] = []
        self.updated: list[bool] = []
        self.wrong = 0
        self._rejections: dict[int, int] = {}
        self._begin()
        for number in range(1, config.steps + 1):
            if scenario.speed > 0.0 and number > config.steps // 4:
                self.room.move_body()
            self._step(number)
        self.last_error = float(np.linalg.norm(pose_error(self.poses[-1], self.filter.pose[0])[:3]))
        self.kept, self.fiducial = self._kept_nees(), self._fiducial_nees()

    def _begin(self) -> None:
        error = self.rng.multivariate_normal(np.zeros(6), _START)
        start = perturb_transform(self.poses[0], -error)
        self.filter.start(start, _START)
        seen = self._observe(0)
        self.filter.add(seen)
        self.filter.keep_pose(0)

    def _observe(self, number: int) -> FiducialObservations:
        balanced = self.scenario.speed > 0.0
        return self.room.observe(self.poses[number], self.config.measured, balanced, self.rng)

    def _step(self, number: int) -> None:
        before, after = self.poses[number - 1], self.poses[number]
        prior = odometry(before, after, self.rng)
        self.filter.predict(prior if self.scenario.with_odometry else free_motion(_TIME))
        seen = self._observe(number)
        update = self.filter.update(seen)
        if update.is_consistent:
            self.filter.add(seen.select(np.isin(seen.ids, update.unknown)))
            self.filter.keep_pose(number)
        self._give_up(update)
        pose, covariance = self.filter.pose
        error = pose_error(after, pose)
        self.nees.append(_squared(error, covariance))
        self.updated.append(update.is_consistent)
        beyond = self.nees[-1] > special.chdtri(6, 1.0 - _WRONG)
        far = np.linalg.norm(error[:3]) > _WRONG_ERROR
        self.wrong += bool(update.is_consistent and beyond and far)

    def _give_up(self, update: FilterUpdate) -> None:
        """Remove fiducials that were rejected repeatedly."""
        for number in update.rejected.tolist():
            self._rejections[number] = self._rejections.get(number, 0) + 1
        gone = [n for n, count in self._rejections.items() if count >= _REJECTIONS]
        self.filter.remove(gone)
        for number in gone:
            del self._rejections[number]

    def _kept_nees(self) -> float:
        kept = self.filter.kept_poses()
        one = int(self.rng.integers(len(kept)))
        error = pose_error(self.poses[kept.stamps[one]], kept.transforms[one])
        return _squared(error, kept.covariances[one])

    def _fiducial_nees(self) -> float:
        fiducials = self.filter.fiducials()
        one = int(self.rng.integers(len(fiducials)))
        error = self.room.points[fiducials.ids[one]] - fiducials.positions[one]
        return _squared(error, fiducials.covariances[one])


def _summarize(scenario: Scenario, runs: Sequence[_Run]) -> ScenarioResult:
    updated = [share for run in runs for share in run.updated]
    return ScenarioResult(
        scenario,
        np.array([run.nees[len(run.nees) // 2] for run in runs]),
        np.array([run.nees[-1] for run in runs]),
        np.array([run.kept for run in runs]),
        np.array([run.fiducial for run in runs]),
        float(np.mean(updated)),
        sum(run.wrong for run in runs),
        len(updated),
        float(np.sqrt(np.mean([run.last_error**2 for run in runs]))),
    )


def _squared(error: FloatArray, covariance: FloatArray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def pose_table(results: Sequence[ScenarioResult]) -> str:
    """The results as a Markdown table."""
    runs = len(results[0].last)
    six, three = ("{:.2f} to {:.2f}".format(*mean_band(runs, freedom)) for freedom in (6, 3))
    names = [
        "scenario", f"pose half way ({six})", f"last pose ({six})", f"kept pose ({six})",
        f"fiducial ({three})", "updated", "wrong", "last error",
    ]  # fmt: skip
    lines = []
    for result in results:
        values = (result.halfway, result.last, result.kept, result.fiducial)
        means = ["-" if result.scenario.speed > 0.0 else f"{v.mean():.2f}" for v in values]
        lines.append([
            result.scenario.name, *means, f"{100 * result.updated:.1f} %",
            f"{result.wrong} of {result.images}", f"{1e3 * result.last_error:.0f} mm",
        ])  # fmt: skip
    return markdown(names, lines)


def pose_summary(results: Sequence[ScenarioResult], seconds: float) -> dict[str, float]:
    """The results as one flat object of figures."""
    figures: dict[str, float] = {"runs": len(results[0].last), "seconds": seconds}
    figures["band_low"], figures["band_high"] = mean_band(len(results[0].last), 6)
    for number, result in enumerate(results, start=1):
        figures[f"nees_last_{number}"] = float(result.last.mean())
        figures[f"nees_kept_{number}"] = float(result.kept.mean())
        figures[f"nees_fiducial_{number}"] = float(result.fiducial.mean())
        figures[f"updated_{number}"] = result.updated
        figures[f"wrong_{number}"] = result.wrong
        figures[f"last_error_{number}"] = result.last_error
    return figures


CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
PIXEL_SIGMA = 0.3  # [px]
INVERSE_DEPTH_SIGMA = 0.3 / (500.0 * 0.12)  # [1/m]: 0.3 px of disparity, baseline 0.12 m
ODOMETRY = np.diag([0.01**2] * 3 + [0.005**2] * 3)
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x, z is up


@dataclass(eq=False)
class Room:
    """Fiducials on a ring of radius 3 to 6 m, 3 m high; a random half may move as one body.

    Attributes:
        points: true positions now, shape (N, 3) [m].
        on_body: which are on the body, shape (N,).
        step: how the body moves from image to image, about its middle, shape (4, 4).
    """

    points: FloatArray
    on_body: NDArray[np.bool_]
    step: FloatArray

    @classmethod
    def random(cls, count: int, speed: float, rng: np.random.Generator) -> Room:
        """A room of so many fiducials, whose body moves by `speed` from image to image [m]."""
        angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(3.0, 6.0, count)
        height = rng.uniform(-1.5, 1.5, count)
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        direction = rng.normal(size=3)
        turn = Rotation.from_rotvec(0.1 * speed * rng.normal(size=3)).as_matrix()
        step = make_transform(turn, speed * direction / np.linalg.norm(direction))
        return cls(points, rng.random(count) < 0.5, step)

    def move_body(self) -> None:
        """Move the body on by one image."""
        body = self.points[self.on_body]
        middle = body.mean(axis=0)
        self.points[self.on_body] = transform_points(self.step, body - middle) + middle

    def observe(
        self, T_map_camera: FloatArray, most: int, balanced: bool, rng: np.random.Generator
    ) -> FiducialObservations:
        """Noisy measurements of fiducials in view.

        Args:
            T_map_camera: true pose, shape (4, 4).
            most: fiducials that are measured.
            balanced: half of them of the body.
            rng: of the noise.
        """
        inside = transform_points(invert_transform(T_map_camera), self.points)
        pixels = CAMERA.project(inside)
        last = [CAMERA.width - 1, CAMERA.height - 1]
        with np.errstate(invalid="ignore"):
            in_view = (inside[:, 2] > 0.3) & ((pixels >= 0) & (pixels <= last)).all(axis=1)
        groups = (self.on_body, ~self.on_body) if balanced else (np.ones(len(inside), bool),)
        share = most // len(groups)
        seen = np.concatenate([np.flatnonzero(in_view & group)[:share] for group in groups])
        noise = rng.normal(size=(len(seen), 3))
        return FiducialObservations(
            seen.astype(np.int64),
            pixels[seen] + PIXEL_SIGMA * noise[:, :2],
            np.full(len(seen), PIXEL_SIGMA),
            1.0 / inside[seen, 2] + INVERSE_DEPTH_SIGMA * noise[:, 2],
            np.full(len(seen), INVERSE_DEPTH_SIGMA),
        )


def circle(steps: int, turns: float) -> list[FloatArray]:
    """Poses ``T_map_camera`` on a circle of radius 1 m, looking outwards and a little ahead."""
    poses = []
    for angle in np.linspace(0.0, 2.0 * np.pi * turns, steps + 1):
        turn = Rotation.from_euler("zy", [angle + 0.3, 0.1 * np.sin(5 * angle)]).as_matrix()
        position = [np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)]
        poses.append(make_transform(turn @ _LEVEL, position))
    return poses


def odometry(before: FloatArray, after: FloatArray, rng: np.random.Generator) -> MotionPrior:
    """What odometry says of a motion, with errors of `ODOMETRY`."""
    error = rng.multivariate_normal(np.zeros(6), ODOMETRY)
    return MotionPrior(perturb_transform(invert_transform(before) @ after, -error), ODOMETRY)


def pose_error(true: FloatArray, estimated: FloatArray) -> FloatArray:
    """(dt, rotation vector) of docs/conventions.md, shape (6,)."""
    turned = Rotation.from_matrix(true[:3, :3] @ estimated[:3, :3].T).as_rotvec()
    return np.concatenate([true[:3, 3] - estimated[:3, 3], turned])


_COLORS = ("#08519c", "#009e73", "#d55e00")


def draw_nees(results: Sequence[ScenarioResult], path: str | Path) -> None:
    """Draw the distribution of the poses' NEES beside the chi-square one that it should be.

    Args:
        results: of `run_pose_consistency`; those with a moving body are left out.
        path: of the PNG file.
    """
    shown = [result for result in results if result.scenario.speed == 0.0]
    figure = Figure(figsize=(4.2 * len(shown), 3.4), layout="constrained")
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    x = np.linspace(0.0, 25.0, 300)
    for axis, result in zip(axes, shown, strict=True):
        curves = (
            ("half way", result.halfway), ("last", result.last), ("kept", result.kept)
        )  # fmt: skip
        for (name, values), color in zip(curves, _COLORS, strict=True):
            ordered = np.sort(values)
            share = np.arange(1, len(ordered) + 1) / len(ordered)
            axis.step(ordered, share, where="post", color=color, label=f"{name} pose")
        axis.plot(x, stats.chi2.cdf(x, 6), "k--", linewidth=1.0, label="chi-square, 6 d.o.f.")
        axis.set_xlim(0.0, 25.0)
        axis.set_title(result.scenario.name, fontsize=10)
        axis.set_xlabel("NEES [-]")
        axis.grid(True, linewidth=0.3)
    axes[0].set_ylabel("share of runs below [-]")
    axes[0].legend(fontsize=8, loc="lower right")
    save_figure(figure, path, 120)
