"""What the documentation names is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "infomap_ros"
DOCS = REPOSITORY / "docs"
_FILE = re.compile(r"`((?:\w+/)+\w+\.(?:py|urdf|rviz|xml))`")
_STEP = re.compile(r"\| `(\w+)` \| `([\w/]+\.py)` \|")


def pages() -> list[Path]:
    return [*DOCS.glob("**/*.md"), REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md"]


def defined_in(path: Path) -> set[str]:
    tree = ast.parse(path.read_text("utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_files_that_are_named_exist() -> None:
    missing = [
        f"{page.name}: {name}"
        for page in pages()
        for name in _FILE.findall(page.read_text("utf-8"))
        if not any((folder / name).exists() for folder in (PACKAGE, REPOSITORY))
    ]
    assert missing == []


def test_functions_that_a_pixel_passes_are_where_they_are_said_to_be() -> None:
    steps = _STEP.findall((DOCS / "architecture.md").read_text("utf-8"))
    assert len(steps) == 10
    assert [name for name, file in steps if name not in defined_in(PACKAGE / file)] == []
