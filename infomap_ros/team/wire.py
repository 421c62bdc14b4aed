"""The wire format of map updates: packed rows with named fields, one per changed voxel.

A row holds the absolute state of a voxel in its robot's contribution, never a difference, with
the version at which it was taken (`infomap_ros.team.versions`). So a row may be lost, repeated or
come late: whoever keeps the newest version per robot and voxel is right. A robot takes a voxel
back by the log-odds `NOT_OBSERVED`.

Two layouts, told apart by their fields: `OCCUPANCY_ROW` for voxels without a Gaussian and
`SURFACE_ROW` for those with one. All numbers are little endian.

The Gaussian is quantised. Its mean is stored relative to the voxel's centre in steps of 1/1024
of the voxel size and saturates 32 voxels away from it. Its covariance is stored as C = L D L^T
with unit lower triangular L and diagonal D: the square roots of D as powers of two in steps of
2^(1/512) (0.14 %) and the three entries of L in single precision, so that every row decodes to a
positive definite matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import SHARED_LOG_ODDS_LIMIT, VoxelChanges

NOT_OBSERVED = -128
"""Log-odds of a voxel of which its robot knows nothing any more."""

MAX_MESSAGE_BYTES = 1_000_000
MEAN_STEP = 1.0 / 1024.0  # [voxels]
SIGMA_STEPS_PER_OCTAVE = 512
_LIMIT = 32767

_COMMON = [
    ("ix", "<i4"),
    ("iy", "<i4"),
    ("iz", "<i4"),
    ("voxel_size", "<f4"),
    ("version", "<u4"),
    ("robot", "<u2"),
    ("log_odds", "i1"),
]
OCCUPANCY_ROW = np.dtype(_COMMON)
SURFACE_ROW = np.dtype(
    [
        *_COMMON,
        ("mean_x", "<i2"),
        ("mean_y", "<i2"),
        ("mean_z", "<i2"),
        ("log_sigma_0", "<i2"),
        ("log_sigma_1", "<i2"),
        ("log_sigma_2", "<i2"),
        ("l_10", "<f4"),
        ("l_20", "<f4"),
        ("l_21", "<f4"),
    ]
)


@dataclass(frozen=True, eq=False)
class MapUpdate:
    """Absolute states of voxels in one robot's contribution, all taken at one version.

    Attributes:
        voxel_size: edge of a voxel [m].
        robot: id of the robot, 0 to 65535.
        version: of the robot's publication, 1 to 2^32 - 1.
        indices: shape (K, 3), int32; the voxel's centre is (index + 0.5) * voxel_size [m, map].
        log_odds: shape (K,), int8, in units of `mapping.LOG_ODDS_QUANTUM` and within +-
            `mapping.SHARED_LOG_ODDS_LIMIT`, or `NOT_OBSERVED`.
        has_gaussian: shape (K,), bool.
        means: shape (K, 3) [m, map]; NaN where there is no Gaussian.
        covariances: shape (K, 3, 3) [m^2]; NaN where there is no Gaussian.
    """

    voxel_size: float
    robot: int
    version: int
    indices: NDArray[np.int32]
    log_odds: NDArray[np.int8]
    has_gaussian: NDArray[np.bool_]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]

    @classmethod
    def of_changes(
        cls, changes: VoxelChanges, voxel_size: float, robot: int, version: int
    ) -> MapUpdate:
        """The update that tells the changes of a robot's map."""
        return cls(
            voxel_size,
            robot,
            version,
            changes.indices,
            changes.log_odds,
            changes.has_gaussian,
            changes.means,
            changes.covariances,
        )


