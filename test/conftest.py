"""Fixtures shared by all tests."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as nodes and commands do: its threads spin

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


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A real browser that draws without a graphics card: a small window, as that is slow."""
    place = REPOSITORY / "test" / "exploration" / "browser.py"
    spec = importlib.util.spec_from_file_location("a_browser", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.find_browser() is not None, module.MISSING
    profile = tmp_path_factory.mktemp("browser") / "profile"
    with module.Browser(profile, module.SOFTWARE_WEBGL, (560, 360)) as browser:
        yield browser


@pytest.fixture
def package_copy(tmp_path: Path) -> Path:
    """A copy of what an installation is made from, outside the repository."""
    copy = tmp_path / "src" / "infomap_ros"
    leave_out = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    for folder in ("infomap_ros", "resource", "config", "launch", "bags"):
        shutil.copytree(REPOSITORY / folder, copy / folder, ignore=leave_out)
    for name in ("package.xml", "setup.py", "setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, copy / name)
    return copy
