"""Mutated and odd messages are refused or cost little, and leave the robot what it was."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parent.parent.parent / "benchmarks"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_no_mutated_message_ends_the_process_or_changes_the_map() -> None:
    fuzz_team = script("fuzz_team")

    plain = fuzz_team.fuzz(1000, 5, None)
    signed = fuzz_team.fuzz(1000, 6, fuzz_team.KEY)

    assert plain.total() == signed.total() == 1000
    assert plain["REFUSED AND CHANGED THE MAP"] == signed["REFUSED AND CHANGED THE MAP"] == 0
    assert signed["taken for genuine"] == 0
    assert sum(plain[r] for r in plain if r.startswith("refused")) > 500


@pytest.mark.parametrize(("kind", "rounds"), [("Victim", 25), ("Board", 60)])
def test_odd_messages_cost_no_more_than_their_bytes_allow(kind: str, rounds: int) -> None:
    content = script("fuzz_team_content")
    victim = getattr(content, kind)()

    content.endure_rounds(victim, 7, rounds)

    received = sum(n for name, n in victim.results.items() if name.endswith("received"))
    assert 0 < received < victim.results.total()
