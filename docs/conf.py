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
exclude_patterns: list[str] = ["README.md"]

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
suppress_warnings = ["myst.header"]

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"infomap_ros {version}"
nitpicky = False
