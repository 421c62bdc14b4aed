"""What a localization knows, in a file: the map's frame outlives the process.

The file has the layout of a map file (`infomap_ros.mapping.files.map_file`): checked, and replaced
at once or not at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InfomapError, MapFileError
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.localization.localizer import Localizer
from infomap_ros.mapping.files.map_file import read_map_file, write_map_file

_KIND = "localization"


@dataclass(frozen=True, eq=False)
class SavedLocalization:
    """The state of a localizer, and of the robot at its last view.

    Attributes:
        state: of `Localizer.state`.
        posture: None where odometry was not known.
        origin: of the map, as in `PoseUncertainty`.
        has_keyframes: whether the stamps of the kept poses mean anything.
    """

    state: Mapping[str, NDArray[Any]]
    posture: RobotPosture | None
    origin: int = 0
    has_keyframes: bool = True

    @property
    def stamp(self) -> int:
        """Of the last view [ns]."""
        return int(self.state["stamp"])

    def save(self, path: Path) -> None:
        """Write it to a file, atomically.

        Raises:
            MapFileError: the file cannot be written.
        """
        arrays = {f"localizer.{name}": np.asarray(array) for name, array in self.state.items()}
        arrays["origin"] = np.array(self.origin)
        if self.posture is not None:
            arrays["T_odom_base"] = self.posture.T_odom_base
            arrays["T_base_camera"] = self.posture.T_base_camera
        write_map_file(path, {"kind": _KIND}, arrays)

    @classmethod
    def load(cls, path: Path) -> SavedLocalization:
        """Read what `save` wrote.

        Raises:
            MapFileError: the file is missing, corrupt, or of another kind.
        """
        config, arrays = read_map_file(path)
        if config.get("kind") != _KIND or "origin" not in arrays:
            raise MapFileError(f"{path} holds no localization")
        prefix = "localizer."
        state = {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}
        posture = None
        if "T_odom_base" in arrays and "T_base_camera" in arrays:
            posture = RobotPosture(arrays["T_odom_base"], arrays["T_base_camera"])
        return cls(state, posture, int(arrays["origin"]))

    def without_pose(self) -> SavedLocalization:
        """The same knowledge of the scene; where the camera is has to be found out.

        As for a camera that was carried elsewhere, or a clock that was set back.
        """
        anytime = {"stamp": np.array(-(2**62)), "was_known": np.array(False)}
        state = {**self.state, **anytime}
        return SavedLocalization(state, None, self.origin, has_keyframes=False)

    def resume(self, localizer: Localizer) -> None:
        """Have a localizer go on from here.

        Raises:
            MapFileError: the state is of a localizer with another configuration.
        """
        try:
            localizer.resume(self.state)
            if not self.has_keyframes:
                localizer.forget_keyframes()
        except (InfomapError, KeyError, ValueError, IndexError) as error:
            raise MapFileError(f"the saved localization does not fit: {error}") from error
