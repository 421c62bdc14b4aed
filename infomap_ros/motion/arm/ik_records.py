"""How inverse kinematics is asked and answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class IkConfig:
    """How exactly, and how long, joint positions are searched for.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = parameter(
        1e-4,
        "Largest distance between the camera and its target. Where the arm cannot reach a target "
        "exactly, the two tolerances also say how an error of the position is weighed against one "
        "of the rotation.",
        unit="m",
        low=1e-6,
        high=10.0,
    )
    rotation_tolerance: float = parameter(
        1e-3,
        "Largest angle between the camera and its target, or between their viewing directions.",
        unit="rad",
        low=1e-6,
        high=3.2,
    )
    restarts: int = parameter(
        50,
        "Random starts after the first one; each takes about 20 us.",
        low=0,
        high=100_000,
    )
    iterations: int = parameter(
        40, "Largest number of iterations from one start.", low=1, high=10_000
    )
    solutions: int = parameter(
        1,
        "Solutions to find before the one nearest to the start, by the time of the slowest joint, "
        "is taken.",
        low=1,
        high=1000,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class IkResult:
    """Joint positions for one target.

    Attributes:
        q: positions of the chain, shape (n,) [rad or m]; where not converged, those of the least
            error that was found, or a refused solution.
        converged: within the tolerances and the limits, and valid.
        reason: why not converged, in words; empty where it is.
        position_error: distance of the camera at `q` from its target [m].
        rotation_error: angle at `q` between the camera and its target, or between their viewing
            directions [rad].
        restarts: random starts that were used.
    """

    q: FloatArray
    converged: bool
    reason: str
    position_error: float
    rotation_error: float
    restarts: int


@dataclass(frozen=True, eq=False)
class IkBatch:
    """Joint positions for M targets; see `IkResult`.

    Attributes:
        q: shape (M, n) [rad or m].
        converged: shape (M,).
        reasons: why not converged, empty where it is; M of them.
        position_errors: shape (M,) [m].
        rotation_errors: shape (M,) [rad].
        restarts: shape (M,).
    """

    q: FloatArray
    converged: NDArray[np.bool_]
    reasons: tuple[str, ...]
    position_errors: FloatArray
    rotation_errors: FloatArray
    restarts: NDArray[np.int64]
