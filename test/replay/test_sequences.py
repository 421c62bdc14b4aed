"""Folders of images become bags, or are mapped as they are; what does not fit is listed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from infomap_ros.errors import BagError, CalibrationError, InvalidInputError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, PoseRecord, rig_from_calibrations
from infomap_ros.pipeline.image_synchronizer import intensity_pixels
from infomap_ros.pipeline.inertial import InertialSensor
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.topics import find_depth_topics, find_pose_topic, find_stereo_topics
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.mapped_bag import open_recording
from infomap_ros.replay.sequences import LAYOUTS, SequenceOptions, SequenceReader, convert
from infomap_ros.replay.sequences.calibration_files import read_calibration
from infomap_ros.replay.sequences.frame_files import as_nanoseconds
from infomap_ros.stereo.rectification import StereoRectifier

from .real_sequences import REAL
from .scenes import WALL, stereo_frames

SIZE = (32, 24)
FX, BASELINE = 50.0, 0.1

KALIBR = f"""
cam0:
  camera_model: pinhole
  intrinsics: [{FX}, {FX}, 15.5, 11.5]
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
  resolution: [32, 24]
cam1:
  camera_model: pinhole
  intrinsics: [{FX}, {FX}, 15.5, 11.5]
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
  resolution: [32, 24]
  T_cn_cnm1: [[1, 0, 0, -{BASELINE}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
KITTI = f"""
P0: {FX} 0 15.5 0 0 {FX} 11.5 0 0 0 1 0
P1: {FX} 0 15.5 -{FX * BASELINE} 0 {FX} 11.5 0 0 0 1 0
"""
MIDDLEBURY = f"""
cam0=[{FX} 0 15.5; 0 {FX} 11.5; 0 0 1]
cam1=[{FX} 0 15.5; 0 {FX} 11.5; 0 0 1]
baseline=100
"""


def ros_info(shift: float) -> str:
    """A camera_info file as camera_calibration writes it; `shift` is P[0, 3]."""

    def matrix(rows: int, cols: int, data: list[float]) -> dict[str, object]:
        return {"rows": rows, "cols": cols, "data": data}

    k = [FX, 0.0, 15.5, 0.0, FX, 11.5, 0.0, 0.0, 1.0]
    p = [FX, 0.0, 15.5, shift, 0.0, FX, 11.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    content = {
        "image_width": 32,
        "image_height": 24,
        "distortion_model": "plumb_bob",
        "camera_matrix": matrix(3, 3, k),
        "distortion_coefficients": matrix(1, 5, [0.0] * 5),
        "rectification_matrix": matrix(3, 3, list(np.eye(3).ravel().tolist())),
        "projection_matrix": matrix(3, 4, p),
    }
    return yaml.safe_dump(content)


def opencv_text(names: dict[str, np.ndarray]) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in names.items():
        storage.write(name, value)
    return str(storage.releaseAndGetString())


K = np.array([[FX, 0, 15.5], [0, FX, 11.5], [0, 0, 1]])
INTRINSICS = opencv_text({"M1": K, "D1": np.zeros((1, 5)), "M2": K, "D2": np.zeros((1, 5))})
EXTRINSICS = opencv_text({"R": np.eye(3), "T": np.array([[-BASELINE], [0], [0]])})


@pytest.mark.parametrize(
    "texts",
    [
        [KALIBR],
        [KITTI],
        [MIDDLEBURY],
        [ros_info(0.0), ros_info(-FX * BASELINE)],
        [INTRINSICS, EXTRINSICS],
    ],
    ids=["kalibr", "kitti", "middlebury", "ros", "opencv"],
)
def test_every_calibration_gives_the_same_pair(tmp_path, texts):
    files = [tmp_path / f"{place}.yaml" for place in range(len(texts))]
    for path, text in zip(files, texts, strict=True):
        path.write_text(text)
    rig = rig_from_calibrations(*read_calibration(files, SIZE).as_pair("it").cameras)
    assert rig.baseline == pytest.approx(BASELINE)
    assert (rig.left.fx, rig.left.cx) == pytest.approx((FX, 15.5))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "no known format"),
        (KALIBR.replace(f"-{BASELINE}", "-100"), "baseline of 100 m"),
        (KALIBR.replace(f"-{BASELINE}", f"{BASELINE}"), "are left and right swapped"),
        (KALIBR.replace("radtan", "strange"), "strange"),
        (INTRINSICS, "no transform from the left to the right"),
        (f"{FX} 0 15.5\n0 {FX} 11.5\n0 0 1\n", "describes one camera"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_named(tmp_path, text, said):
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said):
        read_calibration([path], SIZE).as_pair(str(path))


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1520530308199447626", 1520530308199447626),
        ("1520530308199447", 1520530308199447000),
        ("1520530308199", 1520530308199000000),
        ("1305031102.175304", 1305031102175304000),
        ("12.5", 12500000000),
    ],
)
def test_times_of_every_unit(text, nanoseconds):
    assert as_nanoseconds(text) == nanoseconds


