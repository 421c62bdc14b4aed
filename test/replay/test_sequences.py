"""Real sequences become bags that fit together, and folders that are none are refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, PoseRecord, rig_from_calibrations
from infomap_ros.pipeline.pixels import intensity_pixels
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.topics import find_depth_topics, find_pose_topic, find_stereo_topics
from infomap_ros.replay.sequences import FORMATS, convert
from infomap_ros.stereo.rectification import StereoRectifier

FOLDERS = {
    "kitchen": "rgbd_kitchen",
    "kalibr": "tumvi_room1",
    "rover": "rover_sandbox/run1",
    "motorcycle": "stereo_motorcycle",
    "aloe": "stereo_opencv_samples",
}
FRAMES = {"kitchen": 250, "kalibr": 15, "rover": 32, "motorcycle": 1, "aloe": 1}


def write_rgbd(folder: Path) -> Path:
    """Three frames in the layout of the real sequence; the second has lost its pose."""
    (folder / "frames").mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", [[50, 0, 16], [0, 50, 12], [0, 0, 1]])
    for index in range(3):
        stem = folder / "frames" / f"frame-{index:06d}"
        depth = np.full((24, 32), 1000 + index, np.uint16)
        cv2.imwrite(f"{stem}.depth.png", depth)
        cv2.imwrite(f"{stem}.color.jpg", np.zeros((24, 32, 3), np.uint8))
        pose = np.eye(4) if index != 1 else np.full((4, 4), np.nan)
        pose[0, 3] += index
        np.savetxt(f"{stem}.pose.txt", pose)
    return folder


def test_rgbd_layout(tmp_path):
    convert("rgbd", write_rgbd(tmp_path / "data"), tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        records = {name: [r.record for r in bag.records([name])] for name in bag.topics}
    depths, poses = records["/depth/image_rect"], records["/camera_pose"]
    assert [d.pixels[0, 0] for d in depths] == [1000, 1002]
    np.testing.assert_allclose(
        [p.transform[:3, 3] for p in poses], [[0, 0, 0], [0, -2, 0]], atol=1e-12
    )
    np.testing.assert_allclose(poses[0].transform[:3, 1], [0, 0, -1], atol=1e-12)  # y was down
    assert depths[0].encoding == "16UC1"
    assert depths[1].stamp - depths[0].stamp == round(2e9 / 30)


def test_incomplete_sequence_names_what_is_missing(tmp_path):
    folder = write_rgbd(tmp_path / "data")
    (folder / "frames" / "frame-000002.depth.png").unlink()
    with pytest.raises(BagError, match=r"frame-000002\.depth\.png"):
        convert("rgbd", folder, tmp_path / "bag")


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_empty_folder_is_refused(tmp_path, name):
    with pytest.raises(BagError):
        convert(name, tmp_path, tmp_path / "bag")


def test_unknown_format_lists_the_known(tmp_path):
    with pytest.raises(InvalidInputError, match="rgbd"):
        convert("kitti", tmp_path, tmp_path / "bag")


@pytest.fixture(scope="module", params=sorted(FOLDERS))
def real_bag(request, real_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    convert(request.param, real_data / FOLDERS[request.param], folder / "bag")
    with BagReader(folder / "bag") as bag:
        yield request.param, bag


def test_real_sequence_has_what_mapping_needs(real_bag):
    name, bag = real_bag
    types = {topic: channel.type_name for topic, channel in bag.topics.items()}
    if name == "kitchen":
        image = find_depth_topics(types).depth
    else:
        image = find_stereo_topics(types).left_image
    assert find_pose_topic(types) == "/camera_pose"
    assert bag.topics[image].count == FRAMES[name]
    poses = [r.record.stamp for r in bag.records(["/camera_pose"])]
    stamps = [r.record.stamp for r in bag.records([image])]
    assert poses[0] <= stamps[0]
    assert poses[-1] >= stamps[-1]


def test_real_calibration_fits_its_images(real_bag):
    name, bag = real_bag
    sides = ("depth", "rgb") if name == "kitchen" else ("left", "right")
    infos, images = {}, {}
    for side in sides:
        for topic in (t for t in bag.topics if t.startswith(f"/{side}/")):
            record = next(bag.records([topic])).record
            if isinstance(record, CameraInfoRecord):
                infos[side] = record.calibration
            elif isinstance(record, ImageRecord):
                images[side] = record
    for side in sides:
        size = infos[side].width, infos[side].height
        assert size == images[side].pixels.shape[1::-1]
    if name != "kitchen":
        assert 0.05 < rig_from_calibrations(infos["left"], infos["right"]).baseline < 0.25


def test_rectified_fisheye_rows_correspond(real_data, tmp_path):
    """Corners of both rectified images lie in the same row.

    But for about -0.45 px, the same in all 15 pairs, that the calibration of the sequence leaves.
    """
    convert("kalibr", real_data / "tumvi_room1", tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        first = {name: next(bag.records([name])).record for name in bag.topics}
    rectifier = StereoRectifier(
        first["/left/camera_info"].calibration, first["/right/camera_info"].calibration
    )
    left, right = rectifier.rectify(
        *(intensity_pixels(first[f"/{side}/image_raw"]) for side in ("left", "right"))
    )
    corners = cv2.goodFeaturesToTrack(left, 300, 0.02, 10)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, None, winSize=(21, 21))
    back, again, _ = cv2.calcOpticalFlowPyrLK(right, left, moved, None, winSize=(21, 21))
    good = (found & again).ravel().astype(bool) & (np.abs(back - corners).max(axis=2).ravel() < 0.3)
    rows = (moved - corners)[good, 0, 1]
    assert good.sum() > 60
    assert abs(np.median(rows)) < 0.6
    assert np.percentile(np.abs(rows), 80) < 1.0


def test_poses_of_motion_capture_follow_its_file(real_data):
    """Independent of the reader: the camera keeps its distance to the captured body."""
    entries = FORMATS["kalibr"](real_data / "tumvi_room1")
    poses = [record for _, record in entries if isinstance(record, PoseRecord)]
    table = np.loadtxt(real_data / "tumvi_room1" / "gt_imu_first3.5s.csv", delimiter=",")
    distances = [
        np.linalg.norm(pose.transform[:3, 3] - row[1:4])
        for pose, row in zip(poses, table, strict=True)
    ]
    np.testing.assert_allclose(distances, distances[0], atol=1e-6)
    assert 0.05 < distances[0] < 0.15


def test_pixels_of_every_brightness_encoding():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    image = ImageRecord(0, "", rgb[..., ::-1].copy(), "bgr8")
    np.testing.assert_array_equal(intensity_pixels(image), rgb)
    wide = ImageRecord(0, "", np.array([[0x1234, 0xFF00]], np.uint16), "mono16")
    np.testing.assert_array_equal(intensity_pixels(wide), [[0x12, 0xFF]])
    with pytest.raises(InvalidInputError, match="32FC1"):
        intensity_pixels(ImageRecord(0, "", np.zeros((2, 2), np.float32), "32FC1"))
