"""Mutated messages are refused with the library's errors and leave the map as it was."""

from __future__ import annotations

import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).resolve().parent.parent.parent / "benchmarks" / "fuzz_team.py"


def test_no_mutated_message_ends_the_process_or_changes_the_map() -> None:
    spec = importlib.util.spec_from_file_location("fuzz_team", SCRIPT)
    fuzz_team = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzz_team)

    plain = fuzz_team.fuzz(1000, 5, None)
    signed = fuzz_team.fuzz(1000, 6, fuzz_team.KEY)

    assert plain.total() == signed.total() == 1000
    assert plain["REFUSED AND CHANGED THE MAP"] == signed["REFUSED AND CHANGED THE MAP"] == 0
    assert signed["taken for genuine"] == 0
    assert sum(plain[r] for r in plain if r.startswith("refused")) > 500