def write_images(folder: Path, names: list[str], value: int = 100) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.full((24, 32), value, np.uint8))


LAYOUT_FILES = {
    "folders": (["left/000.png", "left/001.png"], ["right/000.png", "right/001.png"]),
    "jpg": (["left/a_000.jpg", "left/a_001.jpg"], ["right/b_000.jpg", "right/b_001.jpg"]),
    "names": (["left_0.png", "left_1.png"], ["right_0.png", "right_1.png"]),
    "realsense": (["infra1/0.pgm", "infra1/1.pgm"], ["infra2/0.pgm", "infra2/1.pgm"]),
    "middlebury": (["im0.png"], ["im1.png"]),
    "euroc": (
        ["mav0/cam0/data/1520530308199447626.png"],
        ["mav0/cam1/data/1520530308199447630.png"],
    ),
    "kitti": (
        ["image_0/000000.png", "image_0/000001.png"],
        ["image_1/000000.png", "image_1/000001.png"],
    ),
}


@pytest.mark.parametrize("layout", sorted(LAYOUT_FILES))
def test_pairs_are_found_in_every_layout(tmp_path, layout):
    left, right = LAYOUT_FILES[layout]
    for name in (*left, *right):
        write_images((tmp_path / name).parent, [Path(name).name])
    (tmp_path / "calib.yaml").write_text(KALIBR)
    reader = open_recording(tmp_path, [tmp_path / "calib.yaml"])
    pair = find_stereo_topics({n: c.type_name for n, c in reader.topics.items()})
    assert reader.topics[pair.left_image].count == len(left)
    stamps = [r.record.stamp for r in reader.records([pair.left_image])]
    assert stamps == sorted(set(stamps))
    assert stamps == [r.record.stamp for r in reader.records([pair.right_image])]
    if len(left) > 1:
        assert stamps[1] - stamps[0] == 100_000_000  # 10 Hz where nobody says


def test_patterns_times_and_poses_of_the_user(tmp_path):
    write_images(tmp_path / "x", ["top_a.png", "top_b.png"], 10)
    write_images(tmp_path / "y", ["low_a.png", "low_b.png"], 20)
    (tmp_path / "times.txt").write_text("0.0\n0.25\n")
    (tmp_path / "poses.tum").write_text("# t x y z q\n0.0 1 2 3 0 0 0 1\n0.25 1 2 4 0 0 0 1\n")
    (tmp_path / "k.yaml").write_text(KALIBR)
    options = SequenceOptions(
        left="x",
        right="y/*.png",
        stamps=tmp_path / "times.txt",
        poses=tmp_path / "poses.tum",
        calibration=[tmp_path / "k.yaml"],
    )
    convert("images", tmp_path, tmp_path / "bag", options)
    with BagReader(tmp_path / "bag") as bag:
        records = {name: [r.record for r in bag.records([name])] for name in bag.topics}
    lefts, poses = records["/left/image_raw"], records["/camera_pose"]
    assert lefts[1].stamp - lefts[0].stamp == 250_000_000
    assert [p.stamp for p in poses] == [image.stamp for image in lefts]
    np.testing.assert_allclose([p.transform[:3, 3] for p in poses], [[1, 2, 3], [1, 2, 4]])
    assert (lefts[0].pixels[0, 0], records["/right/image_raw"][0].pixels[0, 0]) == (10, 20)


