"""What localization is compared with follows a camera whose poses are known, and coasts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.geometry import invert_transform

from .fiducial_scene import pose_error, squared_distance
from .room_views import STEP, dark, looking, view

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
POSES = [looking((-0.5 + 0.03 * i, 0.2, 0.1), 0.03 * i - 0.3, 0.05) for i in range(14)]
VIEWS = [view((1 + i) * STEP, pose, seed=i) for i, pose in enumerate(POSES)]
COVERED = 6


def poses_from_first() -> list[np.ndarray]:
    """True T_first_camera."""
    return [invert_transform(POSES[0]) @ pose for pose in POSES]


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> Any:
    pytest.importorskip("gtsam")
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import localize_sequences

    return localize_sequences.BASELINES


@pytest.mark.parametrize(("name", "most"), [("klt_gtsam", 0.003), ("klt_pnp", 0.008)])
def test_peer_follows_a_camera(peers: Any, name: str, most: float) -> None:
    followed = peers[name](VIEWS)
    assert followed.stamps == [view.stamp for view in VIEWS]
    assert followed.failures == 0
    errors = map(pose_error, poses_from_first(), followed.poses)
    assert max(np.linalg.norm(error[:3]) for error in errors) < most


def test_smoother_says_how_far_it_may_err(peers: Any) -> None:
    followed = peers["klt_gtsam"](VIEWS)
    errors = list(map(pose_error, poses_from_first(), followed.poses))
    distances = list(map(squared_distance, errors[1:], followed.covariances[1:]))
    assert max(distances) < 27.9  # 99.99 % of poses with six degrees of freedom
    assert np.median(distances) > 0.3
    variances = np.trace(followed.covariances, axis1=1, axis2=2)
    assert variances[0] < 1e-10
    assert max(variances) < 0.003**2 + 0.003**2


@pytest.mark.parametrize("name", ["klt_gtsam", "klt_pnp"])
def test_peer_keeps_its_speed_while_the_camera_is_covered(peers: Any, name: str) -> None:
    views = [*VIEWS[:COVERED], dark(VIEWS[COVERED].stamp), *VIEWS[COVERED + 1 :]]
    followed = peers[name](views)
    assert followed.failures == 2  # to the dark view and from it
    errors = map(pose_error, poses_from_first(), followed.poses)
    assert max(np.linalg.norm(error[:3]) for error in errors) < 0.015


def test_smoother_knows_little_after_it_saw_nothing(peers: Any) -> None:
    views = [*VIEWS[:4], dark(VIEWS[4].stamp), *VIEWS[5:7]]
    sigmas = np.sqrt(np.diagonal(peers["klt_gtsam"](views).covariances, axis1=1, axis2=2))
    assert sigmas[3].max() < 0.003
    assert sigmas[4, :3] == pytest.approx(0.5, rel=0.01)  # of a coasted step [m]
    assert sigmas[4, 3:] == pytest.approx(0.2, rel=0.01)  # [rad]
    assert sigmas[6].max() < 1.0  # a coasted step more, and found again from there
