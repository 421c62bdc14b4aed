"""Of four robots one lies in every way; the other three map as they would without it."""

from __future__ import annotations

from infomap_ros.studies.team.hostile_member import run_with_liar

SECONDS = 120.0
LIMIT = 0.02  # [GB]; the liar fills it


def test_the_others_map_what_they_would_map_without_a_liar() -> None:
    quiet, hostile = (
        run_with_liar(SECONDS, lies, period=12.0, voxel_size=0.2, bandwidth=0.3, memory_limit=LIMIT)
        for lies in (0.0, 0.05)
    )

    kinds = ("fill", "digest", "summary", "hand_on", "ask", "repeat")
    assert min(hostile.sent[lie] for lie in kinds) > 10
    assert hostile.refused["CapacityError"] > 0, "and the memory is full"
    assert len(set(hostile.hashes)) == 1
    assert hostile.hashes == quiet.hashes
    assert 0 not in hostile.hashes[0]
    assert 0 < hostile.memory <= 1e9 * LIMIT
    assert hostile.end < quiet.end + 3.0
