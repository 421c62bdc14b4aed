"""Names use the words of the glossary, and none that it has retired."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from infomap_ros.cli.command_options import all_settings
from infomap_ros.nodes.parameter_docs import NODES, node_parameters
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("infomap_ros", "launch", "benchmarks")


def retired() -> dict[str, str]:
    """Words of the glossary's table by what to say instead."""
    _, table = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").split("| not | but |")
    rows = re.findall(r"^\| ([a-z, ]+) \| (.+) \|$", table, flags=re.MULTILINE)
    return {word: instead for words, instead in rows for word in words.split(", ")}


# Retired for every name, also those that are private or local to a function, but for the methods
# of Python's own objects.
EVERYWHERE = {"tell", "tells", "told", "hear", "hears", "heard", "news"}
OF_PYTHON = {"tell"}


def words_of(name: str) -> set[str]:
    """``SavedLocalization`` -> {saved, localization}."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def public_names(source: Path) -> Iterator[str]:
    """Modules, classes, functions, their arguments, fields and constants of a file."""
    yield from (part for part in source.relative_to(ROOT).with_suffix("").parts)
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        if isinstance(node, ast.arg):
            yield node.arg
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def every_name(source: Path) -> Iterator[str]:
    """Those of `public_names`, variables and attributes, private ones too; imported modules."""
    yield from public_names(source)
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name):
            yield node.id
        if isinstance(node, ast.keyword) and node.arg:
            yield node.arg
        if isinstance(node, ast.Attribute) and node.attr not in OF_PYTHON:
            yield node.attr


def test_the_table_is_read() -> None:
    assert retired()["colours"] == "color, colors"
    assert len(retired()) > 30
    assert words_of("SavedLocalization.colour_of") == {"saved", "localization", "colour", "of"}


def test_no_public_name_has_a_retired_word() -> None:
    words, found = retired(), []
    for part in PARTS:
        for source in sorted((ROOT / part).rglob("*.py")):
            for name in set(public_names(source)):
                if not name.startswith("_"):
                    bad = words_of(name) & words.keys()
                    found += [f"{source.relative_to(ROOT)}: {name}, say {words[b]}" for b in bad]
    assert not found, "\n".join(found)


def test_no_name_at_all_has_a_word_that_is_retired_everywhere() -> None:
    assert retired().keys() >= EVERYWHERE
    found = [
        f"{source.relative_to(ROOT)}: {name}"
        for part in PARTS
        for source in sorted((ROOT / part).rglob("*.py"))
        for name in set(every_name(source))
        if words_of(name) & EVERYWHERE
    ]
    assert not found, "\n".join(found)


def test_no_parameter_setting_or_topic_has_a_retired_word() -> None:
    names = set().union(*(node_parameters(configs) for configs in NODES.values()))
    names |= set(all_settings(ExplorationOptions())) | set(all_settings(MapOptions()))
    text = (ROOT / "docs" / "nodes.md").read_text(encoding="utf-8")
    names |= set(re.findall(r"`([a-z_~/.]+)`", text))
    words = retired()
    bad = {name: words[word] for name in names for word in words_of(name) & words.keys()}
    assert not bad
