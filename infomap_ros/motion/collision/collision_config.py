"""What counts as in the way of an arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting


@dataclass(frozen=True)
class CollisionConfig:
    """How the body is modeled and what counts as in its way.

    Raises:
        ConfigError: a value is out of its range.
    """

    tolerance: float = setting(
        0.015,
        "How far the spheres that cover the body may stick out of its collision shapes.",
        unit="m",
        low=0.001,
        high=0.5,
    )
    margin: float = parameter(
        0.01,
        "Distance that is kept to everything where the pose is known exactly. A motion is checked "
        "in steps in which no point of the body goes farther than twice this, so that all of it is "
        "known to be free.",
        unit="m",
        low=0.0005,
        high=0.5,
    )
    margin_sigmas: float = setting(
        2.0,
        "So many standard deviations of where the robot is are added to the margin against the "
        "map, in squares.",
        low=0.0,
        high=10.0,
    )
    max_margin: float = setting(
        0.03, "The margin against the map grows no further than this.", unit="m", low=0.0, high=1.0
    )
    unknown_is_free: bool = setting(False, "The arm may enter space that was never observed.")
    free_probability: float = setting(
        0.05,
        "The arm may enter voxels that are less likely occupied than this: what is free for the "
        "choice of views, after two looks of the map's default model.",
        low=1e-6,
        high=0.4,
    )
    ground_links: tuple[str, ...] = setting(
        ("*wheel*", "*caster*"),
        "Links (patterns) that stand on the ground: they are not compared with the map, as the "
        "planner of the base answers for where they stand.",
    )
    always_share: ClassVar[float] = 0.5
    """Links whose collision meshes touch in at least this share of random configurations touch by
    design, or their meshes are too coarse to tell, and are not compared.
    """
    alarm_share: ClassVar[float] = 0.3
    """Where the spheres of two links come too near in more than this share of random
    configurations although the links do not touch, their distance is adapted until they mostly do
    not.
    """
    samples: int = setting(500, "Number of random configurations for both.", low=50, high=100000)
    allowed_contacts: tuple[str, ...] = parameter(
        (), "Pairs of links (patterns) that may touch, as 'first:second'."
    )

    def __post_init__(self) -> None:
        check_config(self)
        for pair in self.allowed_contacts:
            if pair.count(":") != 1:
                raise ConfigError("allowed_contacts", pair, "two patterns, as 'first:second'")
