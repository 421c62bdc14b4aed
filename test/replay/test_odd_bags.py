"""Bags as others write them: odd type names, definitions, cameras, metadata."""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from infomap_ros.errors import BagError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    TransformRecord,
    rig_from_calibrations,
)
from infomap_ros.pipeline.range_estimator import DepthRangeEstimator, StereoRangeEstimator
from infomap_ros.replay.bags.image_choice import ImageInputConfig, find_images
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.source import Channel, typestore_of
from infomap_ros.replay.bags.writer import BagWriter
from infomap_ros.stereo import DepthCameraConfig, StereoConfig

START = 1_700_000_000_000_000_000


def calibration(baseline: float) -> CameraCalibration:
    k = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
    p = np.hstack([k, [[-100.0 * baseline], [0], [0]]])
    return CameraCalibration(64, 48, "plumb_bob", np.zeros(5), k, np.eye(3), p)


def chosen(path: Path) -> tuple[tuple[str, ...], list[str]]:
    """Topics of the images that `auto` takes, and what is said of others."""

    def make(kind: str, raw: bool) -> StereoRangeEstimator | DepthRangeEstimator:
        if kind == "stereo":
            return StereoRangeEstimator(StereoConfig(), rectify=raw)
        return DepthRangeEstimator(DepthCameraConfig())

    with BagReader(path) as bag:
        found = find_images(bag, ImageInputConfig(), {}, make)
        return found.sources.images, bag.problems


def write_camera(writer: BagWriter, name: str, encoding: str, baseline: float = 0.0) -> None:
    dtype = np.uint16 if encoding == "16UC1" else np.uint8
    pixels = np.zeros((48, 64) if encoding != "bgr8" else (48, 64, 3), dtype)
    namespace = name.rsplit("/", 1)[0]
    info = CameraInfoRecord(START, "optical", calibration(baseline))
    writer.write(f"{namespace}/camera_info", info)
    writer.write(name, ImageRecord(START, "optical", pixels, encoding))


