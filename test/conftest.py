"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded random generator."""
    return np.random.default_rng(20050401)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with the recorded real data; skips the test where it is absent."""
    folder = Path(os.environ.get("INFOMAP_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real data absent: no folder {folder} (set INFOMAP_DATA)")
    return folder
