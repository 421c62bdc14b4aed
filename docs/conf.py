"""The documentation as a site: `make docs`."""

from __future__ import annotations

from importlib.metadata import version as installed_version

project = "infomap_ros"
author = "the infomap_ros developers"
release = version = installed_version("infomap-ros")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
source_suffix = {".md": "markdown"}

myst_heading_anchors = 4

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"infomap_ros {version}"
