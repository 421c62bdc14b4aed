"""Is the map as sure as it should be? Its errors against its own covariances, in simulation.

For a surface voxel with mean x and covariance C, d the signed distance of x from the true surface
and n the normal there, the normalized error is d / sqrt(n^T C n). Its square (NEES, one degree of
freedom) has the mean 1 if the covariance is right, more if the map is too sure of itself.
Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
Wiley 2001, section 5.4.2.

Errors of scans are independent, or shared as those of `infomap_ros.studies.scan_sequences`. Where
the map's frame is misplaced as a whole, there are two truths: of a surface in the world (absolute)
and of a surface relative to the rest of the map.

    infomap study map-consistency --scenes 200 --out DIR
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from infomap_ros.geometry import PinholeCamera, transform_points
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.studies.noisy_scans import (
    CAMERA,
    AnalyticScene,
    NoisyScan,
    random_scene,
    simulate_scans,
)
from infomap_ros.studies.runs import markdown
from infomap_ros.studies.scan_sequences import CAMERA as SEQUENCE_CAMERA
from infomap_ros.studies.scan_sequences import CASES, ScanSequence, simulate_sequence

INDEPENDENT = "independent"
"""The case in which no two scans share an error."""

CONFIDENCE = 0.95
"""Of the band in which the mean NEES of independent samples is expected."""


@dataclass(frozen=True)
class ConsistencyConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    scenes: int = parameter(200, "Random scenes, each with its own seed.", low=2, high=100000)
    views: int = parameter(5, "Scans of each scene with independent errors.", low=1, high=100)
    scans: int = parameter(100, "Scans of each sequence with shared errors.", low=2, high=10000)
    cases: tuple[str, ...] = parameter(
        (INDEPENDENT, *CASES), "What scans share.", choices=(INDEPENDENT, *CASES)
    )
    correlations: tuple[float, ...] = parameter(
        (0.0, VoxelMapConfig.error_correlation),
        "Correlations of the range errors of neighboring pixels to try.",
        low=0.0,
        high=1.0,
    )
    voxel_sizes: tuple[float, ...] = parameter(
        (0.02, 0.05), "Voxel sizes to try.", unit="m", low=0.002, high=0.5
    )
    voxels_per_scene: int = parameter(
        300,
        "Surface voxels, drawn at random, that are looked at in each scene.",
        low=2,
        high=100000,
    )
    seed: int = parameter(0, "Seed of the first scene.", low=0)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class Setting:
    """What is tried on every scene.

    Attributes:
        case: what scans share.
        correlation: of the range errors of neighboring pixels.
        voxel_size: [m].
        relative: errors within the map in place of those in the world.
    """

    case: str
    correlation: float
    voxel_size: float
    relative: bool = False

    @property
    def key(self) -> str:
        """Name in a summary."""
        kind = "_relative" if self.relative else ""
        pixels = "_correlated_pixels" if self.correlation else ""
        return f"{self.case}{kind}{pixels}_{1000 * self.voxel_size:g}mm"


@dataclass(frozen=True, eq=False)
class ConsistencyResult:
    """Normalized errors of one setting.

    Attributes:
        setting: what was tried.
        independent: of one random surface voxel per scene, shape (scenes,): independent samples.
        all_errors: of `voxels_per_scene` voxels of each scene, shape (n,). Voxels of one scene
            share the errors of its poses.
    """

    setting: Setting
    independent: FloatArray
    all_errors: FloatArray

    @property
    def mean_nees(self) -> float:
        """Mean squared normalized error of the independent samples."""
        return float(np.mean(self.independent**2))

    @property
    def mean_nees_of_all(self) -> float:
        """Mean squared normalized error of all voxels looked at."""
        return float(np.mean(self.all_errors**2))

    @property
    def band(self) -> tuple[float, float]:
        """Where `mean_nees` is with CONFIDENCE if the map is consistent."""
        low, high = nees_band(len(self.independent))
        return low, high

    @property
    def is_consistent(self) -> bool:
        """Whether `mean_nees` is within the band, or above it by no more than a fifth."""
        low, high = self.band
        return low <= self.mean_nees <= 1.2 * high

    def shares_within(self) -> tuple[float, float, float]:
        """Shares of all voxels within 1, 2 and 3 standard deviations."""
        one, two, three = (float(np.mean(np.abs(self.all_errors) <= k)) for k in (1, 2, 3))
        return one, two, three


def nees_band(samples: int) -> tuple[float, float]:
    """Band of the mean of so many independent chi-square values of one degree of freedom."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = special.chdtri(samples, [1.0 - tail, tail]) / samples
    return float(low), float(high)


def settings_of(config: ConsistencyConfig) -> list[Setting]:
    """All settings of a study, in the order of its table."""
    return [
        Setting(case, correlation, size, relative)
        for case in config.cases
        for correlation in config.correlations
        for size in config.voxel_sizes
        for relative in ((False, True) if case == "offset" else (False,))
    ]


