"""How the baselines stand to each other: ways to growing shares of a world, paired by world.

Their authors publish seconds of rotorcraft in buildings, which a sensor in a plane does not have;
what they say of each other can be compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import Band, band, ratio_band
from infomap_ros.studies.common.tables import markdown
from infomap_ros.studies.planar.measures import distance_to
from infomap_ros.studies.planar.planar_study import BASELINES
from infomap_ros.studies.planar.tasks import Record, label_of

_SHARES = (0.25, 0.5, 0.75)  # of a world, before the last
_LEAST_WORLDS = 3  # that a band is told for


def relations(records: Sequence[Record], share: float) -> str:
    """Ways of each baseline over those of each other one, as a Markdown table.

    Args:
        records: of worlds that all strategies have explored.
        share: of a world to which ways are compared last.

    Returns:
        Geometric means over the worlds in which both came so far; "" where there are no baselines.
    """
    present = {record.task.label for record in records}
    labels = [label for label in map(label_of, BASELINES) if label in present]
    kinds = ("all", *dict.fromkeys(record.task.world.kind for record in records))
    shares = (*_SHARES, share)
    names = ["way of", "over that of", "worlds", *(f"to {100 * s:g} %" for s in shares)]
    lines = [
        [other, first, kind, *(_text(way_ratio(records, other, first, s, kind)) for s in shares)]
        for first, other in combinations(labels, 2)
        for kind in kinds
    ]
    note = "Geometric mean and band over the worlds, whose number follows, where both came so far."
    return f"{markdown(names, lines)}\n{note}\n" if lines else ""


def way_ratio(
    records: Sequence[Record], own: str, other: str, share: float, kind: str = "all"
) -> Band:
    """Way of one strategy to a share of the world over that of another.

    Args:
        records: of both, in the same order of worlds.
        own: label.
        other: label.
        share: of a world.
        kind: of worlds, or "all".

    Returns:
        The geometric mean over the worlds in which both came so far, and not by the first view.
    """
    mine, theirs = (_ways(records, label, share, kind) for label in (own, other))
    both = np.isfinite(mine) & np.isfinite(theirs) & (mine > 0.0) & (theirs > 0.0)
    return ratio_band(mine[both], theirs[both]) if both.any() else band(np.empty(0))


def _ways(records: Sequence[Record], label: str, share: float, kind: str) -> FloatArray:
    results = [
        record.result
        for record in records
        if record.task.label == label and kind in ("all", record.task.world.kind)
    ]
    return np.array([distance_to(r.distance, r.fraction, share) for r in results])


def _text(found: Band) -> str:
    text = found.text(1.0, 2) if found.count >= _LEAST_WORLDS else f"{found.mean:.2f}"
    return f"{text} ({found.count})"