def test_tum_folder(tmp_path):
    for name, value in (("rgb", 90), ("depth", 0)):
        write_images(tmp_path / name, ["1305031102.175304.png"], value)
    cv2.imwrite(
        str(tmp_path / "depth" / "1305031102.160407.png"), np.full((24, 32), 5000, np.uint16)
    )
    (tmp_path / "rgb.txt").write_text("# t name\n1305031102.175304 rgb/1305031102.175304.png\n")
    (tmp_path / "depth.txt").write_text("1305031102.160407 depth/1305031102.160407.png\n")
    truth = "1305031102.1 0.5 0 1 0 0 0 1\n1305031102.2 0.6 0 1 0 0 0 1\n"
    (tmp_path / "groundtruth.txt").write_text(truth)
    (tmp_path / "k.txt").write_text(f"{FX} 0 15.5\n0 {FX} 11.5\n0 0 1\n")
    reader = open_recording(tmp_path, [tmp_path / "k.txt"])
    (depth,) = [r.record for r in reader.records(["/depth/image_rect"])]
    assert depth.encoding == "32FC1"
    assert depth.pixels[0, 0] == pytest.approx(1.0), "5000 in the file is one meter"
    assert len(list(reader.records(["/camera_pose"]))) == 2


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
    folder = write_rgbd(tmp_path / "data")
    convert("rgbd", folder, tmp_path / "bag", SequenceOptions(rate=30.0))
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
    (folder / "frames" / "frame-000002.color.jpg").unlink()
    with pytest.raises(BagError, match="frame-000002"):
        convert("rgbd", folder, tmp_path / "bag")


