"""One configuration that names the target, for the command line, the node and the simulator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetDetector, TargetRefusal, TargetSighting

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView


@dataclass(frozen=True)
class ModelTargetConfig:
    """A CAD model as target.

    Raises:
        ConfigError: a value is out of its range.
    """

    file: str = parameter("", "Mesh of the target: .obj, .stl, .ply, .dae and others.")
    scale: float = parameter(1.0, "Meters per unit of the mesh.", unit="m", low=1e-6, high=1000.0)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class TargetConfig:
    """What the target is.

    Raises:
        ConfigError: a value is out of range.
    """

    kind: str = parameter(
        "none",
        "What the target is: none, a board of tags, or a CAD model.",
        choices=("none", "tags", "model"),
    )
    pose_in_map: tuple[float, ...] = parameter(
        (),
        "Where the target is in the map: x, y, z [m] and rotation vector [rad]. Without it the "
        "target's frame is the map.",
    )
    tags: TagTargetConfig = field(default_factory=TagTargetConfig)
    model: ModelTargetConfig = field(default_factory=ModelTargetConfig)

    def __post_init__(self) -> None:
        check_config(self)
        if len(self.pose_in_map) not in {0, 6}:
            raise ConfigError("pose_in_map", self.pose_in_map, "six numbers or none")

    @property
    def T_map_target(self) -> FloatArray:
        """Where the target's own frame is in the map, shape (4, 4)."""
        if not self.pose_in_map:
            return np.eye(4)
        numbers = np.asarray(self.pose_in_map, dtype=np.float64)
        return make_transform(Rotation.from_rotvec(numbers[3:]).as_matrix(), numbers[:3])


class PlacedTarget:
    """A target whose own frame is not the map: a detector of the map's frame.

    Args:
        detector: finds the target.
        T_map_target: where it is in the map, shape (4, 4).

    Attributes:
        board: where the tags are in the map, if the target is a board.
    """

    def __init__(self, detector: TargetDetector, T_map_target: FloatArray) -> None:
        board: TagBoard | None = getattr(detector, "board", None)
        self._detector, self.board = detector, board and board.in_frame(T_map_target)
        self._T_target_map = invert_transform(T_map_target)

    def detect(self, view: RangeView) -> TargetSighting | TargetRefusal:
        """Find the target; the sighting tells ``T_camera_map``."""
        result = self._detector.detect(view)
        if isinstance(result, TargetRefusal):
            return result
        return result.of_frame(self._T_target_map)


def make_detector(config: TargetConfig) -> TargetDetector | None:
    """The detector of the target; None where there is no target.

    Args:
        config: what the target is.

    Returns:
        A detector whose sightings tell the pose of the map's frame.

    Raises:
        ConfigError: the target is a model, and no file is named.
        InvalidInputError: the model's file cannot be read.
    """
    if config.kind == "none":
        return None
    detector: TargetDetector
    if config.kind == "tags":
        detector = TagTargetDetector(config.tags)
    else:
        # Who has no such target does not load what finds it.
        from infomap_ros.localization.target.model_target import ModelTargetDetector

        detector = ModelTargetDetector(config.model)
    return PlacedTarget(detector, config.T_map_target) if config.pose_in_map else detector
