"""The RViz configuration shows what the nodes publish, in a way that reaches it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from infomap_ros.nodes.team import team_topics

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIG = yaml.safe_load((REPOSITORY / "config" / "infomap.rviz").read_text("utf-8"))
DISPLAYS = {
    display["Name"]: display
    for display in CONFIG["Visualization Manager"]["Displays"]
    if "Topic" in display
}
FROM_ELSEWHERE = {"left/image_raw", "interest"}  # of the robot, and of whoever wishes


def published() -> dict[str, str]:
    """Topics that the nodes advertise -> how (latched, stream, ...)."""
    found = {}
    for path in (REPOSITORY / "infomap_ros" / "nodes").rglob("*.py"):
        text = path.read_text("utf-8")
        for said, profile in re.findall(
            r'advertise\(\s*\w+,\s*("[^"]+"|[A-Z]+),\s*qos\.(\w+)', text
        ):
            topic = said.strip('"') if '"' in said else getattr(team_topics, said, said)
            found[topic] = profile
            found[topic.replace("~", "next_best_view")] = profile
    return found


@pytest.mark.parametrize("name", DISPLAYS)
def test_display_shows_a_topic_that_a_node_publishes(name: str) -> None:
    topic: dict[str, Any] = DISPLAYS[name]["Topic"]
    if topic["Value"] in FROM_ELSEWHERE:
        return
    profile = published()[topic["Value"]]
    if topic["Durability Policy"] == "Transient Local":  # asks for more than a stream offers
        assert profile in ("latched", "current")
