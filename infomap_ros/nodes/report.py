"""A report of one HTML file: figures and pictures, nothing beside it is needed."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
table {{ border-collapse: collapse; }}
td, th {{ padding: 0.2rem 1rem 0.2rem 0; text-align: left; border-bottom: 1px solid #ccc; }}
td + td {{ text-align: right; font-variant-numeric: tabular-nums; }}
figure {{ margin: 2rem 0; }}
img {{ max-width: 100%; }}
figcaption {{ color: #555; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{introduction}</p>
<table>
{rows}
</table>
{figures}
</body>
</html>
"""


def write_report(
    path: Path,
    title: str,
    introduction: str,
    figures: Mapping[str, object],
    pictures: Sequence[tuple[Path, str]],
) -> None:
    """Write the report.

    Args:
        path: the HTML file.
        title: its heading.
        introduction: one paragraph.
        figures: name -> value, for the table.
        pictures: PNG files with their captions; they become part of the page.
    """
    rows = "\n".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(_text(value))}</td></tr>"
        for name, value in figures.items()
    )
    page = _PAGE.format(
        title=html.escape(title),
        introduction=html.escape(introduction),
        rows=rows,
        figures="\n".join(_figure(picture, caption) for picture, caption in pictures),
    )
    path.write_text(page, encoding="utf-8")


def _figure(picture: Path, caption: str) -> str:
    content = base64.b64encode(picture.read_bytes()).decode("ascii")
    text = html.escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{content}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.4g}" if abs(value) < 1000 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
