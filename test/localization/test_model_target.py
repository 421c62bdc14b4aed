"""A CAD model found in range maps: right, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import make_transform, perturb_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.config import ModelTargetConfig, TargetConfig, make_detector
from infomap_ros.localization.target.model_check import check_pose, flat_share, visible_points
from infomap_ros.localization.target.model_scene import (
    ModelScene,
    ModelShape,
    load_model,
    on_large_planes,
    shape_from_triangles,
)
from infomap_ros.localization.target.model_search import build_table, register, vote
from infomap_ros.localization.target.model_target import ModelFitter, ModelTargetDetector
from infomap_ros.localization.target.target import TargetRefusal, TargetSighting

from .model_scenes import CloudView, box, bracket, on_triangles, range_map, some_pose
from .tag_scenes import pose_error


@pytest.fixture(scope="module")
def detector() -> ModelTargetDetector:
    return ModelTargetDetector(ModelTargetConfig(), shape_from_triangles(bracket()))


def is_near(pose: FloatArray, truth: FloatArray) -> bool:
    error = pose_error(pose, truth)
    return bool(np.linalg.norm(error[:3]) < 0.005 and np.linalg.norm(error[3:]) < np.radians(3.0))


def test_normals_point_out_of_the_mesh_whichever_way_its_triangles_do() -> None:
    triangles = box((0.2, 0.3, 0.4))
    mixed = np.where(np.arange(12)[:, None, None] % 3 == 0, triangles[:, ::-1], triangles)
    shape = shape_from_triangles(mixed)
    outward = np.einsum("ni,ni->n", shape.normals, shape.points / [0.2, 0.3, 0.4])
    assert (outward > 0.0).all()
    np.testing.assert_allclose(shape.diameter, np.sqrt(0.29), rtol=0.01)


def test_what_is_inside_is_not_part_of_the_surface() -> None:
    shape = shape_from_triangles(np.concatenate([box((0.4, 0.4, 0.4)), box((0.1, 0.1, 0.1))]))
    assert np.mean(np.abs(shape.points).max(axis=1) < 0.19) < 0.02


def test_thinning_keeps_points_of_the_surface_about_one_spacing_apart() -> None:
    shape = shape_from_triangles(box((0.2, 0.2, 0.2)))
    thinned = shape.thinned(0.02)
    assert 500 <= len(thinned.points) <= 1000  # 6 faces of 10 x 10, cubes shared at the edges
    assert np.abs(np.abs(thinned.points).max(axis=1) - 0.1).max() < 1e-9


def test_pairs_vote_for_the_true_pose(rng: np.random.Generator) -> None:
    shape = shape_from_triangles(bracket()).thinned(0.015)
    pose = some_pose(rng)
    points = transform_points(pose, shape.points)
    normals = shape.normals @ pose[:3, :3].T
    votes = vote(
        build_table(shape.points, shape.normals, shape.diameter),
        points,
        normals,
        np.arange(0, len(points), 10),
    )
    errors = np.array([pose_error(found, pose) for found in votes.transforms])
    turned = np.linalg.norm(errors[:, 3:], axis=1)
    assert np.mean(turned < np.radians(12.0)) > 0.9


def test_registration_moves_a_model_onto_the_range_map(rng: np.random.Generator) -> None:
    shape = shape_from_triangles(bracket())
    turn = Rotation.from_euler("xyz", [2.5, 0.4, 0.3]).as_matrix()
    pose = make_transform(turn, [0.0, 0.0, 0.7])
    scene = ModelScene.of_cloud(range_map(bracket(), pose, rng, clutter=0), 0.006)
    source = shape.points[visible_points(shape, pose, 0.003)][::20]
    start = perturb_transform(pose, rng.normal(0.0, 0.01, 6))
    found = register(source, scene, start, 0.02, iterations=30)
    assert np.linalg.norm(pose_error(start, pose)[:3]) > 0.01
    assert is_near(found, pose)


def test_the_check_tells_agreement_from_seeing_through_and_hiding(
    rng: np.random.Generator,
) -> None:
    shape = shape_from_triangles(bracket()).thinned(0.006)
    pose = some_pose(rng)
    cloud = range_map(bracket(), pose, rng, clutter=0)
    ray = pose[:3, 3] / np.linalg.norm(pose[:3, 3])

    def moved(meters: float) -> FloatArray:
        return perturb_transform(pose, np.append(meters * ray, np.zeros(3)))

    assert check_pose(shape, pose, cloud, 0.006, 0.004).score > 0.9
    assert check_pose(shape, moved(-0.05), cloud, 0.006, 0.004).seen_through > 0.8
    assert check_pose(shape, moved(0.05), cloud, 0.006, 0.004).hidden > 0.8


def test_a_pose_in_the_middle_of_a_wall_has_no_outline(rng: np.random.Generator) -> None:
    plate = shape_from_triangles(box((0.2, 0.2, 0.01))).thinned(0.006)
    pose = np.eye(4)
    pose[2, 3] = 1.005
    wall = range_map(box((0.4, 0.4, 0.01)), pose, rng, clutter=0)
    agreement = check_pose(plate, pose, wall, 0.006, 0.004)
    assert agreement.agreeing > 0.9
    assert agreement.open_outline < 0.1
    assert agreement.score < 0.2


def test_the_fit_is_as_good_as_it_says(rng: np.random.Generator) -> None:
    """Mean NEES of about 12 range maps within the 99 % band about six, or below."""
    shape = shape_from_triangles(bracket())
    fitter, coarse = ModelFitter(shape.thinned(0.002), 0.0005), shape.thinned(0.006)
    values: list[float] = []
    for _ in range(16):
        pose = some_pose(rng)
        if flat_share(coarse, pose, 0.006, 0.005) > 0.6:
            continue  # refused as ambiguous: the plate alone does not tell where it is
        cloud = range_map(bracket(), pose, rng, clutter=0)
        fit = fitter.fit(cloud, perturb_transform(pose, rng.normal(0.0, 0.004, 6)), 0.01)
        if fit is None:
            continue  # nor do planes that are parallel
        error = pose_error(fit.transform, pose)
        values.append(error @ np.linalg.solve(fit.covariance, error))
    assert len(values) >= 9
    assert 1.0 < np.mean(values) < 6.0 + 2.58 * np.sqrt(12.0 / len(values))


def test_the_model_is_found_among_clutter(
    detector: ModelTargetDetector, rng: np.random.Generator
) -> None:
    found = 0
    for _ in range(3):
        pose = some_pose(rng)
        result = detector.detect(CloudView(range_map(bracket(), pose, rng)))
        if isinstance(result, TargetSighting):
            assert is_near(result.T_camera_target, pose)
            found += 1
    assert found >= 2  # a box may look like the plate


def test_an_absent_model_is_not_found(
    detector: ModelTargetDetector, rng: np.random.Generator
) -> None:
    for _ in range(2):
        result = detector.detect(CloudView(range_map(None, some_pose(rng), rng)))
        assert isinstance(result, TargetRefusal)


def test_a_symmetric_model_is_refused(rng: np.random.Generator) -> None:
    size = (0.22, 0.16, 0.1)
    symmetric = ModelTargetDetector(ModelTargetConfig(), shape_from_triangles(box(size)))
    result = symmetric.detect(CloudView(range_map(box(size), some_pose(rng), rng, clutter=3)))
    assert isinstance(result, TargetRefusal)
    assert result.reason == "ambiguous"


def test_points_that_share_no_plane_are_on_none(rng: np.random.Generator) -> None:
    points = rng.uniform(-1.0, 1.0, (120, 3))
    normals = np.where(np.arange(120)[:, None] % 2 == 0, np.eye(3)[0], -np.eye(3)[0])
    assert not on_large_planes(points, normals, extent=0.1, tolerance=1e-9).any()


def test_an_empty_range_map_is_refused(detector: ModelTargetDetector) -> None:
    pose = np.eye(4)
    pose[2, 3] = 30.0  # beyond what the camera measures
    cloud = range_map(None, pose, np.random.default_rng(0), clutter=0)
    far = CloudView(cloud)
    cloud.packed[:] = np.nan
    cloud.range_image[:] = np.nan
    result = detector.detect(far)
    assert isinstance(result, TargetRefusal)
    assert result.reason == "not in view"


def test_a_scanned_object_is_found(real_data: Path, rng: np.random.Generator) -> None:
    path = real_data / "meshes" / "PowerDrill" / "textured_simple_reoriented.obj"
    config = TargetConfig(kind="model", model=ModelTargetConfig(file=str(path)))
    drill = make_detector(config)
    assert drill is not None
    pose = some_pose(rng)
    triangles = read_obj(path)
    result = drill.detect(CloudView(range_map(triangles, pose, rng)))
    assert isinstance(result, TargetSighting)
    assert is_near(result.T_camera_target, pose)


def read_obj(path: Path) -> FloatArray:
    """Triangles of an .obj file, read anew."""
    lines = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([line[1:4] for line in lines if line[:1] == ["v"]], dtype=float)
    faces = [[int(corner.split("/")[0]) - 1 for corner in line[1:]] for line in lines
             if line[:1] == ["f"]]  # fmt: skip
    return vertices[np.array(faces)]


def test_bad_models_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="file"):
        ModelTargetDetector(ModelTargetConfig())
    with pytest.raises(InvalidInputError, match="does not exist"):
        load_model(tmp_path / "nothing.stl")
    (tmp_path / "broken.stl").write_text("this is no mesh")
    with pytest.raises(InvalidInputError, match="broken"):
        load_model(tmp_path / "broken.stl")
    with pytest.raises(InvalidInputError, match="area"):
        shape_from_triangles(np.zeros((3, 3, 3)))
    points, _ = on_triangles(box((1, 1, 1)), 200, np.random.default_rng(0))
    with pytest.raises(InvalidInputError, match="unit"):
        ModelShape(points, points)
