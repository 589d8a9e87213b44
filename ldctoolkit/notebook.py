"""What a notebook shows of an object: escaped HTML without script."""

import html
from collections.abc import Iterable
from typing import Final

# no ground and no text colour of its own: the notebook's theme, light or dark, sets them
CELL: Final = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"


def facts_html(title: str, lines: Iterable[tuple[str, str]], value_style: str) -> str:
    """A title and a table of names and values, these in a CSS style."""
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left;font-weight:normal;{CELL}">{html.escape(name)}</th>'
        f'<td style="{value_style};{CELL}">{html.escape(value)}</td></tr>'
        for name, value in lines
    )
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b></div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><tbody>{rows}</tbody></table></div>'
    )
