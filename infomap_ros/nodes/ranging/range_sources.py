"""What stereo_range and fiducial_localization look with: a pair of cameras, or a depth camera."""

from __future__ import annotations

from infomap_ros.pipeline.perception import ImageSources


def stereo_topics(*, rectify: bool) -> ImageSources:
    """Topics of a pair of cameras; `rectify` if the images are raw."""
    kind = "image_raw" if rectify else "image_rect"
    infos = ("left/camera_info", "right/camera_info")
    return ImageSources((f"left/{kind}", f"right/{kind}"), infos)


def depth_topics(*, color: bool) -> ImageSources:
    """Topics of a depth camera; with `color`, each depth image waits for its color image."""
    images = ("depth/image_rect", "rgb/image_rect") if color else ("depth/image_rect",)
    return ImageSources(images, ("depth/camera_info",))
