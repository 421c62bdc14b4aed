"""Bags of every format become the same records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry import ImageRecord, PointCloudRecord, PoseRecord, TextRecord
from infomap_ros.messages import decode_image, decode_transforms
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.bags.writer import BagWriter

from .bags import FRAMES, START, STEP, sample_records, write_rosbag1, write_rosbag2

RECORDS = sample_records(size=24)


def check_is_the_sample(path: Path) -> None:
    """Compare everything that a bag gives with what was written."""
    with BagReader(path) as bag:
        found = list(bag.records())
        assert bag.problems == []
        assert not bag.skipped
        assert {t.topic: t.count for t in bag.topics.values()} == {
            "/tf_static": 1, "/left/image_raw": FRAMES, "/joint_states": FRAMES,
            "/camera_pose": FRAMES,
        }  # fmt: skip
        assert bag.topics["/tf_static"].latched
        assert (bag.start, bag.end) == (START, START + (FRAMES - 1) * STEP + 7)
    assert [f.received for f in found] == sorted(r.stamp for _, r in RECORDS)
    content = {(f.topic, f.received): f.record for f in found}
    for topic, record in RECORDS:
        same = content[topic, record.stamp]
        assert type(same) is type(record)
        assert (same.stamp, same.frame_id) == (record.stamp, record.frame_id)
        if isinstance(record, ImageRecord):
            np.testing.assert_array_equal(same.pixels, record.pixels)
        if isinstance(record, PoseRecord):
            np.testing.assert_array_equal(same.transform, record.transform)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_the_writer_writes(tmp_path, storage):
    with BagWriter(tmp_path / "bag", storage=storage) as writer:
        for topic, record in RECORDS:
            writer.write(topic, record)
    check_is_the_sample(tmp_path / "bag")


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    "mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE]
)
def test_compressed_bags(tmp_path, storage, mode):
    check_is_the_sample(write_rosbag2(tmp_path / "bag", storage, mode, RECORDS))


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_ros1_bags(tmp_path, compression):
    check_is_the_sample(write_rosbag1(tmp_path / "old.bag", RECORDS, compression))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_file_without_its_folder(tmp_path, storage):
    with BagWriter(tmp_path / "bag", storage=storage) as writer:
        for topic, record in RECORDS:
            writer.write(topic, record)
    suffix = {"mcap": ".mcap", "sqlite3": ".db3"}[storage]
    check_is_the_sample(tmp_path / "bag" / f"bag{suffix}")


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_packed_messages_without_the_metadata_that_tells(tmp_path, storage):
    bag = write_rosbag2(tmp_path / "bag", storage, CompressionMode.MESSAGE, RECORDS)
    (bag / "metadata.yaml").unlink()
    (only,) = bag.iterdir()
    check_is_the_sample(only)


def test_ros1_messages_come_out_as_cdr(tmp_path):
    path = write_rosbag1(tmp_path / "old.bag", RECORDS)
    store = get_typestore(Stores.ROS2_JAZZY)
    with BagReader(path) as bag:
        messages = {m.topic: m for m in bag.messages()}
    image = store.deserialize_cdr(messages["/left/image_raw"].data, "sensor_msgs/msg/Image")
    assert decode_image(image).frame_id == "camera"
    tf = store.deserialize_cdr(messages["/tf_static"].data, "tf2_msgs/msg/TFMessage")
    assert decode_transforms(tf)[0].child_frame_id == "camera"


def test_records_of_chosen_topics_only(tmp_path):
    path = write_rosbag2(tmp_path / "b", StoragePlugin.MCAP, CompressionMode.NONE, RECORDS)
    with BagReader(path) as bag:
        assert {r.topic for r in bag.records(["/joint_states"])} == {"/joint_states"}


def test_topic_that_is_not_there_names_those_that_are(tmp_path):
    path = write_rosbag2(tmp_path / "b", StoragePlugin.MCAP, CompressionMode.NONE, RECORDS)
    with BagReader(path) as bag, pytest.raises(BagError, match=r"/nothing.*/camera_pose"):
        list(bag.records(["/nothing"]))


def test_malformed_message_is_counted_and_the_rest_is_read(tmp_path):
    covariance = -np.eye(6)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/pose", PoseRecord(START, "map", np.eye(4), covariance))
        writer.write("/pose", PoseRecord(START + 1, "map", np.eye(4)))
    with BagReader(tmp_path / "bag") as bag:
        assert [r.received for r in bag.records()] == [START + 1]
        ((reason, count),) = bag.skipped.items()
        assert count == 1
        assert "negative eigenvalue" in reason


def test_existing_bag_is_not_overwritten_unless_asked(tmp_path):
    for overwrite in (False, True):
        with BagWriter(tmp_path / "bag", overwrite=overwrite) as writer:
            writer.write("/text", TextRecord(START, "", "x"))
    with pytest.raises(BagError, match="already"):
        BagWriter(tmp_path / "bag")


def test_folder_with_other_things_is_never_removed(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(BagError, match="already"):
        BagWriter(tmp_path, overwrite=True)
    assert (tmp_path / "thesis.tex").exists()


def test_topic_keeps_its_type(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/topic", TextRecord(START, "", "x"))
        with pytest.raises(InvalidInputError, match="/topic"):
            writer.write("/topic", PoseRecord(START, "map", np.eye(4)))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("nothing.mcap", None, "there is no bag"),
        ("notes.txt", b"hello", "not a bag"),
        ("photo.mcap", b"\x89PNG\r\n\x1a\n" * 20, "not an MCAP"),
        ("photo.bag", b"\x89PNG\r\n\x1a\n" * 20, "not a ROS 1 bag"),
        ("photo.db3", b"\x89PNG\r\n\x1a\n" * 200, "SQLite"),
        ("empty.mcap", b"", "not an MCAP"),
        ("empty.bag", b"", "not a ROS 1 bag"),
        ("empty.db3", b"", "no table of topics"),
    ],
)
def test_foreign_file_is_refused_by_name(tmp_path, name, content, said):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BagError, match=said):
        BagReader(path)


def test_folder_without_bags_is_refused(tmp_path):
    with pytest.raises(BagError, match="no bag files"):
        BagReader(tmp_path)


@pytest.mark.parametrize(
    ("name", "topic", "count"),
    [
        ("nav2_turtlebot.mcap", "/amcl_pose", 135),
        ("evo_tf_example", "/tf", 517),
        ("evo_ROS_example.bag", "/groundtruth", 12765),
    ],
)
def test_real_bags(real_data, name, topic, count):
    with BagReader(real_data / "bags" / name) as bag:
        assert sum(1 for _ in bag.records([topic])) == count
        assert not bag.skipped


def test_real_ros1_cloud(real_data):
    with BagReader(real_data / "bags" / "some_cows.bag") as bag:
        clouds = [r.record for r in bag.records(["/point_cloud"])]
    assert len(clouds) == 4
    assert all(isinstance(c, PointCloudRecord) and len(c.points) > 1000 for c in clouds)