def map_scans(
    scans: Sequence[NoisyScan], voxel_size: float, correlation: float, camera: PinholeCamera
) -> CorrectableMap:
    """A map of scans, numbered from 0 on in place of stamps.

    Args:
        scans: in order of time.
        voxel_size: [m].
        correlation: of the range errors of neighboring pixels, in [0, 1].
        camera: that took them.
    """
    config = VoxelMapConfig(voxel_size=voxel_size, error_correlation=correlation)
    mapped = CorrectableMap(VoxelMap(config))
    for number, scan in enumerate(scans):
        mapped.integrate(
            number, scan.points, scan.pose, scan.covariances, scan.pose_covariance, camera
        )
    return mapped


def map_sequence(sequence: ScanSequence, voxel_size: float, correlation: float) -> VoxelMap:
    """A map of a sequence, after the corrections that it has; for the arguments see `map_scans`."""
    mapped = map_scans(sequence.scans, voxel_size, correlation, SEQUENCE_CAMERA)
    if (known := sequence.corrections) is not None:
        mapped.receive_poses(len(sequence.scans), known.scans, known.poses, known.covariances)
        mapped.correct()
    return mapped.voxel_map


def normalized_errors(
    scene: AnalyticScene,
    voxel_map: VoxelMap,
    count: int,
    rng: np.random.Generator,
    T_world_map: FloatArray | None = None,
) -> FloatArray:
    """Normalized errors of surface voxels drawn at random, shape (at most count,).

    Args:
        scene: the truth.
        voxel_map: what was mapped of it.
        count: of voxels.
        rng: random numbers.
        T_world_map: where the map's frame truly is, shape (4, 4), for errors within the map; errors
            in the world where not given.
    """
    _, means, covariances = voxel_map.gaussians(relative=T_world_map is not None)
    chosen = rng.permutation(len(means))[:count]
    means, covariances = means[chosen], covariances[chosen]
    if T_world_map is not None:
        means = transform_points(T_world_map, means)
        covariances = T_world_map[:3, :3] @ covariances @ T_world_map[:3, :3].T
    normals = scene.normals(means)
    variances = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    return np.asarray(scene.signed_distance(means) / np.sqrt(variances))


def _errors_of_scene(config: ConsistencyConfig, number: int) -> dict[Setting, FloatArray]:
    """Normalized errors in one scene, by setting."""
    found = {}
    for case in config.cases:
        for correlation in config.correlations:
            rng = np.random.default_rng([config.seed + number, config.cases.index(case)])
            scene, count = random_scene(rng), config.voxels_per_scene
            if case == INDEPENDENT:
                scans = simulate_scans(scene, config.views, rng, correlation)
            else:
                sequence = simulate_sequence(case, scene, config.scans, correlation, rng)
            for size in config.voxel_sizes:
                if case == INDEPENDENT:
                    voxel_map = map_scans(scans, size, correlation, CAMERA).voxel_map
                else:
                    voxel_map = map_sequence(sequence, size, correlation)
                setting = Setting(case, correlation, size)
                found[setting] = normalized_errors(scene, voxel_map, count, rng)
                if case == "offset":
                    truth = sequence.T_world_map
                    within = normalized_errors(scene, voxel_map, count, rng, truth)
                    found[Setting(case, correlation, size, relative=True)] = within
    return found


def run_study(
    config: ConsistencyConfig, progress: Callable[[int], None] | None = None
) -> list[ConsistencyResult]:
    """Map random scenes and compare with the truth.

    Args:
        config: size of the study.
        progress: called with the number of scenes done.

    Returns:
        One result per setting.
    """
    scenes = []
    for number in range(config.scenes):
        scenes.append(_errors_of_scene(config, number))
        if progress is not None:
            progress(number + 1)
    return [
        ConsistencyResult(
            setting,
            np.array([scene[setting][0] for scene in scenes]),
            np.concatenate([scene[setting] for scene in scenes]),
        )
        for setting in settings_of(config)
    ]


def table(results: Sequence[ConsistencyResult]) -> str:
    """The results as a Markdown table."""
    names = [
        "scans", "errors", "pixels", "voxel", "scenes", "mean NEES",
        f"{100 * CONFIDENCE:.0f} % band", "mean NEES of all voxels", "within 1, 2, 3 sigma",
    ]  # fmt: skip
    lines = []
    for result in results:
        setting, (low, high) = result.setting, result.band
        shares = ", ".join(f"{100 * share:.1f}" for share in result.shares_within())
        lines.append([
            setting.case, "relative" if setting.relative else "absolute",
            f"correlate by {setting.correlation:g}" if setting.correlation else "independent",
            f"{100 * setting.voxel_size:g} cm", len(result.independent),
            f"{result.mean_nees:.2f}", f"{low:.2f} to {high:.2f}",
            f"{result.mean_nees_of_all:.2f}", f"{shares} %",
        ])  # fmt: skip
    return markdown(names, lines)


def summary(results: Sequence[ConsistencyResult], seconds: float) -> dict[str, float]:
    """The results as one flat object of figures."""
    figures: dict[str, float] = {"scenes": len(results[0].independent), "seconds": seconds}
    for result in results:
        figures[f"nees_{result.setting.key}"] = result.mean_nees
        figures[f"nees_all_{result.setting.key}"] = result.mean_nees_of_all
        figures["band_low"], figures["band_high"] = result.band
    return figures
