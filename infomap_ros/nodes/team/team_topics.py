"""The topics on which the robots of a team hear each other, and how they become common to all."""

from __future__ import annotations

UPDATES = "team/map_updates"
DIGESTS = "team/digests"
REQUESTS = "team/requests"
AGENTS = "team/agents"

SHARED = {topic: f"/{topic}" for topic in (UPDATES, DIGESTS, REQUESTS, AGENTS)}
"""Remaps that take the topics of a robot out of its namespace."""

OWN_FRAMES = {"/tf": "tf", "/tf_static": "tf_static"}
"""Remaps that give each robot a tree of frames in its namespace, as those of Nav2 do: robots whose
frames have the same names do not meet on one topic. Without namespace they change nothing."""