def encode_update(update: MapUpdate, max_bytes: int = MAX_MESSAGE_BYTES) -> list[NDArray[np.void]]:
    """Turn an update into the rows of as many messages as it takes.

    Args:
        update: what to send.
        max_bytes: upper limit of the rows of one message.

    Returns:
        Row arrays of dtype `OCCUPANCY_ROW` or `SURFACE_ROW`, each at most `max_bytes` long.

    Raises:
        InvalidInputError: a Gaussian is not finite or not positive definite, or the robot id,
            the version or the log-odds do not fit.
    """
    if not 0 <= update.robot < 2**16 or not 1 <= update.version < 2**32:
        raise InvalidInputError("map update", f"robot {update.robot}, version {update.version}")
    _check_log_odds(update.log_odds)
    surface = update.has_gaussian
    occupancy_rows = _common_rows(update, ~surface, OCCUPANCY_ROW)
    surface_rows = _common_rows(update, surface, SURFACE_ROW)
    _put_gaussians(surface_rows, update.means[surface], update.covariances[surface])
    parts = []
    for rows in (occupancy_rows, surface_rows):
        length = max(1, max_bytes // rows.dtype.itemsize)
        parts += [rows[start : start + length] for start in range(0, len(rows), length)]
    return parts


def decode_update(rows: NDArray[np.void]) -> MapUpdate:
    """Read the rows of one message.

    Args:
        rows: shape (K,), dtype `OCCUPANCY_ROW` or `SURFACE_ROW`.

    Raises:
        InvalidInputError: no rows, other fields, rows of several robots, versions or voxel
            sizes, an impossible voxel size, version or log-odds, or a Gaussian that is not
            finite.
    """
    if rows.dtype not in (OCCUPANCY_ROW, SURFACE_ROW):
        raise InvalidInputError("map update", f"fields {rows.dtype.names}")
    if not len(rows):
        raise InvalidInputError("map update", "holds no voxels")
    for name in ("robot", "version", "voxel_size"):
        if (rows[name] != rows[name][0]).any():
            raise InvalidInputError("map update", f"holds more than one {name}")
    size = float(rows["voxel_size"][0])
    if not (np.isfinite(size) and size > 0.0):
        raise InvalidInputError("map update", f"voxel size {size} m")
    if rows["version"][0] == 0:
        raise InvalidInputError("map update", "version 0")
    _check_log_odds(rows["log_odds"])
    indices = np.stack([rows["ix"], rows["iy"], rows["iz"]], axis=-1)
    surface = rows.dtype == SURFACE_ROW
    count = len(rows)
    means = np.full((count, 3), np.nan)
    covariances = np.full((count, 3, 3), np.nan)
    if surface:
        means, covariances = _get_gaussians(rows, indices, size)
    return MapUpdate(
        size,
        int(rows["robot"][0]),
        int(rows["version"][0]),
        indices,
        rows["log_odds"].copy(),
        np.full(count, surface),
        means,
        covariances,
    )


def _check_log_odds(log_odds: NDArray[np.int8]) -> None:
    outside = np.abs(log_odds.astype(np.int16)) > SHARED_LOG_ODDS_LIMIT
    wrong = outside & (log_odds != NOT_OBSERVED)
    if wrong.any():
        raise InvalidInputError("map update", f"log-odds {int(log_odds[wrong][0])}")


def _common_rows(
    update: MapUpdate, chosen: NDArray[np.bool_], dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    indices = update.indices[chosen]
    rows = np.zeros(len(indices), dtype)
    rows["ix"], rows["iy"], rows["iz"] = indices.T
    rows["voxel_size"] = update.voxel_size
    rows["version"] = update.version
    rows["robot"] = update.robot
    rows["log_odds"] = update.log_odds[chosen]
    return rows


def _put_gaussians(
    rows: NDArray[np.void], means: NDArray[np.float64], covariances: NDArray[np.float64]
) -> None:
    if not len(rows):
        return
    size = rows["voxel_size"].astype(np.float64)[:, None]
    indices = np.stack([rows["ix"], rows["iy"], rows["iz"]], axis=-1)
    offsets = (means / size - (indices + 0.5)) / MEAN_STEP
    if not np.isfinite(offsets).all():
        raise InvalidInputError("map update", "a mean is not finite")
    steps = np.clip(np.rint(offsets), -_LIMIT, _LIMIT).astype(np.int16)
    rows["mean_x"], rows["mean_y"], rows["mean_z"] = steps.T
    pivots, lower = _unit_lower_factor(covariances)
    if not (np.isfinite(pivots).all() and (pivots > 0.0).all()):
        raise InvalidInputError("map update", "a covariance is not positive definite")
    exponents = np.rint(0.5 * np.log2(pivots) * SIGMA_STEPS_PER_OCTAVE)
    exponents = np.clip(exponents, -_LIMIT, _LIMIT).astype(np.int16)
    rows["log_sigma_0"], rows["log_sigma_1"], rows["log_sigma_2"] = exponents.T
    rows["l_10"], rows["l_20"], rows["l_21"] = lower.T


def _unit_lower_factor(
    covariances: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """C = L D L^T: D, shape (K, 3), and (L10, L20, L21), shape (K, 3)."""
    c = covariances
    with np.errstate(divide="ignore", invalid="ignore"):
        d0 = c[:, 0, 0]
        l10, l20 = c[:, 1, 0] / d0, c[:, 2, 0] / d0
        d1 = c[:, 1, 1] - l10 * l10 * d0
        l21 = (c[:, 2, 1] - l20 * l10 * d0) / d1
        d2 = c[:, 2, 2] - l20 * l20 * d0 - l21 * l21 * d1
    return np.stack([d0, d1, d2], axis=-1), np.stack([l10, l20, l21], axis=-1)


def _get_gaussians(
    rows: NDArray[np.void], indices: ArrayLike, size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    offsets = np.stack([rows["mean_x"], rows["mean_y"], rows["mean_z"]], axis=-1)
    means = (np.asarray(indices) + 0.5 + offsets * MEAN_STEP) * size
    exponents = np.stack([rows[f"log_sigma_{axis}"] for axis in range(3)], axis=-1)
    scale = np.exp2(exponents / SIGMA_STEPS_PER_OCTAVE)
    factor = np.zeros((len(rows), 3, 3))
    factor[:, [0, 1, 2], [0, 1, 2]] = 1.0
    factor[:, 1, 0], factor[:, 2, 0], factor[:, 2, 1] = rows["l_10"], rows["l_20"], rows["l_21"]
    if not np.isfinite(factor).all():
        raise InvalidInputError("map update", "a covariance is not finite")
    factor *= scale[:, None, :]
    return means, factor @ factor.transpose(0, 2, 1)