def test_a_failed_conversion_leaves_nothing(tmp_path):
    folder = write_rgbd(tmp_path / "data")
    for depth in folder.glob("frames/*.depth.png"):
        depth.write_bytes(b"no image" if depth.name.startswith("frame-000000") else b"")
    with pytest.raises(BagError, match="not an image"):
        convert("rgbd", folder, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_bag_that_is_there_is_kept_and_the_way_out_named(tmp_path):
    folder = write_rgbd(tmp_path / "data")
    convert("rgbd", folder, tmp_path / "bag")
    with pytest.raises(BagError, match="--overwrite"):
        convert("rgbd", folder, tmp_path / "bag")
    assert convert("rgbd", folder, tmp_path / "bag", overwrite=True) == 10


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_a_folder_that_does_not_fit_is_refused_by_what_it_holds(tmp_path, name):
    (tmp_path / "data" / "readings").mkdir(parents=True)
    (tmp_path / "data" / "notes.pdf").write_text("")
    with pytest.raises(BagError, match=r"holds readings/ \(0 entries\), 1 \.pdf"):
        convert(name, tmp_path / "data", tmp_path / "bag")


def test_missing_calibration_says_what_is_there_and_what_to_give(tmp_path):
    write_images(tmp_path / "left", ["0.png"])
    write_images(tmp_path / "right", ["0.png"])
    with pytest.raises(CalibrationError, match=r"left/ \(1 entries\).*--calibration"):
        open_recording(tmp_path)


def test_images_of_another_size_than_the_calibration_are_named(tmp_path):
    write_images(tmp_path / "left", ["0.png"])
    write_images(tmp_path / "right", ["0.png"])
    (tmp_path / "camchain.yaml").write_text(KALIBR.replace("[32, 24]", "[64, 48]"))
    reader = open_recording(tmp_path)
    with pytest.raises(BagError, match="32x24 px, its calibration 64x48"):
        list(reader.records())


@pytest.mark.parametrize("damage", ["empty", "odd size", "cut off"])
@pytest.mark.parametrize("place", [0, 1])
def test_a_broken_image_among_good_ones_is_left_out(tmp_path, damage, place):
    for side in ("left", "right"):
        write_images(tmp_path / side, ["0.png", "1.png", "2.png"])
    broken = tmp_path / "left" / f"{place}.png"
    if damage == "odd size":
        cv2.imwrite(str(broken), np.zeros((12, 16), np.uint8))
    else:
        broken.write_bytes(broken.read_bytes()[:40] if damage == "cut off" else b"")
    (tmp_path / "camchain.yaml").write_text(KALIBR)
    reader = open_recording(tmp_path)
    images = [r.topic for r in reader.records() if isinstance(r.record, ImageRecord)]
    assert [images.count(f"/{side}/image_raw") for side in ("left", "right")] == [2, 3]
    assert [count for text, count in reader.skipped.items() if broken.name in text] == [1]


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
@pytest.mark.parametrize("text", [KITTI, MIDDLEBURY, f"{FX} 0 15.5\n0 {FX} 11.5\n0 0 1"])
def test_a_calibration_that_states_no_size_must_fit_the_images(tmp_path, text, factor):
    (tmp_path / "calib.txt").write_text(text)
    read_calibration([tmp_path / "calib.txt"], SIZE)
    size = round(SIZE[0] * factor), round(SIZE[1] * factor)
    with pytest.raises(CalibrationError, match=rf"\(1[56], 12\) px.*{size[0]}x{size[1]} px"):
        read_calibration([tmp_path / "calib.txt"], size)


def test_depth_images_alone_with_poses(tmp_path):
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth" / "0.png"), np.full((24, 32), 1000, np.uint16))
    (tmp_path / "camera-intrinsics.txt").write_text(f"{FX} 0 15.5\n0 {FX} 11.5\n0 0 1")
    (tmp_path / "poses.txt").write_text("0.0 0 0 1 0.5 -0.5 0.5 -0.5")
    kinds = [type(record.record) for record in open_recording(tmp_path).records()]
    assert kinds == [PoseRecord, CameraInfoRecord, ImageRecord]


def test_an_assumed_calibration_is_said(tmp_path):
    for name, kind in (("rgb", np.uint8), ("depth", np.uint16)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "1.png"), np.zeros((480, 640), kind))
        (tmp_path / f"{name}.txt").write_text(f"1.0 {name}/1.png")
    said: list[str] = []
    convert("tum", tmp_path, tmp_path / "bag", say=said.append)
    assert len(said) == 1
    assert "525 px" in said[0]


def test_unknown_layout_lists_the_known(tmp_path):
    with pytest.raises(InvalidInputError, match="rgbd"):
        convert("vrml", tmp_path, tmp_path / "bag")


def test_a_folder_is_mapped_as_its_bag_would_be(tmp_path):
    """The wall of the stereo scene, from files: at the plane where it was drawn."""
    for topic, record in stereo_frames():
        if isinstance(record, ImageRecord):
            path = tmp_path / topic.split("/")[1] / f"{record.stamp + 10**18}.png"
            path.parent.mkdir(exist_ok=True)
            cv2.imwrite(str(path), record.pixels)
    text = "cam0=[240 0 159.5; 0 240 119.5; 0 0 1]\ncam1=[240 0 159.5; 0 240 119.5; 0 0 1]\n"
    (tmp_path / "calib.txt").write_text(text + "baseline=100\n")
    rows = [f"{(10**18 + 10**9 + i * 10**8) / 1e9:.1f} 0 0 0 0.5 -0.5 0.5 -0.5" for i in range(3)]
    (tmp_path / "poses.txt").write_text("\n".join(rows))
    with open_recording(tmp_path) as folder:
        run = MapRun(folder)
        run.run()
    assert run.frames == 3
    _, means, _ = run.map.gaussians()
    axis = int(np.argmin(means.std(axis=0)))
    assert abs(np.median(means[:, axis])) == pytest.approx(WALL, abs=0.02)


