"""Which topics of a bag serve a task: found by type and name, unless they are given."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

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

Topics = Mapping[str, str]
"""Type name by topic."""

Candidate = TypeVar("Candidate")
Found = TypeVar("Found")

_IMAGE_TYPES = (IMAGE, COMPRESSED_IMAGE)
_POSE_TYPES = (POSE_WITH_COVARIANCE, POSE)
_TF_TYPES = (TF, "tf/msg/tfMessage")

# How the two cameras of a pair are told apart, the left one first.
_SIDES = (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("camera0", "camera1"))


@dataclass(frozen=True)
class StereoTopics:
    """Topics of a stereo pair.

    Attributes:
        left_image: image of the left camera.
        right_image: image of the right camera.
        left_info: its camera info.
        right_info: its camera info.
        is_rectified: True where the images' name says so.
    """

    left_image: str
    right_image: str
    left_info: str
    right_info: str
    is_rectified: bool

    @property
    def names(self) -> tuple[str, ...]:
        """All topics."""
        return self.left_image, self.right_image, self.left_info, self.right_info


@dataclass(frozen=True)
class DepthTopics:
    """Topics of a depth camera.

    Attributes:
        depth: depth image.
        info: its camera info.
        color: color image of the same pixels, None where there is none.
    """

    depth: str
    info: str
    color: str | None

    @property
    def names(self) -> tuple[str, ...]:
        """All topics."""
        return (self.depth, self.info) + ((self.color,) if self.color else ())


def find_stereo_topics(
    topics: Topics,
    given: Mapping[str, str] | None = None,
    why_not: Callable[[StereoTopics], str] = lambda _: "",
) -> StereoTopics:
    """Find the images and camera infos of a stereo pair.

    Of several pairs, a rectified one goes first, then a raw one with the shortest name.

    Args:
        topics: type by name.
        given: topics that the user names, under ``left_image``, ``right_image``, ``left_info``
            and ``right_info``.
        why_not: why a pair that nobody names cannot be used; empty where it can.

    Raises:
        BagError: there is no pair, or none that can be used; says what was looked for.
    """
    named = {key: value for key, value in (given or {}).items() if value}
    check_present(topics, named.values())
    left, right = named.get("left_image"), named.get("right_image")
    if left is None or right is None:
        pairs = sorted(_pairs(topics), key=lambda pair: _preference(pair[0]))
        pairs = [p for p in pairs if left in (None, p[0]) and right in (None, p[1])]
        if not pairs:
            raise BagError(f"no stereo pair {_among(topics)}")
        return _first_usable(pairs, lambda pair: _stereo(topics, pair, named), why_not)
    return _stereo(topics, (left, right), named)


def _stereo(topics: Topics, pair: tuple[str, str], named: Mapping[str, str]) -> StereoTopics:
    left, right = pair
    return StereoTopics(
        left,
        right,
        named.get("left_info") or find_camera_info(topics, left),
        named.get("right_info") or find_camera_info(topics, right),
        is_rectified="rect" in _image_name(left),
    )


def _first_usable(
    candidates: Sequence[Candidate],
    complete: Callable[[Candidate], Found],
    why_not: Callable[[Found], str],
) -> Found:
    """The first that has all its topics and can be used, else an error that says why none can."""
    problems = []
    for candidate in candidates:
        try:
            found = complete(candidate)
        except BagError as error:
            problems.append(str(error))
            continue
        problem = why_not(found)
        if not problem:
            return found
        problems.append(problem)
    raise BagError("; ".join(dict.fromkeys(problems)))


def find_depth_topics(
    topics: Topics,
    given: Mapping[str, str] | None = None,
    why_not: Callable[[DepthTopics], str] = lambda _: "",
) -> DepthTopics:
    """Find a depth image, its camera info, and colors for it.

    A depth image that is aligned to the color image goes first; colors are used only when they
    are, or when a topic is given.

    Args:
        topics: type by name.
        given: topics that the user names, under ``depth``, ``info`` and ``color``.
        why_not: why a camera that nobody names cannot be used; empty where it can.

    Raises:
        BagError: there is no depth image, or none that can be used; says why.
    """
    named = {key: value for key, value in (given or {}).items() if value}
    check_present(topics, named.values())
    if "depth" in named:
        return _depth(topics, named["depth"], named)
    images = sorted(_depth_images(topics), key=_preference)
    if not images:
        listed = _listed(name for name, kind in topics.items() if kind in _IMAGE_TYPES)
        raise BagError(f"no depth camera ('depth' in its topic) among the images {listed}")
    return _first_usable(images, lambda image: _depth(topics, image, named), why_not)


def _depth(topics: Topics, depth: str, named: Mapping[str, str]) -> DepthTopics:
    info = named.get("info") or find_camera_info(topics, depth)
    return DepthTopics(depth, info, named.get("color") or _color_of(topics, depth))


def find_pose_topic(topics: Topics, given: str | None = None) -> str:
    """Find the topic that tells where the camera or the robot is.

    In this order: ``camera_pose``, ground truth of a camera, any other stamped pose, odometry, tf.

    Raises:
        BagError: there is none.
    """
    if given:
        check_present(topics, [given])
        return given
    found = sorted((_pose_rank(n, t), n) for n, t in topics.items() if _pose_rank(n, t) < 9)
    if not found:
        raise BagError(f"no pose, odometry or tf topic; the bag holds {_described(topics)}")
    return found[0][1]


def find_camera_info(topics: Topics, image: str) -> str:
    """The camera info that belongs to an image: the one in its namespace.

    Raises:
        BagError: there is none.
    """
    namespace = image
    for _ in range(2):  # an image of a transport plugin is one level below its image topic
        namespace = namespace.rsplit("/", 1)[0]
        info = f"{namespace}/camera_info"
        if topics.get(info) == CAMERA_INFO:
            return info
    infos = [name for name in topics if topics[name] == CAMERA_INFO]
    raise BagError(f"no camera info beside {image}; the bag has {_listed(infos)}")


def check_present(topics: Topics, names: Iterable[str]) -> None:
    """Raise `BagError` when a topic that the user names is not there."""
    if missing := [name for name in names if name not in topics]:
        raise BagError(f"no topic {', '.join(missing)} among {_listed(topics)}")


def _among(topics: Topics) -> str:
    """Among which images something was looked for; what else there is where there are none."""
    images = [name for name, kind in topics.items() if kind in _IMAGE_TYPES]
    if not images:
        return f"in the bag, which has no image topics; it holds {_described(topics)}"
    return f"(image topics that differ by left and right) among the images {_listed(images)}"


def _described(topics: Topics) -> str:
    """Topics with their types, as a person looks for them."""
    return _listed(f"{name} ({kind.rpartition('/')[2]})" for name, kind in topics.items())


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _image_name(topic: str) -> str:
    parts = topic.split("/")
    return parts[-2] if parts[-1] in ("compressed", "compressedDepth") else parts[-1]


def _preference(topic: str) -> tuple[bool, bool, bool, int, str]:
    """Order of image topics: aligned and rectified first, uncompressed, short names."""
    is_packed = topic.endswith(("compressed", "compressedDepth"))
    return ("aligned" not in topic, "rect" not in topic, is_packed, len(topic), topic)


def _pairs(topics: Topics) -> Iterable[tuple[str, str]]:
    for name, type_name in topics.items():
        if type_name not in _IMAGE_TYPES or "depth" in name:
            continue
        for left, right in _SIDES:
            other = re.sub(rf"(?<![a-z0-9]){left}(?![a-z0-9])", right, name)
            if other != name and topics.get(other) == type_name:
                yield name, other


def _depth_images(topics: Topics) -> list[str]:
    return [
        name
        for name, type_name in topics.items()
        if type_name in _IMAGE_TYPES and "depth" in name and not name.endswith("/theora")
    ]


def _color_of(topics: Topics, depth: str) -> str | None:
    colors = [
        name
        for name, type_name in topics.items()
        if type_name in _IMAGE_TYPES and re.search(r"(rgb|color)", name) and "depth" not in name
    ]
    is_registered = "aligned" in depth or "registered" in depth or "rect" in depth
    return min(colors, key=_preference) if colors and is_registered else None


def _pose_rank(name: str, type_name: str) -> int:
    last = name.rsplit("/", 1)[-1]
    if type_name in _POSE_TYPES:
        if last == "camera_pose":
            return 0 if "ground_truth" not in name else 1
        if "camera" in name and "truth" in name.replace("_", ""):
            return 2
        return 3 if "truth" in name.replace("_", "") else 4
    if type_name == ODOMETRY:
        return 5 if "truth" in name else 6
    return 7 if type_name in _TF_TYPES and last == "tf" else 9
