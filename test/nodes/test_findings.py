"""What the doctor sees in records and in a live graph."""

from __future__ import annotations

from array import array
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord, PoseRecord
from infomap_ros.messages import encode_camera_info, encode_image
from infomap_ros.nodes import doctor
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.doctor import Doctor, main

FRAME = "left_optical_frame"


def calibration(width: int = 320, height: int = 240, baseline: float = 0.0) -> CameraCalibration:
    k = np.array([[300.0, 0, width / 2], [0, 300.0, height / 2], [0, 0, 1]])
    p = np.hstack([k, [[-300.0 * baseline], [0], [0]]])
    return CameraCalibration(width, height, "plumb_bob", np.zeros(5), k, np.eye(3), p)


def textured(rng: np.random.Generator, height: int = 240, width: int = 320) -> np.ndarray:
    noise = rng.integers(0, 256, (height // 8, width // 8)).astype(np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_NEAREST)


def image(pixels: np.ndarray, frame: str = FRAME, stamp: int = 0) -> ImageRecord:
    return ImageRecord(stamp, frame, pixels, "mono8")


def test_rows_that_are_not_aligned_are_measured(rng: np.random.Generator) -> None:
    scene = textured(rng, 260, 340)
    left, right = scene[10:250, 10:330], scene[6:246, 5:325]

    assert doctor.row_offset(left, right) == pytest.approx(4.0, abs=0.5)
    assert not doctor.check_rows("right", image(left), image(right)).good
    assert doctor.check_rows("right", image(left), image(scene[10:250, 3:323])).good


def test_a_calibration_for_another_size_is_found() -> None:
    finding = doctor.check_size(
        "/left", image(np.zeros((480, 640), np.uint8)), CameraInfoRecord(0, FRAME, calibration())
    )

    assert not finding.good
    assert "640x480" in finding.text
    assert "320x240" in finding.text


def test_a_rig_without_baseline_is_found() -> None:
    assert not doctor.check_rig("/right", calibration(), calibration()).good
    assert doctor.check_rig("/right", calibration(), calibration(baseline=0.1)).good


@pytest.mark.parametrize(
    ("poses", "good"), [([], False), ([0, 10, 20], True), ([10**12, 2 * 10**12], False)]
)
def test_stamps_without_poses_are_found(poses: list[int], good: bool) -> None:
    records = [PoseRecord(stamp, "map", np.eye(4)) for stamp in poses]

    assert doctor.check_stamps("/camera_pose", [5, 10], records).good is good


def test_the_doctor_names_what_a_graph_lacks(graph: Any, rng: np.random.Generator) -> None:
    examiner = graph.add(lambda **arguments: Doctor(False, **arguments))
    types = RclpyMessageTypes()
    left = graph.publisher(Image, "left/image_rect")
    graph.publisher(Image, "camera/right/image_rect")
    info = graph.publisher(
        type(encode_camera_info(types, CameraInfoRecord(0, "", calibration()))), "left/camera_info"
    )
    graph.tester.create_subscription(String, "chatter", lambda _: None, qos.stream())
    graph.tester.create_publisher(String, "chatter", qos.sensor_data())

    def heard() -> bool:
        examiner.listen_to_all()
        if left.get_subscription_count() and info.get_subscription_count():
            left.publish(encode_image(types, image(textured(rng, 120, 160))))
            info.publish(encode_camera_info(types, CameraInfoRecord(0, "other", calibration())))
        return bool(examiner.records["left/image_rect"] and examiner.records["left/camera_info"])

    graph.spin_until(heard, "image and camera info")
    space = graph.namespace
    wrong = {(f.subject, f.text) for f in examiner.examine() if not f.good}

    def about(subject: str) -> str:
        return " | ".join(text for name, text in wrong if name == f"{space}/{subject}")

    assert "image is 160x120 px, calibration is for 320x240 px" in about("left/image_rect")
    assert f"'{FRAME}', but {space}/left/camera_info has 'other'" in about("left/image_rect")
    assert f"-r right/image_rect:={space}/camera/right/image_rect" in about("right/image_rect")
    assert "nobody publishes it" in about("camera_pose")
    assert "tester -> tester never connect" in about("chatter")


def test_the_doctor_says_that_the_camera_is_lost(graph: Any) -> None:
    examiner = graph.add(lambda **arguments: Doctor(False, **arguments))
    told = graph.tester.create_publisher(DiagnosticArray, "/diagnostics", qos.stream())
    graph.connect(told)
    values = {"state": "lost", "reason": "3 fiducials in view, 5 needed", "fiducials tracked": "0"}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    told.publish(DiagnosticArray(status=[DiagnosticStatus(hardware_id="/robot", values=pairs)]))

    graph.spin_until(lambda: examiner.conditions, "the diagnostics")

    wrong = {f.subject: f.text for f in examiner.examine() if not f.good}
    assert wrong["/robot"] == "lost, 0 fiducials tracked: 3 fiducials in view, 5 needed"


def test_the_doctor_reads_compressed_images(graph: Any, rng: np.random.Generator) -> None:
    remap = ["--ros-args", "-r", "left/image_rect:=left/image_rect/compressed"]
    examiner = graph.add(lambda **arguments: Doctor(False, cli_args=remap, **arguments))
    left = graph.publisher(CompressedImage, "left/image_rect/compressed")
    pixels = textured(rng, 120, 160)
    message = CompressedImage(format="mono8; png compressed mono8")
    message.data = array("B", cv2.imencode(".png", pixels)[1].tobytes())

    def heard() -> bool:
        examiner.listen_to_all()
        left.publish(message)
        return bool(examiner.records["left/image_rect"])

    graph.spin_until(heard, "an image")
    assert examiner.records["left/image_rect"][0].encoding == "mono8"


def test_the_doctor_tells_raw_from_rectified(graph: Any) -> None:
    examiner = graph.add(lambda **arguments: Doctor(False, **arguments))
    raw = graph.publisher(Image, "left/image_raw")
    graph.spin_until(lambda: examiner.count_publishers(raw.topic_name), "the publisher")

    texts = [f.text for f in examiner.examine() if f.subject.endswith("left/image_rect")]

    assert "start stereo_range with rectify:=true" in texts[0]


def test_the_command_names_what_is_wrong_and_fails(
    graph: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(graph.domain))

    status = main(["--seconds", "0.3", "--ros-args", "-r", f"__ns:={graph.namespace}"])

    lines = capsys.readouterr().out.splitlines()
    assert status == 1
    remedy = "start fiducial_localization, or dead_reckoning on a robot with odometry alone"
    assert f"WRONG {graph.namespace}/camera_pose: nobody publishes it: {remedy}" in lines
    assert lines[-1].endswith("checks failed")
