"""What robots tell each other of the map: the wire format of map updates, and their merge."""

from infomap_ros.mapping import NOT_OBSERVED
from infomap_ros.team.config import Budget, TeamConfig
from infomap_ros.team.contribution import Contribution
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import draw_session
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.versions import is_newer, next_version, version_at
from infomap_ros.team.wire import (
    MAX_MESSAGE_BYTES,
    OCCUPANCY_ROW,
    SURFACE_ROW,
    decode_update,
    encode_update,
)

__all__ = [
    "MAX_MESSAGE_BYTES",
    "NOT_OBSERVED",
    "OCCUPANCY_ROW",
    "SURFACE_ROW",
    "Budget",
    "Contribution",
    "MapReplica",
    "MapUpdate",
    "TeamConfig",
    "TeamMember",
    "decode_update",
    "draw_session",
    "encode_update",
    "is_newer",
    "next_version",
    "version_at",
]
