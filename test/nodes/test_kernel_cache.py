"""Compiled kernels find a writable cache, also from a read-only installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import infomap_ros

PROGRAM = """
import os, infomap_ros
print(os.environ["NUMBA_CACHE_DIR"])
"""


def cache_of(installed: Path, readable_only: bool, **variables: str) -> Path:
    """Import the package from a copy, which looks read-only if asked, and ask for the cache."""
    program = PROGRAM
    if readable_only:  # a superuser may write everywhere, so the answer of access(2) is replaced
        program = f"""
import os
real = os.access
os.access = lambda path, mode: not str(path).startswith({str(installed)!r}) and real(path, mode)
{PROGRAM}"""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(installed), **variables}
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=environment, cwd=installed, text=True, capture_output=True, check=True
    )
    return Path(done.stdout.strip())


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    source = Path(infomap_ros.__file__).parent
    target = tmp_path / "site" / "infomap_ros"
    target.mkdir(parents=True)
    for name in ("__init__.py", "_kernel_cache.py"):
        shutil.copy(source / name, target)
    (target / "mapping").mkdir()
    return tmp_path / "site"


def test_a_writable_installation_caches_beside_the_code(installed: Path) -> None:
    cache = cache_of(installed, False)

    assert cache.parent == installed / "infomap_ros" / "__pycache__"
    assert cache.name.startswith("kernels-")


def test_a_read_only_installation_caches_in_the_home_of_the_user(
    installed: Path, tmp_path: Path
) -> None:
    cache = cache_of(installed, True, XDG_CACHE_HOME=str(tmp_path / "cache"))

    assert cache.parent == tmp_path / "cache" / "infomap_ros"


def test_without_a_writable_home_the_cache_is_temporary(installed: Path, tmp_path: Path) -> None:
    nowhere = installed / "cache"

    cache = cache_of(installed, True, XDG_CACHE_HOME=str(nowhere), TMPDIR=str(tmp_path))

    assert cache.parent == tmp_path / f"infomap_ros-{os.getuid()}"


@pytest.mark.parametrize(
    "decorator", ["numba import njit", "infomap_ros.geometry.kernel import kernel"]
)
def test_a_change_beside_a_kernel_gets_a_cache_of_its_own(installed: Path, decorator: str) -> None:
    room = installed / "infomap_ros" / "mapping"
    (room / "kernels.py").write_text(f"from {decorator}\n")
    (room / "called.py").write_text("A = 1\n")
    before = cache_of(installed, False)

    (room / "called.py").write_text("A = 1234\n")

    assert cache_of(installed, False) != before


def test_a_change_where_nothing_is_compiled_keeps_the_cache(installed: Path) -> None:
    plain = installed / "infomap_ros" / "mapping" / "plain.py"
    plain.write_text("A = 1\n")
    before = cache_of(installed, False)

    plain.write_text("A = 1234\n")

    assert cache_of(installed, False) == before


def test_the_choice_of_the_user_wins(installed: Path, tmp_path: Path) -> None:
    assert cache_of(installed, True, NUMBA_CACHE_DIR=str(tmp_path)) == tmp_path
