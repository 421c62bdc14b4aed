"""Small bags that tests write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from infomap_ros.geometry import ImageRecord, JointStateRecord, PoseRecord, Record, TransformRecord
from infomap_ros.messages import RosbagsMessageTypes, encode, message_type_of

STEP = 100_000_000
START = 1_700_000_000_000_000_000
FRAMES = 40


def sample_records(size: int = 120) -> list[tuple[str, Record]]:
    """Images, joints and poses at 10 Hz; a static transform first. Images compress little."""
    rng = np.random.default_rng(7)
    records: list[tuple[str, Record]] = [
        ("/tf_static", TransformRecord(START, "base", "camera", np.eye(4), is_static=True))
    ]
    for index in range(FRAMES):
        stamp = START + index * STEP
        pixels = rng.integers(0, 64, (size, size, 3), dtype=np.uint8)
        pose = np.eye(4)
        pose[0, 3] = index
        joints = JointStateRecord(stamp, "", ("arm",), np.array([0.1 * index]))
        records += [
            ("/left/image_raw", ImageRecord(stamp, "camera", pixels, "rgb8")),
            ("/joint_states", joints),
            ("/camera_pose", PoseRecord(stamp + 7, "map", pose, np.eye(6))),
        ]
    return records


def write_rosbag2(
    path: Path, storage: StoragePlugin, mode: CompressionMode, records: list[tuple[str, Record]]
) -> Path:
    """Write by rosbags itself, in a form that `BagWriter` does not write."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = RosbagsMessageTypes(store)
    writer = Writer(path, version=8, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    connections = {}
    with writer:
        for topic, record in records:
            name = message_type_of(record)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            data = store.serialize_cdr(encode(types, record), name)
            writer.write(connections[topic], record.stamp, data)
    return path


def write_rosbag1(
    path: Path, records: list[tuple[str, Record]], compression: str | None = None
) -> Path:
    """Write a ROS 1 bag; topics without the first slash, as they occur."""
    store, store1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    definition = "geometry_msgs/TransformStamped[] transforms"
    store1.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
    types = RosbagsMessageTypes(store)
    connections = {}
    writer = Rosbag1Writer(path)
    if compression:
        writer.set_compression(getattr(Rosbag1Writer.CompressionFormat, compression))
    with writer:
        for topic, record in records:
            name = message_type_of(record)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic[1:], name, typestore=store1)
            data = store.cdr_to_ros1(store.serialize_cdr(encode(types, record), name), name)
            writer.write(connections[topic], record.stamp, data)
    return path
