"""Of four robots one lies in every way; the other three map as they would without it."""

from __future__ import annotations

from infomap_ros.studies.team.hostile_member import run

SECONDS = 3.0


def test_the_others_map_what_they_would_map_without_a_liar() -> None:
    quiet, hostile = (run(SECONDS, lies, voxel_size=0.2, bandwidth=0.3) for lies in (False, True))

    assert min(hostile.told[lie] for lie in ("fill", "digest", "summary", "hand_on", "ask")) > 2
    assert len({tuple(held) for held in hostile.hashes}) == 1
    assert hostile.hashes == quiet.hashes
    assert 0 not in hostile.hashes[0]
    assert 0 < hostile.memory <= 0.06e9
    assert hostile.end < quiet.end + 3.0
