"""Which images of a bag are used: a stereo pair or a depth camera.

What a bag holds beside images and poses: frames, fixed transforms, joints, the description.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from infomap_ros.errors import BagError, CalibrationError, InfomapError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, Record, TextRecord, TransformRecord
from infomap_ros.geometry.camera import rig_from_calibrations
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.messages import JOINT_STATE, STRING, TF
from infomap_ros.pipeline.perception import ImageSources, Perception, ViewEstimator
from infomap_ros.pipeline.range_estimator import DEPTH_ENCODINGS, RangeEstimator
from infomap_ros.replay.bags.reader import BagReader, Recording
from infomap_ros.replay.bags.topics import (
    DepthTopics,
    StereoTopics,
    Topics,
    check_present,
    find_depth_topics,
    find_stereo_topics,
)

_TF_TYPES = (TF, "tf/msg/tfMessage")


def types_of(bag: Recording) -> dict[str, str]:
    """Type name of each topic of a bag."""
    return {topic: channel.type_name for topic, channel in bag.topics.items()}


def frame_of(bag: Recording, topic: str) -> str:
    """Frame of the first message on a topic.

    Raises:
        BagError: there is none that can be read.
    """
    first = next(bag.records([topic]), None)
    if first is None:
        raise BagError(f"topic {topic} has no message that can be read")
    return first.record.frame_id


def tf_topics_of(types: Topics) -> list[str]:
    """Topics of transforms, fixed ones included."""
    return [name for name, kind in types.items() if kind in _TF_TYPES]


def moving_tf_topics(tf_topics: list[str]) -> list[str]:
    """Those of the topics of transforms that carry changing ones."""
    return [name for name in tf_topics if not name.endswith("tf_static")]


def static_transforms(bag: Recording, tf_topics: list[str]) -> list[TransformRecord]:
    """All transforms on those of the topics that carry fixed ones."""
    static = [name for name in tf_topics if name.endswith("tf_static")]
    records = (entry.record for entry in bag.records(static)) if static else iter(())
    return [record for record in records if isinstance(record, TransformRecord)]


def joint_topics_of(types: Topics, given: str = "") -> list[str]:
    """Topics of joint states: the given one, or all.

    Raises:
        BagError: the given one is not there.
    """
    if given:
        check_present(types, [given])
        return [given]
    return [name for name, kind in types.items() if kind == JOINT_STATE]


def description_in(bag: Recording, types: Topics) -> str:
    """The robot description that a bag holds, empty where it holds none."""
    topics = [n for n, kind in types.items() if kind == STRING and n.endswith("robot_description")]
    records = (entry.record for entry in bag.records(topics)) if topics else iter(())
    texts = (record.text for record in records if isinstance(record, TextRecord))
    return next((text for text in texts if "<robot" in text), "")


@dataclass(frozen=True)
class ImageInputConfig:
    """Which images of a bag are used.

    Raises:
        ConfigError: a value is not among its choices or out of its range.
    """

    source: str = parameter(
        "auto",
        "Where range comes from; auto takes a stereo pair if there is one, else a depth camera.",
        choices=("auto", "stereo", "depth"),
    )
    rectify: str = parameter(
        "auto",
        "Whether the stereo images are raw; auto asks the name of their topic for 'rect'.",
        choices=("auto", "yes", "no"),
    )
    pairing_tolerance: float = parameter(
        0.005, "Largest difference of the stamps of a pair.", unit="s", low=0.0, high=1.0
    )

    def __post_init__(self) -> None:
        check_config(self)


def find_images(
    bag: Recording,
    config: ImageInputConfig,
    given: Mapping[str, str],
    make_estimator: Callable[[str, bool], RangeEstimator | ViewEstimator],
    *,
    color: bool = False,
) -> Perception:
    """Find the images and who measures them.

    A pair without a baseline, or a depth camera without depths, is passed over where nobody names
    it; `Recording.problems` says so.

    Args:
        bag: the bag.
        config: which images are wanted.
        given: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``color``.
        make_estimator: called with ``stereo`` or ``depth`` and whether the images are raw.
        color: whether a depth image waits for its color image.

    Raises:
        BagError: there is no stereo pair and no depth camera, or not the one that is wanted.
    """
    wanted = "depth" if config.source == "auto" and given.get("depth") else config.source
    failures = []
    for kind in ("stereo", "depth") if wanted == "auto" else (wanted,):
        try:
            sources, raw = _sources(kind, bag, config, given_of(given, kind), color)
        except BagError as error:
            failures.append(str(error))
            continue
        return Perception(sources, make_estimator(kind, raw), config.pairing_tolerance)
    raise BagError("; ".join(failures))


def _sources(
    kind: str, bag: Recording, config: ImageInputConfig, given: Mapping[str, str], color: bool
) -> tuple[ImageSources, bool]:
    """Topics of a kind of images, and whether they are raw."""
    types = types_of(bag)
    if kind == "stereo":
        pair = find_stereo_topics(types, given, lambda pair: _noted(bag, _why_no_pair(bag, pair)))
        raw = {"auto": not pair.is_rectified, "yes": True, "no": False}[config.rectify]
        infos = pair.left_info, pair.right_info
        return ImageSources((pair.left_image, pair.right_image), infos), raw
    found = find_depth_topics(types, given, lambda one: _noted(bag, _why_no_depth(bag, one)))
    colors = (found.color,) if color and found.color else ()
    return ImageSources((found.depth, *colors), (found.info,)), False


def _noted(bag: Recording, problem: str) -> str:
    """Say of images that they are passed over."""
    if problem and problem not in bag.problems:
        bag.problems.append(problem)
    return problem


def _why_no_pair(bag: Recording, pair: StereoTopics) -> str:
    """Why the camera infos of two images are not those of a stereo pair; empty where they are."""
    left, right = (_first(bag, topic) for topic in (pair.left_info, pair.right_info))
    if not (isinstance(left, CameraInfoRecord) and isinstance(right, CameraInfoRecord)):
        return ""
    try:
        rig_from_calibrations(left.calibration, right.calibration)
    except CalibrationError as error:
        baseline = _baseline_by_tf(bag, left, right)
        if baseline is not None and isinstance(bag, BagReader):
            projection = right.calibration.projection.copy()
            projection[0, 3] = left.calibration.projection[0, 3] - projection[0, 0] * baseline
            mended = replace(right.calibration, projection=projection)
            with suppress(CalibrationError):
                rig_from_calibrations(left.calibration, mended)
                bag.replaced[pair.right_info] = mended
                _noted(bag, f"{error}; the {baseline:.4g} m of tf are taken")
                return ""
        return f"{pair.left_image} and {pair.right_image} are no stereo pair: {error}"
    return ""


_ASIDE = 0.05  # of the baseline of a rectified pair, that is not along its rows


def _baseline_by_tf(bag: Recording, left: Record, right: Record) -> float | None:
    """How far the right camera is to the right of the left one by fixed transforms [m].

    None where they do not tell, or not of two optical frames side by side.
    """
    tree = TransformTree()
    try:
        for edge in static_transforms(bag, tf_topics_of(types_of(bag))):
            tree.add_transform(edge)
        root = tree.root_of(left.frame_id)
        places = [tree.at(root, info.frame_id, info.stamp).transform for info in (left, right)]
    except InfomapError:
        return None
    across, *aside = (np.linalg.inv(places[0]) @ places[1])[:3, 3]
    return float(across) if np.linalg.norm(aside) < _ASIDE * across else None


def _why_no_depth(bag: Recording, topics: DepthTopics) -> str:
    """Why an image holds no depths; empty where it may."""
    image = _first(bag, topics.depth)
    if isinstance(image, ImageRecord) and image.encoding not in DEPTH_ENCODINGS:
        return f"{topics.depth} is no depth image: its encoding is '{image.encoding}'"
    info = _first(bag, topics.info)
    try:
        if isinstance(info, CameraInfoRecord):
            info.calibration.rectified_camera()
    except CalibrationError as error:
        return f"{topics.depth} cannot be used: {error}"
    return ""


def _first(bag: Recording, topic: str) -> Record | None:
    """The first message of a topic that can be read."""
    first = next(iter(bag.records([topic])), None)
    return None if first is None else first.record


def given_of(topics: Mapping[str, str], task: str) -> dict[str, str]:
    """Of the topics that the user names, those of a stereo pair or of a depth camera."""
    names = {
        "stereo": ("left_image", "right_image", "left_info", "right_info"),
        "depth": ("depth", "info", "color"),
    }[task]
    return {name: topics[name] for name in names if topics.get(name)}
