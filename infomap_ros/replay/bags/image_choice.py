"""Which images of a bag are used: a stereo pair or a depth camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from infomap_ros.errors import BagError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.pipeline.perception import ImageSources, Perception
from infomap_ros.pipeline.range_estimator import RangeEstimator
from infomap_ros.pipeline.view_estimator import ViewEstimator
from infomap_ros.replay.bags.topics import Topics, find_depth_topics, find_stereo_topics


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
    types: Topics,
    config: ImageInputConfig,
    given: Mapping[str, str],
    make_estimator: Callable[[str, bool], RangeEstimator | ViewEstimator],
    *,
    color: bool = False,
) -> Perception:
    """Find the images and who measures them.

    Args:
        types: topics of the bag with their types.
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
            sources, raw = _sources(kind, types, config, given_of(given, kind), color)
        except BagError as error:
            failures.append(str(error))
            continue
        return Perception(sources, make_estimator(kind, raw), config.pairing_tolerance)
    raise BagError("; ".join(failures))


def _sources(
    kind: str, types: Topics, config: ImageInputConfig, given: Mapping[str, str], color: bool
) -> tuple[ImageSources, bool]:
    """Topics of a kind of images, and whether they are raw."""
    if kind == "stereo":
        pair = find_stereo_topics(types, given)
        raw = {"auto": not pair.is_rectified, "yes": True, "no": False}[config.rectify]
        infos = pair.left_info, pair.right_info
        return ImageSources((pair.left_image, pair.right_image), infos), raw
    found = find_depth_topics(types, given)
    colors = (found.color,) if color and found.color else ()
    return ImageSources((found.depth, *colors), (found.info,)), False


def given_of(topics: Mapping[str, str], task: str) -> dict[str, str]:
    """Of the topics that the user names, those of a stereo pair or of a depth camera."""
    names = {
        "stereo": ("left_image", "right_image", "left_info", "right_info"),
        "depth": ("depth", "info", "color"),
    }[task]
    return {name: topics[name] for name in names if topics.get(name)}
