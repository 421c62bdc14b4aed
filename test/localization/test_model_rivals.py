"""What tells a pose of a nearly symmetric model from its half turn: where they differ."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target import model_target
from infomap_ros.localization.target.config import ModelTargetConfig
from infomap_ros.localization.target.model_check import Evidence, PoseComparison
from infomap_ros.localization.target.model_scene import shape_from_triangles
from infomap_ros.localization.target.model_target import ModelTargetDetector
from infomap_ros.localization.target.target import TargetRefusal

from .model_scenes import CloudView, knobbed_box, range_map

TOLERANCE, SPACING = 0.0045, 0.006  # of a diameter of 0.3 m
HALF_TURN = make_transform(Rotation.from_rotvec([0.0, 0.0, np.pi]).as_matrix(), (0.0, 0.0, 0.0))
ABOVE = Rotation.from_euler("xz", [2.4, 0.5]).as_matrix()  # the camera sees the face at +z
BELOW = Rotation.from_euler("xz", [0.7, 0.5]).as_matrix()


def evidence(turn: FloatArray, rng: np.random.Generator, *, swapped: bool = False) -> Evidence:
    triangles = knobbed_box(0.04)
    shape = shape_from_triangles(triangles)
    pose = make_transform(turn, (0.0, 0.0, 0.8))
    cloud = range_map(triangles, pose, rng, clutter=0)
    comparison = PoseComparison(
        shape.thinned(SPACING), shape.thinned(0.4 * SPACING), SPACING, TOLERANCE
    )
    poses = (pose, pose @ HALF_TURN)
    return comparison.evidence(cloud, *(reversed(poses) if swapped else poses))


def test_a_knob_in_sight_tells_the_pose(rng: np.random.Generator) -> None:
    found = evidence(ABOVE, rng)
    # at both poses it has some 1,600 mm^2 to each of two or three sides that face the camera
    assert 60 < found.places < 400
    assert found.against_share < 0.1


def test_it_speaks_against_the_other_pose(rng: np.random.Generator) -> None:
    found = evidence(ABOVE, rng, swapped=True)
    assert found.places > 60
    assert found.against_share > 0.9


def test_a_knob_out_of_sight_tells_nothing(rng: np.random.Generator) -> None:
    found = evidence(BELOW, rng)
    assert found.places < 40
    assert Evidence(0, 0).against_share == 1.0


def test_a_box_with_a_speck_is_refused_as_ambiguous(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    triangles = knobbed_box(0.008)
    monkeypatch.setattr(model_target, "_DISTINCTION", 0.0)
    monkeypatch.setattr(model_target, "_MAX_FLAT", 1.0)
    detector = ModelTargetDetector(ModelTargetConfig(), shape_from_triangles(triangles))
    pose = make_transform(ABOVE, (0.0, 0.0, 0.8))
    result = detector.detect(CloudView(range_map(triangles, pose, rng, clutter=0)))
    assert isinstance(result, TargetRefusal)
    assert result.reason == "ambiguous"
    assert "points tell it from a pose" in result.detail
