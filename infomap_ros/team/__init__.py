"""What robots tell each other of the map: the wire format of map updates."""

from infomap_ros.team.wire import (
    MAX_MESSAGE_BYTES,
    OCCUPANCY_ROW,
    SURFACE_ROW,
    MapUpdate,
    decode_update,
    encode_update,
)

__all__ = [
    "MAX_MESSAGE_BYTES",
    "OCCUPANCY_ROW",
    "SURFACE_ROW",
    "MapUpdate",
    "decode_update",
    "encode_update",
]
