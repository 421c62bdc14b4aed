"""The page as one file: a template, its style and scripts, and the data inside."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import Any

import infomap_ros.exploration.reports.report_page as package
from infomap_ros.exploration.reports.report_page.scene import pack

# In the order in which they build on each other.
_SCRIPTS = (
    *("basics.js", "data.js", "vectors.js", "orbit.js", "drawing.js", "layers.js"),
    *("overlay.js", "viewer.js", "panel.js", "main.js"),
)
_PLAIN_SCRIPTS = ("basics.js", "plain.js")


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        name: for links to it.
        heading: its title.
        body: its HTML; a section with an empty body is left out.
    """

    name: str
    heading: str
    body: str


def page(
    title: str,
    subtitle: str,
    lead: str,
    scene: Mapping[str, Any] | None,
    sections: Sequence[Section],
) -> str:
    """Put the page together.

    Args:
        title: plain text.
        subtitle: HTML below it.
        lead: HTML before the 3-D view.
        scene: of `scene_of`; None for a page without a 3-D view.
        sections: what follows the 3-D view.
    """
    return Template(_asset("page.html")).substitute(
        title=html.escape(title),
        subtitle=subtitle,
        lead=lead,
        sections="\n".join(_section(section) for section in sections if section.body),
        style=_asset("page.css"),
        viewer="" if scene is None else _asset("viewer.html"),
        script="\n".join(map(_asset, _PLAIN_SCRIPTS if scene is None else _SCRIPTS)),
        data="" if scene is None else _scene_data(scene),
    )


def _scene_data(scene: Mapping[str, Any]) -> str:
    places, data = pack(scene["arrays"])
    manifest = json.dumps({**scene["manifest"], "arrays": places}, allow_nan=False)
    return _data("manifest", "application/json", manifest) + _data("arrays", "text/plain", data)


def _section(section: Section) -> str:
    heading = html.escape(section.heading)
    return f'<section id="{section.name}"><h2>{heading}</h2>{section.body}</section>'


def _data(name: str, kind: str, text: str) -> str:
    """Text that a script reads and that cannot end its own element."""
    return f'<script id="{name}" type="{kind}">{text.replace("<", chr(92) + "u003c")}</script>\n'


def _asset(name: str) -> str:
    return files(package).joinpath("assets", name).read_text(encoding="utf-8")
