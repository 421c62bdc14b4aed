"""How candidates for the next view are drawn: the parameters."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, setting


@dataclass(frozen=True)
class CandidateConfig:
    """Configuration of the candidates.

    Raises:
        ConfigError: a value is out of its range.
    """

    candidates: int = setting(
        1000, "Number of candidate views that pass the cheap tests.", low=1, high=1_000_000
    )
    local_share: float = setting(
        0.3,
        "Share of the positions that is drawn near the present one; the rest is drawn uniformly "
        "from the known free space.",
        low=0.0,
        high=1.0,
    )
    local_radius: float = setting(
        1.0, "What counts as near the present position.", unit="m", low=0.01, high=100.0
    )
    periphery_share: float = setting(
        0.0,
        "Share of the positions that is drawn within the camera's range of the periphery of the "
        "known and of uncertain voxels, all of these alike: where little is left to see, few of "
        "the positions that are drawn uniformly see it.",
        low=0.0,
        high=1.0,
    )
    periphery_distance: float = setting(
        0.75,
        "Farthest distance to the periphery of the known or an obstacle, as a share of the "
        "camera's range.",
        low=0.01,
        high=1.0,
    )
    teammate_clearance: float = setting(
        0.6,
        "Smallest distance of the camera to the body of a teammate and to the view that it is "
        "heading for.",
        unit="m",
        low=0.0,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
