"""Which images of a bag are used: a stereo pair or a depth camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from infomap_ros.errors import BagError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.replay.bags.topics import Topics, find_depth_topics, find_stereo_topics
from infomap_ros.replay.measuring.range_sources import DepthSource, Meter, RangeSource, StereoSource

Result = TypeVar("Result")


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


def find_source(
    types: Topics,
    config: ImageInputConfig,
    given: Mapping[str, str],
    make_meter: Callable[[str, bool], Meter[Result]],
    *,
    color: bool = False,
) -> RangeSource[Result]:
    """Find the images and who measures them.

    Args:
        types: topics of the bag with their types.
        config: which images are wanted.
        given: topics that the user names, under ``left_image``, ``right_image``, ``left_info``,
            ``right_info``, ``depth``, ``info``, ``color``.
        make_meter: called with ``stereo`` or ``depth`` and whether the images are raw.
        color: whether a depth image waits for its colour image.

    Raises:
        BagError: there is no stereo pair and no depth camera, or not the one that is wanted.
    """
    wanted = config.source
    if wanted == "auto" and given.get("depth"):
        wanted = "depth"
    failures = []
    if wanted in ("auto", "stereo"):
        try:
            topics = find_stereo_topics(types, given_of(given, "stereo"))
        except BagError as error:
            failures.append(str(error))
        else:
            raw = {"auto": not topics.is_rectified, "yes": True, "no": False}[config.rectify]
            return StereoSource(topics, make_meter("stereo", raw), config.pairing_tolerance)
    if wanted in ("auto", "depth"):
        try:
            found = find_depth_topics(types, given_of(given, "depth"))
        except BagError as error:
            failures.append(str(error))
        else:
            found = found if color else replace(found, color=None)
            return DepthSource(found, make_meter("depth", False), config.pairing_tolerance)
    raise BagError("; ".join(failures))


def given_of(topics: Mapping[str, str], task: str) -> dict[str, str]:
    """Of the topics that the user names, those of a stereo pair or of a depth camera."""
    names = {
        "stereo": ("left_image", "right_image", "left_info", "right_info"),
        "depth": ("depth", "info", "color"),
    }[task]
    return {name: topics[name] for name in names if topics.get(name)}
