"""stereo_range over DDS: numbers, stamps and frames of what it publishes."""

from __future__ import annotations

from array import array
from functools import partial
from itertools import count
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    rig_from_calibrations,
)
from infomap_ros.messages import (
    decode_image,
    decode_point_cloud,
    encode_camera_info,
    encode_image,
)
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.stereo_range import StereoRangeNode
from infomap_ros.stereo import PACKED_FIELDS, StereoConfig, StereoRangeSensor

TYPES = RclpyMessageTypes()
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
FRAME = "left_optical_frame"
WIDTH, HEIGHT, FOCAL, BASELINE, DISPARITY = 320, 120, 200.0, 0.1, 16
DEPTH = FOCAL * BASELINE / DISPARITY  # 1.25 m


def calibration(baseline: float = 0.0, width: int = WIDTH) -> CameraCalibration:
    k = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    p = np.hstack([k, [[-FOCAL * baseline], [0], [0]]])
    return CameraCalibration(width, HEIGHT, "plumb_bob", np.zeros(5), k, np.eye(3), p)


INFOS = (calibration(), calibration(BASELINE))


def wall(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A textured wall at DEPTH, as the two cameras see it."""
    rng = np.random.default_rng(seed)
    texture = rng.integers(0, 256, (HEIGHT, WIDTH + DISPARITY), dtype=np.uint8)
    texture = cv2.GaussianBlur(texture, (3, 3), 0)
    return texture[:, :WIDTH], texture[:, DISPARITY:]


class Bench:
    """The node with everything around it connected."""

    def __init__(self, graph: Any, raw: bool = False, **parameters: Any) -> None:
        self.graph = graph
        self.node = graph.add(StereoRangeNode, rectify=raw, **parameters)
        kind = "image_raw" if raw else "image_rect"
        self.images = [graph.publisher(Image, f"{side}/{kind}") for side in ("left", "right")]
        self.infos = [
            graph.publisher(CameraInfo, f"{side}/camera_info") for side in ("left", "right")
        ]
        self.clouds = graph.collect(PointCloud2, "points2")
        self.depths = graph.collect(Image, "depth")
        self.disparities = graph.collect(DisparityImage, "disparity")
        graph.connect(*self.images, *self.infos)
        topic = graph.tester.resolve_topic_name("points2")
        graph.spin_until(lambda: self.node._outputs._points.get_subscription_count(), topic)

    def send_infos(self, infos: Any = INFOS, stamp: int = START, frame: str = FRAME) -> None:
        for publisher, info in zip(self.infos, infos, strict=True):
            publisher.publish(encode_camera_info(TYPES, CameraInfoRecord(stamp, frame, info)))
        name = self.infos[-1].topic_name
        seen = self.node.health.values()[f"{name} count"]
        self.graph.spin_until(
            lambda: self.node.health.values()[f"{name} count"] != seen, "camera infos"
        )

    def send_images(
        self, stamp: int = START, encoding: str = "mono8", frame: str = FRAME, late: int = 0
    ) -> None:
        for publisher, pixels, delay in zip(self.images, wall(), (0, late), strict=True):
            content = pixels if encoding == "mono8" else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
            record = ImageRecord(stamp + delay, frame, content, encoding)
            publisher.publish(encode_image(TYPES, record))

    def wait_for_cloud(self) -> Any:
        self.graph.spin_until(lambda: self.clouds, "points2")
        return self.clouds[-1]

    def wait_for_drop(self, reason: str) -> str:
        health = self.node.health
        self.graph.spin_until(lambda: reason in health.drops(), f"a drop: {reason}")
        return health.values()[f"last drop: {reason}"]


def stamp_of(message: Any) -> int:
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


def test_points_are_bit_for_bit_what_the_library_measures(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_infos()
    bench.send_images()

    stamp, frame, rows = decode_rows(bench.wait_for_cloud())

    expected = StereoRangeSensor(rig_from_calibrations(*INFOS), StereoConfig()).measure(*wall())
    assert (stamp, frame) == (START, FRAME)
    assert rows.dtype.names == (*PACKED_FIELDS, "error_correlation")
    assert (bench.clouds[-1].height, bench.clouds[-1].width) == (HEIGHT, WIDTH)
    assert rows.tobytes() == expected.packed.tobytes()


def test_the_wall_is_where_it_is(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_infos()
    bench.send_images()
    graph.spin_until(lambda: bench.depths and bench.disparities, "depth and disparity")

    cloud = decode_point_cloud(bench.wait_for_cloud())
    assert np.nanmedian(cloud.points[..., 2]) == pytest.approx(DEPTH, rel=0.01)
    assert np.isfinite(cloud.points[..., 2]).mean() > 0.7
    depth = decode_image(bench.depths[-1])
    assert (depth.stamp, depth.frame_id, depth.encoding) == (START, FRAME, "32FC1")
    np.testing.assert_array_equal(depth.pixels, cloud.points[..., 2])
    disparity = bench.disparities[-1]
    assert (stamp_of(disparity), disparity.header.frame_id) == (START, FRAME)
    assert (disparity.f, disparity.t) == (pytest.approx(FOCAL), pytest.approx(BASELINE))
    values = decode_image(disparity.image).pixels
    assert np.nanmedian(values) == pytest.approx(DISPARITY, abs=0.2)
    assert disparity.min_disparity < DISPARITY < disparity.max_disparity


def test_raw_images_are_rectified_by_their_camera_infos(graph: Any) -> None:
    turn = cv2.Rodrigues(np.array([0.0, 0.0, 0.02]))[0]  # the left camera is mounted askew
    left = calibration()
    left = CameraCalibration(
        WIDTH, HEIGHT, "plumb_bob", np.zeros(5), left.intrinsics, turn.T, left.projection
    )
    bench = Bench(graph, raw=True)
    bench.send_infos((left, INFOS[1]))
    k = left.intrinsics
    askew = cv2.warpPerspective(wall()[0], k @ turn @ np.linalg.inv(k), (WIDTH, HEIGHT))
    for publisher, pixels in zip(bench.images, (askew, wall()[1]), strict=True):
        publisher.publish(encode_image(TYPES, ImageRecord(START, FRAME, pixels, "mono8")))

    cloud = decode_point_cloud(bench.wait_for_cloud())

    assert np.nanmedian(cloud.points[..., 2]) == pytest.approx(DEPTH, rel=0.02)
    assert np.isfinite(cloud.points[..., 2]).mean() > 0.5


def test_colors_of_any_encoding_become_rgb(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_infos()
    red = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for publisher, pixels in zip(bench.images, wall(), strict=True):
        red[..., 2] = pixels
        publisher.publish(encode_image(TYPES, ImageRecord(START, FRAME, red, "bgr8")))

    cloud = decode_point_cloud(bench.wait_for_cloud())

    assert cloud.colors is not None
    valid = np.isfinite(cloud.points[..., 2])
    np.testing.assert_array_equal(cloud.colors[valid][:, 0], wall()[0][valid])
    assert not cloud.colors[valid][:, 1:].any()


def test_a_pair_waits_for_the_camera_infos(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_images()
    topic = f"{bench.images[1].topic_name} count"
    graph.spin_until(lambda: bench.node.health.values()[topic] == "1", "the images")

    bench.send_infos()

    assert stamp_of(bench.wait_for_cloud()) == START


def test_cameras_without_common_trigger_are_paired_within_the_tolerance(graph: Any) -> None:
    bench = Bench(graph, pairing_tolerance=0.005)
    bench.send_infos()
    bench.send_images(late=4_000_000)

    assert stamp_of(bench.wait_for_cloud()) == START


def test_images_without_partner_are_counted(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_infos()
    bench.send_images(START, late=1)
    bench.send_images(START + SECOND // 10)

    assert stamp_of(bench.wait_for_cloud()) == START + SECOND // 10
    graph.spin_until(lambda: bench.node.health.drops().get("no partner") == 2, "two drops")


@pytest.mark.parametrize(
    ("infos", "reason", "detail"),
    [
        ((INFOS[0], calibration(0.0)), "calibration", "baseline"),
        ((INFOS[1], INFOS[0]), "calibration", "swapped"),
        ((INFOS[0], calibration(BASELINE, width=300)), "calibration", "300"),
        ((calibration(0.0, 640), calibration(BASELINE, 640)), "calibration", "320x120"),
        ((CameraCalibration(WIDTH, HEIGHT), INFOS[1]), "calibration", "not calibrated"),
    ],
)
def test_impossible_calibrations_are_dropped_by_name(
    graph: Any, infos: Any, reason: str, detail: str
) -> None:
    bench = Bench(graph)
    bench.send_infos(infos)
    bench.send_images()

    assert detail in bench.wait_for_drop(reason)

    bench.send_infos(stamp=START + 1)
    bench.send_images(START + SECOND // 10)
    assert stamp_of(bench.wait_for_cloud()) == START + SECOND // 10


@pytest.mark.parametrize(
    ("options", "reason", "detail"),
    [
        ({"encoding": "32FC3"}, "invalid data", "32FC3"),
        ({"frame": ""}, "wrong frame", "frame_id"),
        ({"frame": "other"}, "wrong frame", "'other'"),
    ],
)
def test_impossible_images_are_dropped_by_name(
    graph: Any, options: Any, reason: str, detail: str
) -> None:
    bench = Bench(graph)
    bench.send_infos()
    if "encoding" in options:
        for publisher in bench.images:
            pixels = np.zeros((HEIGHT, WIDTH, 3), np.float32)
            publisher.publish(encode_image(TYPES, ImageRecord(START, FRAME, pixels, "32FC3")))
    else:
        bench.send_images(**options)

    assert detail in bench.wait_for_drop(reason)


def test_a_clock_that_jumps_back_drops_what_has_no_partner_and_goes_on(graph: Any) -> None:
    bench = Bench(graph)
    bench.send_infos()
    left = ImageRecord(START, FRAME, wall()[0], "mono8")
    bench.images[0].publish(encode_image(TYPES, left))
    bench.send_images(START - SECOND // 10)
    early = START - 100 * SECOND

    bench.send_images(early)
    bench.send_images(early + SECOND // 10)  # a jump is believed with its second pair

    graph.spin_until(lambda: early in [stamp_of(m) for m in bench.clouds], "the cloud")
    assert bench.node.health.drops() == {"no partner": 1}


@pytest.mark.parametrize("cameras", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize("wrong", [SECOND, 2_000_000_000 * SECOND])
def test_one_wrong_stamp_costs_one_pair(graph: Any, cameras: tuple[int, ...], wrong: int) -> None:
    bench = Bench(graph)
    bench.send_infos()
    bench.send_images(START)
    for camera in cameras:
        record = ImageRecord(wrong, FRAME, wall()[camera], "mono8")
        bench.images[camera].publish(encode_image(TYPES, record))
    stamps = [START + k * SECOND // 10 for k in range(1, 4)]
    for stamp in stamps:
        bench.send_images(stamp)
    graph.spin_until(lambda: set(stamps) <= {stamp_of(m) for m in bench.clouds}, "the clouds")
    assert wrong not in {stamp_of(m) for m in bench.clouds}
    assert sum(bench.node.health.drops().values()) == 1


def test_nothing_is_measured_that_nobody_wants(graph: Any) -> None:
    node = graph.add(StereoRangeNode)
    images = [graph.publisher(Image, f"{side}/image_rect") for side in ("left", "right")]
    infos = [graph.publisher(CameraInfo, f"{side}/camera_info") for side in ("left", "right")]
    graph.connect(*images, *infos)
    measured: list[Any] = []
    node._estimator.measure = lambda *arguments: measured.append(arguments)
    for publisher, info in zip(infos, INFOS, strict=True):
        publisher.publish(encode_camera_info(TYPES, CameraInfoRecord(START, FRAME, info)))
    for publisher, pixels in zip(images, wall(), strict=True):
        publisher.publish(encode_image(TYPES, ImageRecord(START, FRAME, pixels, "mono8")))
    counts = [f"{publisher.topic_name} count" for publisher in (*images, *infos)]

    graph.spin_until(lambda: all(node.health.values()[c] == "1" for c in counts), "all inputs")

    assert node._worker.waiting == 0
    assert measured == []
    assert node.health.drops() == {}


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("32FC1", np.full((HEIGHT, WIDTH), 1.5, np.float32)),
        ("16UC1", np.full((HEIGHT, WIDTH), 1500, np.uint16)),
    ],
)
def test_a_depth_camera_takes_the_place_of_the_pair(
    graph: Any, encoding: str, pixels: np.ndarray
) -> None:
    node = graph.add(StereoRangeNode, source="depth")
    image, info = (
        graph.publisher(Image, "depth/image_rect"),
        graph.publisher(CameraInfo, "depth/camera_info"),
    )
    clouds = graph.collect(PointCloud2, "points2")
    graph.connect(image, info)
    graph.spin_until(lambda: node._outputs.wanted, "the subscription")
    info.publish(encode_camera_info(TYPES, CameraInfoRecord(START, FRAME, INFOS[0])))
    image.publish(encode_image(TYPES, ImageRecord(START, FRAME, pixels, encoding)))
    graph.spin_until(lambda: clouds, "points2")

    cloud = decode_point_cloud(clouds[-1])

    assert (cloud.stamp, cloud.frame_id) == (START, FRAME)
    assert np.nanmedian(cloud.points[..., 2]) == pytest.approx(1.5, abs=1e-3)
    assert cloud.covariances is not None
    assert np.nanmedian(cloud.covariances[..., 2, 2]) > 0.0


@pytest.mark.parametrize("name", ["min_depth", "queue_size", "source"])
def test_a_node_does_not_start_with_an_impossible_parameter(graph: Any, name: str) -> None:
    value = {"min_depth": -1.0, "queue_size": 0, "source": "sonar"}[name]

    with pytest.raises(ConfigError, match=f"'{name}'"):
        graph.add(StereoRangeNode, **{name: value})


numbers = st.integers(0, 2000)


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    changes=st.lists(
        st.one_of(
            st.tuples(st.sampled_from(["height", "width", "step"]), numbers),
            st.tuples(
                st.just("encoding"), st.sampled_from(["rgb8", "mono16", "", "bayer", "64FC1"])
            ),
            st.tuples(st.just("is_bigendian"), st.integers(0, 1)),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_whatever_an_image_claims_the_node_survives(
    graph: Any, changes: list[tuple[str, Any]]
) -> None:
    bench = Bench(graph) if not graph.nodes[1:] else graph.bench
    graph.bench = bench
    bench.send_infos(stamp=START)
    for publisher, pixels in zip(bench.images, wall(), strict=True):
        message = encode_image(TYPES, ImageRecord(START, FRAME, pixels, "mono8"))
        for name, value in changes:
            setattr(message, name, value)
        publisher.publish(message)
    before = sum(bench.node.health.drops().values()) + bench.node.health.results()

    def told() -> bool:
        health = bench.node.health
        return sum(health.drops().values()) + health.results() > before

    graph.spin_until(told, "a result or a counted drop", timeout=5.0)


def test_compressed_images_are_read_where_a_topic_is_named_as_image_transport_does(
    graph: Any,
) -> None:
    remaps = [f"{s}/image_rect:=cam/{s}/image_rect/compressed" for s in ("left", "right")]
    given = ["--ros-args", *(part for remap in remaps for part in ("-r", remap))]
    graph.add(partial(StereoRangeNode, cli_args=given))
    clouds = graph.collect(PointCloud2, "points2")
    images = [
        graph.publisher(CompressedImage, f"cam/{side}/image_rect/compressed")
        for side in ("left", "right")
    ]
    infos = [graph.publisher(CameraInfo, f"{side}/camera_info") for side in ("left", "right")]
    graph.connect(*images, *infos)
    for publisher, info in zip(infos, INFOS, strict=True):
        publisher.publish(encode_camera_info(TYPES, CameraInfoRecord(START, FRAME, info)))

    seconds = count(START // SECOND)

    def look() -> bool:
        second = next(seconds)
        for publisher, pixels in zip(images, wall(), strict=True):
            message = CompressedImage(format="mono8; png compressed mono8")
            message.header.frame_id, message.header.stamp.sec = FRAME, second
            message.data = array("B", cv2.imencode(".png", pixels)[1].tobytes())
            publisher.publish(message)
        return bool(clouds)

    graph.spin_until(look, "a cloud")
    depths = decode_point_cloud(clouds[0]).points[..., 2]
    assert np.nanmedian(depths) == pytest.approx(DEPTH, rel=0.02)
