"""Topics are found as cameras in the field name them."""

from __future__ import annotations

import pytest

from infomap_ros.errors import BagError
from infomap_ros.messages import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    ODOMETRY,
    POSE,
    POSE_WITH_COVARIANCE,
    TF,
)
from infomap_ros.replay.bags.topics import find_depth_topics, find_pose_topic, find_stereo_topics


def camera(namespace: str, *images: str, kind: str = IMAGE) -> dict[str, str]:
    return {f"{namespace}/{image}": kind for image in images} | {
        f"{namespace}/camera_info": CAMERA_INFO
    }


@pytest.mark.parametrize(
    ("topics", "left", "right", "rectified"),
    [
        (
            camera("/left", "image_raw") | camera("/right", "image_raw"),
            "/left/image_raw", "/right/image_raw", False,
        ),
        (
            camera("/left", "image_raw", "image_rect")
            | camera("/right", "image_raw", "image_rect"),
            "/left/image_rect", "/right/image_rect", True,
        ),
        (
            camera("/camera/infra1", "image_rect_raw") | camera("/camera/infra2", "image_rect_raw"),
            "/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw", True,
        ),
        (
            camera("/cam0", "image_raw") | camera("/cam1", "image_raw"),
            "/cam0/image_raw", "/cam1/image_raw", False,
        ),
        (
            camera("/rover/stereo_left", "image_raw/compressed", kind=COMPRESSED_IMAGE)
            | camera("/rover/stereo_right", "image_raw/compressed", kind=COMPRESSED_IMAGE),
            "/rover/stereo_left/image_raw/compressed", "/rover/stereo_right/image_raw/compressed",
            False,
        ),
    ],
)  # fmt: skip
def test_stereo_pairs(topics, left, right, rectified):
    found = find_stereo_topics(topics)
    assert (found.left_image, found.right_image) == (left, right)
    assert found.is_rectified == rectified
    assert found.left_info in topics
    assert found.left_info != found.right_info


def test_given_topics_win():
    topics = camera("/left", "image_raw") | camera("/right", "image_raw") | camera("/a", "x")
    topics |= camera("/b", "x")
    found = find_stereo_topics(topics, {"left_image": "/a/x", "right_image": "/b/x"})
    assert found.names == ("/a/x", "/b/x", "/a/camera_info", "/b/camera_info")


def test_word_that_only_contains_left_is_no_side():
    topics = camera("/leftover", "image_raw") | camera("/rightover", "image_raw")
    with pytest.raises(BagError, match=r"no stereo pair.*/leftover/image_raw"):
        find_stereo_topics(topics)


def test_given_topic_that_is_absent_is_named():
    with pytest.raises(BagError, match="/nowhere"):
        find_stereo_topics(camera("/left", "image_raw"), {"left_image": "/nowhere"})


def test_image_without_camera_info_is_named():
    with pytest.raises(BagError, match="camera info beside /left/image_raw"):
        find_stereo_topics({"/left/image_raw": IMAGE, "/right/image_raw": IMAGE})


def test_depth_camera_prefers_what_is_aligned_to_the_colors():
    topics = camera("/camera/depth", "image_rect_raw") | camera("/camera/color", "image_raw")
    topics |= camera("/camera/aligned_depth_to_color", "image_raw")
    found = find_depth_topics(topics)
    assert found.depth == "/camera/aligned_depth_to_color/image_raw"
    assert found.info == "/camera/aligned_depth_to_color/camera_info"
    assert found.color == "/camera/color/image_raw"


def test_depth_camera_of_the_design():
    topics = camera("/depth", "image_rect") | camera("/rgb", "image_rect")
    found = find_depth_topics(topics)
    assert (found.depth, found.color) == ("/depth/image_rect", "/rgb/image_rect")


def test_no_depth_camera_says_what_there_is():
    with pytest.raises(BagError, match=r"no depth camera.*/left/image_raw"):
        find_depth_topics(camera("/left", "image_raw"))


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        ({"/tf": TF, "/odom": ODOMETRY, "/camera_pose": POSE_WITH_COVARIANCE}, "/camera_pose"),
        ({"/ground_truth/camera_pose": POSE, "/camera_pose": POSE_WITH_COVARIANCE}, "/camera_pose"),
        ({"/ground_truth/camera_pose": POSE, "/pose": POSE}, "/ground_truth/camera_pose"),
        ({"/groundtruth": POSE, "/ORB-SLAM": POSE}, "/groundtruth"),
        ({"/odom": ODOMETRY, "/tf": TF, "/tf_static": TF}, "/odom"),
        ({"/tf": TF, "/tf_static": TF}, "/tf"),
    ],
)
def test_pose_topics(topics, expected):
    assert find_pose_topic(topics) == expected


def test_no_pose_topic_is_an_error():
    with pytest.raises(BagError, match="no pose"):
        find_pose_topic({"/tf_static": TF, "/image": IMAGE})