@pytest.fixture(scope="module", params=sorted(REAL))
def real(request, real_data):
    sequence = REAL[request.param]
    folder = real_data / sequence.folder
    return request.param, SequenceReader(folder, LAYOUTS[sequence.layout](folder, sequence.options))


def test_real_sequence_has_what_mapping_needs(real):
    name, recording = real
    types = {topic: channel.type_name for topic, channel in recording.topics.items()}
    find = find_depth_topics if name == "kitchen" else find_stereo_topics
    image = find(types).names[0]
    assert recording.topics[image].count == REAL[name].frames
    if REAL[name].has_poses:
        assert find_pose_topic(types) == "/camera_pose"
        poses = [r.record.stamp for r in recording.records(["/camera_pose"])]
        stamps = [stamp for stamp, _ in recording.sequence.streams[0].files]
        assert poses[0] <= stamps[0]
        assert poses[-1] >= stamps[-1]


def test_real_calibration_fits_its_images(real):
    name, recording = real
    infos, images = {}, {}
    for stream in recording.sequence.streams:
        first = {
            t: next(recording.records([t])).record for t in (stream.info_topic, stream.image_topic)
        }
        infos[stream.name] = first[stream.info_topic].calibration
        images[stream.name] = first[stream.image_topic]
        size = infos[stream.name].width, infos[stream.name].height
        assert size == images[stream.name].pixels.shape[1::-1]
    if name != "kitchen":
        baseline = rig_from_calibrations(infos["left"], infos["right"]).baseline
        assert 0.05 < baseline < 0.6


def test_rectified_fisheye_rows_correspond(real_data):
    """Corners of both rectified images lie in the same row.

    But for about -0.45 px, the same in all 15 pairs, that the calibration of the sequence leaves.
    """
    recording = open_recording(real_data / "tumvi_room1")
    first = {name: next(recording.records([name])).record for name in recording.topics}
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
    recording = open_recording(real_data / "tumvi_room1")
    poses = [entry.record for entry in recording.records(["/camera_pose"])]
    assert all(isinstance(pose, PoseRecord) for pose in poses)
    table = np.loadtxt(real_data / "tumvi_room1" / "gt_imu_first3.5s.csv", delimiter=",")
    distances = [
        np.linalg.norm(pose.transform[:3, 3] - row[1:4])
        for pose, row in zip(poses, table, strict=True)
    ]
    np.testing.assert_allclose(distances, distances[0], atol=1e-6)
    assert 0.05 < distances[0] < 0.15


