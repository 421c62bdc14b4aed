"""Is the map as sure as it should be? Its errors against its own covariances, in simulation.

For a surface voxel with mean x and covariance C, d the signed distance of x from the true surface
and n the normal there, the normalised error is d / sqrt(n^T C n). Its square (NEES, one degree of
freedom) has the mean 1 if the covariance is right, more if the map is too sure of itself.
Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
Wiley 2001, section 5.4.2.

    infomap study map-consistency --scenes 200 --out DIR
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.analytic_scene import AnalyticScene, random_scene
from infomap_ros.studies.common.tables import markdown
from infomap_ros.studies.noisy_scans import CAMERA, NoisyScan, simulate_scans

CONFIDENCE = 0.95
"""Of the band in which the mean NEES of independent samples is expected."""


@dataclass(frozen=True)
class ConsistencyConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    scenes: int = parameter(200, "Random scenes, each with its own seed.", low=2, high=100000)
    views: int = parameter(5, "Scans of each scene.", low=1, high=100)
    voxel_sizes: tuple[float, ...] = parameter(
        (0.01, 0.02, 0.05), "Voxel sizes to try.", unit="m", low=0.002, high=0.5
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


@dataclass(frozen=True, eq=False)
class ConsistencyResult:
    """Normalised errors at one voxel size.

    Attributes:
        voxel_size: [m].
        independent: of one random surface voxel per scene, shape (scenes,): independent samples.
        all_errors: of `voxels_per_scene` voxels of each scene, shape (n,). Voxels of one scene
            share the errors of its poses.
    """

    voxel_size: float
    independent: FloatArray
    all_errors: FloatArray

    @property
    def mean_nees(self) -> float:
        """Mean squared normalised error of the independent samples."""
        return float(np.mean(self.independent**2))

    @property
    def mean_nees_of_all(self) -> float:
        """Mean squared normalised error of all voxels looked at."""
        return float(np.mean(self.all_errors**2))

    @property
    def band(self) -> tuple[float, float]:
        """Where `mean_nees` is with CONFIDENCE if the map is consistent."""
        low, high = nees_band(len(self.independent))
        return low, high

    @property
    def is_consistent(self) -> bool:
        """Whether `mean_nees` is within the band."""
        low, high = self.band
        return low <= self.mean_nees <= high

    def shares_within(self) -> tuple[float, float, float]:
        """Shares of all voxels within 1, 2 and 3 standard deviations."""
        one, two, three = (float(np.mean(np.abs(self.all_errors) <= k)) for k in (1, 2, 3))
        return one, two, three


def nees_band(samples: int) -> tuple[float, float]:
    """Band of the mean of so many independent chi-square values of one degree of freedom."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = special.chdtri(samples, [1.0 - tail, tail]) / samples
    return float(low), float(high)


def map_scans(scans: Sequence[NoisyScan], voxel_size: float) -> VoxelMap:
    """A map of scans whose points are independent, with voxels of this size [m]."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=voxel_size, error_correlation=0.0))
    for scan in scans:
        voxel_map.integrate(scan.points, scan.pose, scan.covariances, scan.pose_covariance, CAMERA)
    return voxel_map


def normalised_errors(
    scene: AnalyticScene, voxel_map: VoxelMap, count: int, rng: np.random.Generator
) -> FloatArray:
    """Normalised errors of surface voxels drawn at random, shape (at most count,)."""
    _, means, covariances = voxel_map.gaussians()
    chosen = rng.permutation(len(means))[:count]
    means, covariances = means[chosen], covariances[chosen]
    normals = scene.normals(means)
    variances = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    return np.asarray(scene.signed_distance(means) / np.sqrt(variances))


def run_study(
    config: ConsistencyConfig, progress: Callable[[int], None] | None = None
) -> list[ConsistencyResult]:
    """Map random scenes and compare with the truth.

    Args:
        config: size of the study.
        progress: called with the number of scenes done.

    Returns:
        One result per voxel size.
    """
    errors: list[list[FloatArray]] = [[] for _ in config.voxel_sizes]
    for number in range(config.scenes):
        rng = np.random.default_rng(config.seed + number)
        scene = random_scene(rng)
        scans = simulate_scans(scene, config.views, rng)
        for size, collected in zip(config.voxel_sizes, errors, strict=True):
            voxel_map = map_scans(scans, size)
            collected.append(normalised_errors(scene, voxel_map, config.voxels_per_scene, rng))
        if progress is not None:
            progress(number + 1)
    return [
        ConsistencyResult(
            size, np.array([scene[0] for scene in collected]), np.concatenate(collected)
        )
        for size, collected in zip(config.voxel_sizes, errors, strict=True)
    ]


def table(results: Sequence[ConsistencyResult]) -> str:
    """The results as a Markdown table."""
    names = [
        "voxel", "scenes", "mean NEES", f"{100 * CONFIDENCE:.0f} % band",
        "mean NEES of all voxels", "within 1, 2, 3 sigma",
    ]  # fmt: skip
    lines = []
    for result in results:
        low, high = result.band
        shares = ", ".join(f"{100 * share:.1f}" for share in result.shares_within())
        lines.append([
            f"{100 * result.voxel_size:g} cm", len(result.independent), f"{result.mean_nees:.2f}",
            f"{low:.2f} to {high:.2f}", f"{result.mean_nees_of_all:.2f}", f"{shares} %",
        ])  # fmt: skip
    return markdown(names, lines)


def summary(results: Sequence[ConsistencyResult], seconds: float) -> dict[str, float]:
    """The results as one flat object of figures."""
    figures: dict[str, float] = {"scenes": len(results[0].independent), "seconds": seconds}
    for result in results:
        key = f"{1000 * result.voxel_size:g}mm"
        figures[f"nees_{key}"] = result.mean_nees
        figures[f"nees_all_{key}"] = result.mean_nees_of_all
        figures["band_low"], figures["band_high"] = result.band
    return figures
