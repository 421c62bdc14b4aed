"""Tags in a photo and in sheets that another program drew, with that program's poses (ViSP)."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagFinder
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetRefusal, TargetSighting
from infomap_ros.stereo import RangeCloud

from .tag_scenes import pose_error

# ViSP's pixels begin at the corner of the first pixel, ours at its center.
PHOTO_CAMERA = PinholeCamera(640, 480, 615.1674805, 615.1675415, 311.6889954, 242.9373779)
SHEET_CAMERA = PinholeCamera(640, 480, 700.0, 700.0, 319.5, 239.5)
# ViSP's axes of a tag are turned by 180 degrees about its normal.
T_VISP_TAG = np.diag([-1.0, -1.0, 1.0, 1.0])


class Photo:
    """An image without range."""

    stamp, has_cloud, tags = 0, False, None

    def __init__(self, image: NDArray[np.uint8], camera: PinholeCamera) -> None:
        self.image, self.camera = image, camera

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        nothing = np.full(len(np.asarray(pixels)), np.nan)
        return nothing, nothing

    def cloud(self) -> RangeCloud:
        raise AssertionError("tags need no dense cloud")


def read(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return np.asarray(image, np.uint8)


def one_tag(tag: int, side: float) -> TagTargetDetector:
    board = TagBoardConfig(columns=1, rows=1, side=side, first_id=tag, mounting="flat")
    return TagTargetDetector(TagTargetConfig(board=board))


def named_numbers(path: Path) -> dict[int, FloatArray]:
    """Blocks of numbers below lines such as ``36h11_id:_8``."""
    blocks: dict[int, list[list[float]]] = {}
    for line in path.read_text().splitlines():
        if line.startswith("36h11"):
            rows = blocks.setdefault(int(line.split("_")[-1]), [])
        elif line.strip():
            rows.append([float(number) for number in line.split()])
    return {tag: np.array(rows) for tag, rows in blocks.items()}


def test_the_corners_in_the_photo_are_those_of_another_program(real_data: Path) -> None:
    folder = real_data / "apriltag_visp"
    truth = named_numbers(folder / "ground_truth_detection.txt")
    tags = TagFinder("tag36h11").find(read(folder / "AprilTag.pgm"))
    assert sorted(tags.ids) == sorted(truth)
    # (row, column), the other way round, begun at the other end
    others = np.stack([np.roll(truth[int(tag)][::-1, ::-1], 2, axis=0) for tag in tags.ids])
    apart = np.linalg.norm(tags.corners + 0.5 - others, axis=2)
    assert np.median(apart) < 0.3
    assert apart.max() < 1.0


def test_the_poses_in_the_photo_are_those_of_another_program(real_data: Path) -> None:
    folder = real_data / "apriltag_visp"
    view = Photo(read(folder / "AprilTag.pgm"), PHOTO_CAMERA)
    values = []
    for tag, ((x, y, z, *turn),) in named_numbers(folder / "ground_truth_pose.txt").items():
        sighting = one_tag(tag, 0.053).detect(view)
        assert isinstance(sighting, TargetSighting)
        truth = make_transform(Rotation.from_rotvec(turn).as_matrix(), [x, y, z]) @ T_VISP_TAG
        error = pose_error(sighting.T_camera_target, truth)
        assert np.linalg.norm(error[:2]) < 0.0005
        assert abs(error[2]) < 0.002
        assert np.linalg.norm(error[3:]) < np.radians(0.5)
        values.append(error @ np.linalg.solve(sighting.covariance, error))
    assert len(values) == 12
    assert max(values) < 16.8  # 99 % of 6 degrees of freedom; both saw the same photo


def test_the_normals_of_tags_on_one_sheet_agree_within_their_covariance(real_data: Path) -> None:
    view = Photo(read(real_data / "apriltag_visp" / "AprilTag.pgm"), PHOTO_CAMERA)
    normals, sigmas = [], []
    for tag in range(8, 20):
        sighting = one_tag(tag, 0.053).detect(view)
        assert isinstance(sighting, TargetSighting)
        normals.append(sighting.T_camera_target[:3, 2])
        sigmas.append(np.sqrt(np.trace(sighting.covariance[3:, 3:])))
    middle = np.mean(normals, axis=0)
    angles = np.arccos(np.clip(normals @ middle / np.linalg.norm(middle), -1.0, 1.0))
    assert np.degrees(angles.max()) < 2.0  # paper is not flat
    assert np.mean((angles / sigmas) ** 2) < 3.0


@pytest.mark.parametrize(("tag", "side"), [(0, 0.2), (1, 0.2), (3, 0.1), (4, 0.1)])
def test_poses_in_a_sheet_drawn_by_another_program(real_data: Path, tag: int, side: float) -> None:
    folder = real_data / "apriltag_visp" / "benchmark" / "640x480"
    view = Photo(read(folder / "tag36_11_640x480.png"), SHEET_CAMERA)
    truth = np.loadtxt(folder / f"cMo_{tag}.txt", max_rows=3)
    sighting = one_tag(tag, side).detect(view)
    assert isinstance(sighting, TargetSighting)
    turned = make_transform(truth[:, :3], truth[:, 3]) @ T_VISP_TAG
    error = pose_error(sighting.T_camera_target, turned)
    assert np.linalg.norm(error[:3]) < 0.005 * truth[2, 3]
    assert np.linalg.norm(error[3:]) < np.radians(0.5)


@pytest.mark.parametrize("family", ["tag36h11", "tag25h9", "tag16h5", "aruco4x4_50"])
def test_images_without_tags_hold_none(real_data: Path, family: str) -> None:
    finder = TagFinder(family)
    images = [
        real_data / "stereo_motorcycle" / "motorcycle_left.png",
        real_data / "stereo_opencv_samples" / "aloeL.jpg",
        real_data / "stereo_opencv_samples" / "left01.jpg",  # a chessboard
        *sorted((real_data / "rgbd_kitchen" / "frames").glob("*.color.*"))[::50],
    ]
    assert len(images) >= 7
    for path in images:
        assert len(finder.find(read(path)).ids) == 0


def test_an_image_without_the_target_is_refused(real_data: Path) -> None:
    image = read(real_data / "stereo_motorcycle" / "motorcycle_left.png")
    refusal = one_tag(0, 0.1).detect(Photo(image, PinholeCamera(741, 497, 995.0, 995.0, 311, 255)))
    assert isinstance(refusal, TargetRefusal)
    assert refusal.reason == "not in view"
