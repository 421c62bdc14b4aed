"""Some hundred files and messages of `benchmarks/fuzz_formats.py`: no crash, no bomb."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).resolve().parent.parent.parent / "benchmarks" / "fuzz_formats.py"


@pytest.fixture(scope="module")
def fuzzer() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_formats", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


KINDS = ["map", "localization", "octree", "bag", "description", "mission", "robot"]


@pytest.mark.parametrize("kind", KINDS)
def test_odd_files_are_read_or_refused(fuzzer: ModuleType, kind: str) -> None:
    assert list(fuzzer.FILES) == KINDS
    fuzzer.check_file(kind, 20 if kind == "bag" else 50)


def test_odd_messages_are_read_or_refused(fuzzer: ModuleType) -> None:
    fuzzer.check_messages(100)