def test_camera_infos_of_a_bag_are_those_of_the_folder(real_data, tmp_path):
    folder = real_data / "stereo_kitti_03"
    convert("kitti", folder, tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag, open_recording(folder) as images:
        for topic in ("/left/camera_info", "/right/camera_info"):
            infos = [next(r.records([topic])).record for r in (bag, images)]
            assert all(isinstance(info, CameraInfoRecord) for info in infos)
            assert infos[0].calibration == infos[1].calibration


def test_pixels_of_every_brightness_encoding():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    image = ImageRecord(0, "", rgb[..., ::-1].copy(), "bgr8")
    np.testing.assert_array_equal(intensity_pixels(image), rgb)
    wide = ImageRecord(0, "", np.array([[0x1234, 0xFF00]], np.uint16), "mono16")
    np.testing.assert_array_equal(intensity_pixels(wide), [[0x12, 0xFF]])
    with pytest.raises(InvalidInputError, match="32FC1"):
        intensity_pixels(ImageRecord(0, "", np.zeros((2, 2), np.float32), "32FC1"))


IMU_TABLE = """#timestamp [ns],w_RS_S_x [rad s^-1],w_y,w_z,a_RS_S_x [m s^-2],a_y,a_z
1520530308181901469,0.10,-0.08,0.02,-0.35,0.00,9.92
1520530308186917469,nan,-0.08,0.01,-0.31,0.01,9.95
1520530308176885469,0.11,-0.07,0.02,-0.36,0.00,9.91
"""


def euroc_with(folder: Path, table: str, calibration: str) -> SequenceReader:
    left, right = LAYOUT_FILES["euroc"]
    for name in (*left, *right):
        write_images((folder / name).parent, [Path(name).name])
    (folder / "mav0" / "imu0").mkdir()
    (folder / "mav0" / "imu0" / "data.csv").write_text(table)
    (folder / "calib.yaml").write_text(calibration)
    return open_recording(folder, [folder / "calib.yaml"])


TIED = KALIBR.replace(
    "cam1:", "  T_cam_imu: [[0, 1, 0, 0.1], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]\ncam1:"
)


def test_samples_of_an_inertial_sensor_come_with_its_place_on_the_camera(tmp_path):
    reader = euroc_with(tmp_path / "folder", IMU_TABLE, TIED)
    samples = [entry.record for entry in reader.records(["/imu"])]
    assert [sample.stamp for sample in samples] == [1520530308176885469, 1520530308181901469]
    np.testing.assert_array_equal(samples[1].angular_velocity, [0.10, -0.08, 0.02])
    np.testing.assert_array_equal(samples[1].acceleration, [-0.35, 0.0, 9.92])
    options = SequenceOptions(calibration=[tmp_path / "folder" / "calib.yaml"])
    convert("euroc", tmp_path / "folder", tmp_path / "bag", options)
    with BagReader(tmp_path / "bag") as bag:
        assert [entry.record.stamp for entry in bag.records(["/imu"])] == [
            sample.stamp for sample in samples
        ]
        (edge,) = (entry.record for entry in bag.records(["/tf_static"]))
    assert (edge.frame_id, edge.child_frame_id) == ("left_optical_frame", "imu")
    np.testing.assert_allclose(edge.transform[:3, 3], [0.1, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("table", "calibration", "said"),
    [
        (IMU_TABLE, KALIBR, "does not say where it is"),
        ("1,2,3\n", TIED, "is no table of an inertial sensor"),
        ("\x00\n", TIED, "holds no line of numbers"),
    ],
)
def test_an_inertial_sensor_that_cannot_be_used_is_named(tmp_path, table, calibration, said):
    reader = euroc_with(tmp_path, table, calibration)
    assert "/imu" not in reader.topics
    assert any(said in problem and "data.csv" in problem for problem in reader.problems)


def test_a_real_gyroscope_turns_as_motion_capture_says(real_data):
    sensor = InertialSensor("left_optical_frame")
    with open_recording(real_data / "tumvi_room1") as recording:
        for entry in recording.records(["/tf_static", "/imu"]):
            sensor.add(entry.record)
        poses = [entry.record for entry in recording.records(["/camera_pose"])]
    first, last = poses[12], poses[360]  # 2.9 s apart
    before, after = sensor.at(first.stamp), sensor.at(last.stamp)
    turn = after.turn_since(before)
    true = first.transform[:3, :3].T @ last.transform[:3, :3]
    assert Rotation.from_matrix(true).magnitude() > np.radians(3.0)
    assert Rotation.from_matrix(true.T @ turn).magnitude() < np.radians(1.0)
    level = after.up @ last.transform[:3, :3].T @ [0.0, 0.0, 1.0]
    assert np.arccos(level) < np.radians(1.0)
