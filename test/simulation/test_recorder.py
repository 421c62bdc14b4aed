from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, PoseRecord, Record, TextRecord
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.recorder import Recorder, RecorderConfig, record_bag
from infomap_ros.simulation.worlds.scenes import SceneConfig


@pytest.fixture(scope="module")
def config(small_scene: SceneConfig) -> RecorderConfig:
    camera = StereoCameraConfig(width=96, height=64, supersampling=1)
    return RecorderConfig(pairs=3, rate=4.0, state_rate=8.0, scene=small_scene, camera=camera)


@pytest.fixture(scope="module")
def records(config: RecorderConfig) -> list[tuple[str, Record]]:
    return list(Recorder(config).records())


def test_everything_is_recorded_at_its_rate(records: list[tuple[str, Record]]) -> None:
    assert Counter(topic for topic, _ in records) == {
        "/robot_description": 1,
        "/ground_truth/scene": 1,
        "/joint_states": 5,
        "/odom": 5,
        "/camera_pose": 3,
        "/ground_truth/camera_pose": 3,
        "/left/camera_info": 3,
        "/right/camera_info": 3,
        "/left/image_raw": 3,
        "/right/image_raw": 3,
    }
    stamps = [record.stamp for _, record in records]
    assert stamps == sorted(stamps)
    images = {record.stamp for topic, record in records if topic == "/left/image_raw"}
    assert images <= {record.stamp for topic, record in records if topic == "/joint_states"}
    assert sorted(np.diff(sorted(images))) == [250_000_000, 250_000_000]


def test_same_seed_same_records(config: RecorderConfig, records: list[tuple[str, Record]]) -> None:
    again = list(Recorder(config).records())
    for (topic, first), (_, second) in zip(records, again, strict=True):
        if isinstance(first, ImageRecord):
            assert isinstance(second, ImageRecord)
            assert np.array_equal(first.pixels, second.pixels), topic
        if isinstance(first, PoseRecord):
            assert isinstance(second, PoseRecord)
            assert np.array_equal(first.transform, second.transform), topic


def test_bag_reads_back_as_it_was_recorded(
    config: RecorderConfig, records: list[tuple[str, Record]], tmp_path: Path
) -> None:
    folder = record_bag(tmp_path / "bag", config)
    with BagReader(folder) as reader:
        read = [(entry.topic, entry.record) for entry in reader.records()]
    images = [r.pixels for t, r in read if t == "/left/image_raw" and isinstance(r, ImageRecord)]
    sent = [r.pixels for t, r in records if t == "/left/image_raw" and isinstance(r, ImageRecord)]
    assert all(np.array_equal(a, b) for a, b in zip(images, sent, strict=True))
    infos = [r for _, r in read if isinstance(r, CameraInfoRecord)]
    assert {info.frame_id for info in infos} == {
        "left_camera_optical_frame",
        "right_camera_optical_frame",
    }
    assert {topic for topic, _ in read} == {topic for topic, _ in records} | {"/tf_static"}


def test_baseline_of_the_configuration_is_published(
    config: RecorderConfig,
) -> None:
    import dataclasses

    recorder = Recorder(dataclasses.replace(config, baseline=0.2))
    assert recorder.camera.rig.baseline == pytest.approx(0.2)
    published = dict(next(recorder.records()) for _ in range(1))
    text = published["/robot_description"]
    assert isinstance(text, TextRecord)
    assert 'xyz="0 0.1 0"' in text.text


def test_impossible_parameters_are_refused() -> None:
    with pytest.raises(ConfigError, match="pairs"):
        RecorderConfig(pairs=1)
    with pytest.raises(ConfigError, match="baseline"):
        RecorderConfig(baseline=0.001)
