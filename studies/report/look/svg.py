"""A matplotlib figure as inline SVG: the same bytes each time, no identifier twice on a page, nothing fetched."""

from __future__ import annotations

import html
import io
import re
import warnings
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from studies.report.look.style import figure_settings
from studies.report.words.text import SYMBOL, printable, symbol_parts

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FONT = re.compile(r"font(-family)?:[^;]*(;|$)")


def inline_svg(figure: Figure, prefix: str, title: str) -> Markup:
    """Draw a figure as an ``svg`` element for an HTML page.

    Parameters
    ----------
    figure : Figure
        What to draw.
    prefix : str
        Put before every identifier; different for every figure of a page.
    title : str
        What a screen reader says.

    Returns
    -------
    Markup
        ``<svg role="img" ...>``; its text stays text, in the page's own font.
    """
    return inline_document(file_svg(figure), prefix, title)


def inline_document(document: str, prefix: str, title: str) -> Markup:
    """`inline_svg` of a figure that was drawn already, by `file_svg`."""
    from markupsafe import Markup

    root = ET.fromstring(document)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        for key in list(element.attrib):
            element.attrib[key.rpartition("}")[2]] = element.attrib.pop(key)
    _drop(root, ("metadata", "style"))
    _rename(root, prefix)
    for text in root.iter("text"):
        _set_text(text)
    for element in root.iter():
        _round(element)
    width, height = (float(part) for part in root.attrib["viewBox"].split()[2:])
    # points are CSS pixels times 3/4
    attributes = {
        "viewBox": root.attrib["viewBox"],
        "width": f"{width * 4 / 3:.0f}",
        "height": f"{height * 4 / 3:.0f}",
        "role": "img",
        "aria-labelledby": f"{prefix}-title",
    }
    root.attrib.clear()
    root.attrib.update(attributes)
    heading = ET.Element("title", id=f"{prefix}-title")
    heading.text = title
    root.insert(0, heading)
    return Markup(re.sub(r">\s+<", "><", ET.tostring(root, encoding="unicode")))


def file_svg(figure: Figure) -> str:
    """A figure as an SVG document: no date, no name of a program, identifiers that do not change.

    Parameters
    ----------
    figure : Figure

    Returns
    -------
    str
    """
    buffer = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with figure_settings(), warnings.catch_warnings():
        # measured in another font than the reader's: a glyph that is missing here is not missing there
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(buffer, format="svg", metadata=nothing)
    return printable(buffer.getvalue())


def _drop(root: ET.Element, tags: tuple[str, ...]) -> None:
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in tags:
                parent.remove(child)


def _rename(root: ET.Element, prefix: str) -> None:
    """Prefix the identifiers that are used, remove the rest."""
    used: set[str] = set()
    for element in root.iter():
        for value in element.attrib.values():
            used.update(_REFERENCE.findall(value))
        if element.attrib.get("href", "").startswith("#"):
            used.add(element.attrib["href"].removeprefix("#"))
    short = {name: f"{prefix}-{i}" for i, name in enumerate(sorted(used))}
    for element in root.iter():
        for key, value in list(element.attrib.items()):
            if key == "id":
                if value in short:
                    element.attrib[key] = short[value]
                else:
                    del element.attrib[key]
            elif key == "href" and value.startswith("#"):
                element.attrib[key] = "#" + short[value.removeprefix("#")]
            elif "url(#" in value:
                element.attrib[key] = _REFERENCE.sub(lambda m: f"url(#{short[m[1]]})", value)


def _set_text(element: ET.Element) -> None:
    """Leave the font's family to the page, and set indices low."""
    if "style" in element.attrib:
        style = element.attrib["style"]
        size = re.search(r"font:\s*(?:[a-z0-9]+ )*?(\d+(?:\.\d+)?)px", style)
        weight = "font-weight: bold; " if re.search(r"font:[^;]*\b(?:bold|700)\b", style) else ""
        kept = _FONT.sub("", style).strip()
        element.attrib["style"] = (f"font-size: {size[1]}px; {weight}" if size else "") + kept
    text = element.text or ""
    if not SYMBOL.search(text):
        return
    element.text, last, end = text[: SYMBOL.search(text).start()], None, 0  # type: ignore[union-attr]
    for match in SYMBOL.finditer(text):
        if last is not None:
            last.text = (last.text or "") + text[end : match.start()]
        base, index = symbol_parts(match)
        if last is None:
            element.text += base
        else:
            last.text = (last.text or "") + base
        ET.SubElement(element, "tspan", dy="0.22em", style="font-size: 78%").text = index
        # the text after an index goes back up; an empty shift would be lost, so it always holds a character
        last = ET.SubElement(element, "tspan", dy="-0.17em")
        end = match.end()
    if last is not None:
        last.text = (last.text or "") + (text[end:] or "\u200b")


def _round(element: ET.Element) -> None:
    for key in ("d", "x", "y", "width", "height", "transform", "points"):
        if key in element.attrib:
            value = _NUMBER.sub(lambda m: f"{float(m[0]):.2f}".rstrip("0").rstrip("."), element.attrib[key])
            element.attrib[key] = " ".join(value.split())


def line_sample(color: str, dash: tuple[float, ...]) -> Markup:
    """A short line for a legend in HTML; it says nothing to a screen reader, the text beside it does."""
    from markupsafe import Markup

    strokes = f' stroke-dasharray="{" ".join(f"{2 * part:g}" for part in dash)}"' if dash else ""
    return Markup(
        '<svg class="sample" viewBox="0 0 36 10" width="36" height="10" aria-hidden="true">'
        f'<path d="M1 5H35" fill="none" stroke="{html.escape(color)}" stroke-width="2.5"{strokes}/></svg>'
    )
