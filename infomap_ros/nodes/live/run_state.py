"""What is known of a live run, from the diagnostics of its nodes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus


@dataclass
class RunState:
    """What is known of a run so far.

    Attributes:
        figures: last diagnostic values of each node by node name, after the namespace if any.
        complaints: last diagnostic message of each node that was not ``ok``.
        updates: arrival of the last map update of each stamp [s, monotonic] by stamp [ns].
        images: arrival of each left image, likewise.
        last_progress: when a node last had more results than before [s, monotonic].
    """

    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    complaints: dict[str, str] = field(default_factory=dict)
    updates: dict[int, float] = field(default_factory=dict)
    images: dict[int, float] = field(default_factory=dict)
    last_progress: float = field(default_factory=time.monotonic)

    def count(self, node: str, figure: str = "results") -> int:
        """A whole-number figure of a node, 0 while unknown."""
        return int(self.figures.get(node, {}).get(figure, "0"))

    def drops(self) -> dict[str, int]:
        """Drops of all nodes, ``node: reason`` -> count."""
        return {
            f"{node}: {name.removeprefix('dropped: ')}": int(value)
            for node, values in self.figures.items()
            for name, value in values.items()
            if name.startswith("dropped: ")
        }

    def add(self, status: DiagnosticStatus) -> None:
        """Take what a node says of itself."""
        node = status.hardware_id.strip("/")
        before = self.count(node)
        self.figures[node] = {pair.key: pair.value for pair in status.values}
        if self.count(node) > before:
            self.last_progress = time.monotonic()
        if status.message != "ok":
            self.complaints[node] = status.message
