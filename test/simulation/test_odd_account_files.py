"""Accounts that nobody here has written are errors of the library, naming the file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from infomap_ros.errors import InfomapError
from infomap_ros.exploration.mission import Mission
from infomap_ros.simulation.body.saved_robot import SavedRobot

ODD = {
    "nested": "[" * 100_000 + "]" * 100_000,
    "infinite": '{"views": 1e999, "distance": 1.0, "seconds": 1.0}',
    "huge": json.dumps({"views": 1, "distance": 10**400, "seconds": 1, "contacts": 10**400}),
    "a list": "[1, 2]",
    "a word": "null",
    "cut": '{"views": 1, "dist',
    "binary": "\x00\x01",
    "empty": "",
}


@pytest.mark.parametrize("kind", [Mission, SavedRobot])
@pytest.mark.parametrize("odd", ODD)
def test_odd_accounts_are_refused_by_name(kind: type, odd: str, tmp_path: Path) -> None:
    path = tmp_path / "account.json"
    path.write_text(ODD[odd], encoding="utf-8")
    with pytest.raises(InfomapError, match=r"account\.json"):
        kind.load(path)


@pytest.mark.parametrize("kind", [Mission, SavedRobot])
def test_an_account_that_is_no_text_is_refused_by_name(kind: type, tmp_path: Path) -> None:
    path = tmp_path / "account.json"
    path.write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(InfomapError, match=r"account\.json"):
        kind.load(path)
