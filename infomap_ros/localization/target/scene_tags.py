"""Tags that stand anywhere in the scene: landmarks that are never taken for others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.target.tag_board import FAMILIES, TagBoard, TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagFinder, Tags
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector


@dataclass(frozen=True)
class SceneTagsConfig:
    """Tags of the scene beside those of the target.

    Raises:
        ConfigError: a value is out of its range.
    """

    family: str = setting(
        "none", "Family of the scene's tags that serve as landmarks.", choices=("none", *FAMILIES)
    )
    side: float = setting(0.16, "Edge of their black squares.", unit="m", low=0.005, high=5.0)

    def __post_init__(self) -> None:
        check_config(self)


class SceneTags:
    """Finds tags of the scene; corner k of the tag i is the landmark ``-(4 i + k + 1)``.

    Args:
        config: which tags.
        target: in the map, whose tags of the same family are landmarks at places that are given;
            None where there is none.
    """

    def __init__(self, config: SceneTagsConfig, target: TagBoard | None = None) -> None:
        self._config = config
        is_used = config.family != "none"
        self._finder = TagFinder(config.family) if is_used else None
        own = target is not None and target.config.family == config.family
        self._target = target if own else None
        none = Tags(np.zeros(0, np.int64), np.zeros((0, 4, 2)), np.zeros((0, 4, 2, 2)))
        self._last = -(2**62), none  # stamp of the view that they are from

    def observe(self, view: RangeView) -> FiducialObservations:
        """The corners of the tags in a view; without ranges, which edges of things spoil."""
        tags = self._find(view)
        ids = _corner_ids(tags.ids)
        sigmas = np.sqrt(np.linalg.eigvalsh(tags.covariances)[:, :, 1]).ravel()
        unknown = np.full(len(ids), np.nan)
        return FiducialObservations(ids, tags.corners.reshape(-1, 2), sigmas, unknown, unknown)

    def unknown(
        self, view: RangeView, known: NDArray[np.int64]
    ) -> Iterator[tuple[NDArray[np.int64], FloatArray, FloatArray, bool]]:
        """Where tags of a view are of which no corner is known, as size and range tell it.

        Args:
            view: in which they are.
            known: ids of known corners, shape (N,).

        Yields:
            Of each the ids of its corners, shape (4,), the corners in the camera frame, shape
            (4, 3) [m], their covariance, shape (12, 12) [m^2], and False. Of tags of the target the
            corners in the map, which have no error, and True.
        """
        tags = self._find(view)
        for one in tags.ids.tolist():
            ids = _corner_ids(np.array([one]))
            if np.isin(ids, known).any():
                continue
            if self._target is not None and one in self._target.ids:
                corners = self._target.corners[self._target.ids.index(one)]
                yield ids, corners, np.zeros((12, 12)), True
                continue
            family, side = self._config.family, self._config.side
            board = TagBoardConfig(family, side, 1, 1, first_id=one, mounting="flat")
            detector = TagTargetDetector(TagTargetConfig(board))
            placed = detector.place(tags.select(tags.ids == one), view)
            if placed is not None:
                yield ids, *placed, False

    def _find(self, view: RangeView) -> Tags:
        if self._finder is not None and self._last[0] != view.stamp:
            self._last = view.stamp, self._finder.look(view)
        return self._last[1]


def _corner_ids(tags: NDArray[np.int64]) -> NDArray[np.int64]:
    return -(4 * tags[:, None] + np.arange(1, 5)).ravel()