def test_cameras_of_two_hands_are_no_stereo_pair(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        write_camera(writer, "/left_hand/image_raw", "mono8")
        write_camera(writer, "/right_hand/image_raw", "mono8")
        write_camera(writer, "/depth/image_rect", "16UC1")
    images, problems = chosen(tmp_path / "bag")
    assert images == ("/depth/image_rect",)
    assert "/left_hand/image_raw and /right_hand/image_raw are no stereo pair" in problems[0]


def test_colors_of_a_camera_that_is_called_depth_are_no_depths(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        write_camera(writer, "/r200_depth/image_raw", "bgr8")
        write_camera(writer, "/r200_depth/depth/image_raw", "16UC1")
    images, problems = chosen(tmp_path / "bag")
    assert images == ("/r200_depth/depth/image_raw",)
    assert problems == ["/r200_depth/image_raw is no depth image: its encoding is 'bgr8'"]


def test_a_depth_camera_without_a_calibration_is_passed_over(tmp_path: Path) -> None:
    zero = np.zeros((3, 3))
    none = CameraCalibration(64, 48, "", np.zeros(0), zero, zero, np.zeros((3, 4)))
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a/depth/camera_info", CameraInfoRecord(START, "optical", none))
        depths = ImageRecord(START, "optical", np.zeros((48, 64), np.uint16), "16UC1")
        writer.write("/a/depth/image_rect", depths)
        write_camera(writer, "/b/depth/image_rect", "16UC1")
    images, problems = chosen(tmp_path / "bag")
    assert images == ("/b/depth/image_rect",)
    assert problems[0].startswith("/a/depth/image_rect cannot be used: ")


def test_a_true_pair_is_taken_before_a_depth_camera(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        write_camera(writer, "/left/image_rect", "mono8")
        write_camera(writer, "/right/image_rect", "mono8", baseline=0.1)
        write_camera(writer, "/depth/image_rect", "16UC1")
    assert chosen(tmp_path / "bag") == (("/left/image_rect", "/right/image_rect"), [])


@pytest.mark.parametrize("baseline", [75.0, 0.0])  # in mm; not there at all
def test_a_baseline_that_is_not_plausible_is_that_of_tf(tmp_path: Path, baseline: float) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        place = np.eye(4)
        for frame, x in (("left_optical", 0.01), ("right_optical", 0.085)):
            place[0, 3] = x
            record = TransformRecord(START, "rig", frame, place.copy(), is_static=True)
            writer.write("/tf_static", record)
        for side, meant in (("left", 0.0), ("right", baseline)):
            frame = f"{side}_optical"
            info = CameraInfoRecord(START, frame, calibration(meant))
            writer.write(f"/{side}/camera_info", info)
            pixels = np.zeros((48, 64), np.uint8)
            writer.write(f"/{side}/image_rect", ImageRecord(START, frame, pixels, "mono8"))
    with BagReader(tmp_path / "bag") as bag:
        find_images(
            bag,
            ImageInputConfig(),
            {},
            lambda _, raw: StereoRangeEstimator(StereoConfig(), rectify=raw),
        )
        infos = [next(bag.records([f"/{side}/camera_info"])) for side in ("left", "right")]
        assert f"is {baseline:g} m" in bag.problems[0]
        assert "the 0.075 m of tf are taken" in bag.problems[0]
    rig = rig_from_calibrations(*(info.record.calibration for info in infos))
    assert rig.baseline == pytest.approx(0.075)


def test_a_pipe_is_no_bag(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "bag.mcap")
    with pytest.raises(BagError, match="is a pipe"):
        BagReader(tmp_path / "bag.mcap")


def test_a_short_type_name_is_the_long_one() -> None:
    assert Channel("/image", "sensor_msgs/Image", 1).type_name == "sensor_msgs/msg/Image"
    assert Channel("/a", "example/srv/Add_Event", 1).type_name == "example/srv/Add_Event"


def test_a_definition_that_cannot_be_read_spoils_no_other() -> None:
    channels = [
        Channel("/add/_service_event", "a/srv/Add_Event", 1, definition="int64 a\n---\nint64 b\n"),
        Channel("/text", "std_msgs/msg/String", 1, definition="string data\n"),
    ]
    known = typestore_of(channels).fielddefs
    assert "std_msgs/msg/String" in known
    assert "sensor_msgs/msg/Image" in known
    assert "a/srv/Add_Event" not in known


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_metadata_states_otherwise_of_one_topic_hides_no_message(
    tmp_path: Path, storage: str
) -> None:
    """As where somebody has edited the QoS in metadata.yaml; the other topics are as they were."""
    topics = "/left/image_rect", "/right/image_rect"
    with BagWriter(tmp_path / "bag", storage=storage) as writer:
        for topic in topics:
            write_camera(writer, topic, "mono8")
    forever = {"sec": 9223372036, "nsec": 854775807}
    qos = {"history": 1, "depth": 7, "reliability": 2, "durability": 2, "liveliness": 1}
    qos |= {"deadline": forever, "lifespan": forever, "liveliness_lease_duration": forever}
    qos["avoid_ros_namespace_conventions"] = False
    metadata = tmp_path / "bag" / "metadata.yaml"
    content = yaml.safe_load(metadata.read_text("utf-8"))
    entries = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    edited = next(e["topic_metadata"] for e in entries if e["topic_metadata"]["name"] == topics[0])
    edited["offered_qos_profiles"] = [qos]
    metadata.write_text(yaml.safe_dump(content), "utf-8")
    with BagReader(tmp_path / "bag") as bag:
        found = [record.topic for record in bag.records(topics)]
        assert bag.problems == []
    assert sorted(found) == sorted(topics)


def copied(bag: Path, folder: Path, file: str) -> Path:
    """The metadata of a bag in a folder of its own, where it names another file."""
    folder.mkdir()
    name = next(bag.glob("*.mcap")).name
    metadata = (bag / "metadata.yaml").read_text("utf-8")
    assert name in metadata
    (folder / "metadata.yaml").write_text(metadata.replace(name, file), "utf-8")
    return folder


@pytest.mark.parametrize("place", ["../bag/{name}", "{bag}/{name}", "/etc/passwd", "/dev/zero"])
def test_metadata_names_no_file_outside_its_folder(tmp_path: Path, place: str) -> None:
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        write_camera(writer, "/left/image_rect", "mono8")
    file = place.format(bag=bag, name=next(bag.glob("*.mcap")).name)
    with pytest.raises(BagError, match="other"):
        BagReader(copied(bag, tmp_path / "other", file))


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag"])
def test_a_device_is_no_bag(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "zero").with_suffix(suffix).symlink_to("/dev/zero")
    with pytest.raises(BagError, match="zero"):
        BagReader((tmp_path / "zero").with_suffix(suffix))


@pytest.mark.parametrize("target", ["/dev/zero", "a pipe"])
def test_the_file_of_a_bag_is_a_regular_one(tmp_path: Path, target: str) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        write_camera(writer, "/left/image_rect", "mono8")
    file = next((tmp_path / "bag").glob("*.mcap"))
    file.unlink()
    if target == "a pipe":
        os.mkfifo(file)
    else:
        file.symlink_to(target)
    with pytest.raises(BagError):
        BagReader(tmp_path / "bag")


def bomb(levels: int) -> str:
    """Lists of ten links each to the list before: 10^levels words."""
    lines = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, levels)]
    return "".join(["a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n", *lines])


@pytest.mark.parametrize(
    "before",
    [
        bomb(11),
        "a: " + "{b: " * 5000 + "}" * 5000 + "\n",
        "a: !!python/object/apply:os.mkdir [{run}]\n",
    ],
)
def test_odd_yaml_in_metadata_neither_runs_nor_loses_messages(tmp_path: Path, before: str) -> None:
    bag, run = tmp_path / "bag", tmp_path / "run"
    with BagWriter(bag) as writer:
        write_camera(writer, "/left/image_rect", "mono8")
    metadata = bag / "metadata.yaml"
    metadata.write_text(before.replace("{run}", str(run)) + metadata.read_text("utf-8"), "utf-8")
    begin, used = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with BagReader(bag) as reader:
        assert len(list(reader.records(["/left/image_rect"]))) == 1
    assert time.monotonic() - begin < 10.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 100_000  # kB
    assert not run.exists()
