"""Command lines that help and documentation show: their options, choices and settings exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from infomap_ros import cli
from infomap_ros.cli import study_commands as studies
from infomap_ros.cli.app import LateCommand
from infomap_ros.localization.target.tag_board import FAMILIES

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("**/*.md"))]
GROUPS = {"": cli.COMMANDS, "study": studies.COMMANDS}
OTHERS = {"doctor", "record-demo-bag"}  # have no parser of typer


def lines_of(text: str) -> list[str]:
    """Lines of code blocks, and pieces in backticks, that call the program."""
    joined = re.sub(r"\\\n\s*", " ", text)
    blocks = re.findall(r"^ *(infomap [a-z-]+ .*)$", joined, re.MULTILINE)
    return [line.rstrip("`") for line in blocks + re.findall(r"`(infomap [a-z-]+ [^`]*)`", joined)]


SHOWN = {
    **{command.example: "--help" for group in GROUPS.values() for command in group.values()},
    **{line: page.name for page in PAGES for line in lines_of(page.read_text("utf-8"))},
}
SHOWN.pop("", None)


def click_command(command: LateCommand) -> tuple[Any, Any]:
    """What typer makes of a command, and a context for its parser."""
    app = typer.Typer()
    app.command()(command.load())
    made = typer.main.get_command(app)
    return app, made


def test_there_are_examples() -> None:
    assert len(SHOWN) > 40
    assert {line.split()[1] for line in SHOWN} > set(cli.COMMANDS) - {"study"}


@pytest.mark.parametrize("line", SHOWN)
def test_its_options_exist(line: str) -> None:
    words = shlex.split(line.replace("[", "").replace("]", "").replace("...", ""), comments=True)
    words = words[1 : words.index("&&") if "&&" in words else None]
    group = GROUPS["study"] if words[0] == "study" else cli.COMMANDS
    words = words[1:] if words[0] == "study" else words
    if words[0] in OTHERS:
        return
    app, command = click_command(group[words[0]])
    context = command.make_context("it", [], resilient_parsing=True)
    values, rest, _ = command.make_parser(context).parse_args(words[1:])
    assert rest == []
    for parameter in command.params:
        choices = getattr(getattr(parameter, "type", None), "choices", None)
        given = values.get(parameter.name)
        for value in given if isinstance(given, list) else [given]:
            assert choices is None or value is None or value in choices, parameter.name
    assert values.get("family") in {None, *FAMILIES}
    if changed := values.get("setting"):
        listed = CliRunner().invoke(app, ["--settings"]).output
        for setting in changed:
            assert f"{setting.partition('=')[0]}=" in listed
