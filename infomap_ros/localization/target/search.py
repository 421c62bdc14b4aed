"""Where to look for a target that is not in sight: the directions that no view has covered yet.

The sphere around the robot is a set of directions, evenly spread. Every look covers those within
the camera's field of view. Proposals turn the camera, level, to where it would cover most that is
new for the angle that it must turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import PinholeCamera, check_transform
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.model_scene import directions

# Share of the field of view at each border in which the target would not be found.
_MARGIN = 0.1
_LOOK_COST = 0.5  # of a look beside turning, as an angle [rad]
_DIRECTIONS = 800  # on the sphere
_LEAST_GAIN = 0.02  # share of what is left to see that a look must cover to be proposed


@dataclass(frozen=True)
class TargetSearchConfig:
    """Where a target may be.

    Raises:
        ConfigError: a value is out of its range, or the lowest elevation is above the highest.
    """

    lowest: float = setting(
        -0.8, "Lowest elevation at which the target may be.", unit="rad", low=-1.6, high=1.6
    )
    highest: float = setting(0.5, "Highest elevation.", unit="rad", low=-1.6, high=1.6)

    def __post_init__(self) -> None:
        check_config(self)
        if self.lowest >= self.highest:
            raise ConfigError("lowest", self.lowest, f"less than highest, {self.highest} rad")


class SearchView(NamedTuple):
    """A proposed look.

    Attributes:
        rotation: of the camera's optical frame in the map or odom frame, shape (3, 3).
        new_share: share of all directions in question that it covers as first.
        turn: angle from the view before [rad].
    """

    rotation: FloatArray
    new_share: float
    turn: float


class TargetSearch:
    """Keeps what was looked at from one place, and proposes the next looks.

    Args:
        camera: whose field of view counts.
        config: where the target may be.

    The frame of all rotations is one whose z axis is up, as ``odom``. Begin anew with `clear` when
    the robot has moved so far that it sees other things.
    """

    def __init__(self, camera: PinholeCamera, config: TargetSearchConfig | None = None) -> None:
        self.config = config or TargetSearchConfig()
        self._camera = camera
        sphere = directions(_DIRECTIONS)
        elevation = np.arcsin(np.clip(sphere[:, 2], -1.0, 1.0))
        within = (elevation >= self.config.lowest) & (elevation <= self.config.highest)
        self._directions = sphere[within]
        self._looks = np.stack([_level_look(one) for one in self._directions])
        self._seen = np.zeros(len(self._directions), bool)
        self._covers = np.stack([self._covered(look) for look in self._looks])

    @property
    def seen_share(self) -> float:
        """Share of the directions in question that were looked at."""
        return float(self._seen.mean())

    def clear(self) -> None:
        """Forget all looks."""
        self._seen[:] = False

    def look(self, T_odom_camera: FloatArray) -> None:
        """Note a view in which the target was not found.

        Args:
            T_odom_camera: pose of the camera's optical frame, shape (4, 4).

        Raises:
            InvalidInputError: it is not a pose.
        """
        self._seen |= self._covered(check_transform(T_odom_camera)[:3, :3])

    def proposals(
        self,
        T_odom_camera: FloatArray,
        count: int = 12,
        is_possible: Callable[[FloatArray], bool] | None = None,
    ) -> list[SearchView]:
        """The next looks, in the order in which to take them.

        Args:
            T_odom_camera: the view now, shape (4, 4).
            count: at most so many.
            is_possible: whether the camera can be turned so, asked of rotations, shape (3, 3).

        Returns:
            Looks that together cover what is left, or what can be reached of it; none when all
            was seen.

        Raises:
            InvalidInputError: the view is not a pose.
        """
        now = check_transform(T_odom_camera)[:3, :3]
        seen = self._seen.copy()
        allowed = np.ones(len(self._looks), bool)
        proposed: list[SearchView] = []
        while len(proposed) < count:
            gains = (self._covers & ~seen).mean(axis=1)
            turns = _angles(now, self._looks)
            worth = np.where(allowed, gains / (turns + _LOOK_COST), -1.0)
            best = int(np.argmax(worth))
            if not allowed[best] or gains[best] <= _LEAST_GAIN * (1.0 - seen.mean()):
                break
            allowed[best] = False
            if is_possible is None or is_possible(self._looks[best]):
                now = self._looks[best]
                seen |= self._covers[best]
                proposed.append(SearchView(now, float(gains[best]), float(turns[best])))
        return proposed

    def _covered(self, rotation: FloatArray) -> NDArray[np.bool_]:
        """Directions that a camera turned so would see well inside its image."""
        camera = self._camera
        pixels = camera.project(self._directions @ rotation)
        border = _MARGIN * np.array([camera.width, camera.height])
        high = np.array([camera.width, camera.height]) - 1.0 - border
        with np.errstate(invalid="ignore"):
            return np.asarray(((pixels >= border) & (pixels <= high)).all(axis=1))


def _level_look(direction: FloatArray) -> FloatArray:
    """Optical frame that looks along a direction with its x axis level, shape (3, 3)."""
    across = np.cross(direction, [0.0, 0.0, 1.0])
    if np.linalg.norm(across) < 1e-6:
        across = np.array([0.0, -1.0, 0.0])
    across = across / np.linalg.norm(across)
    return np.column_stack([across, np.cross(direction, across), direction])


def _angles(rotation: FloatArray, others: FloatArray) -> FloatArray:
    """Angle between one rotation and others, shape (N,) [rad]."""
    return np.asarray(Rotation.from_matrix(rotation.T @ others).magnitude())
