"""A section of the report: its text, its figures, and what the page's script needs for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

from markupsafe import Markup

from studies.report.look.svg import file_svg, inline_document
from studies.report.words.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Drawing:
    """A figure that stands in the page and, as a file, under ``figures/``.

    Attributes
    ----------
    name : str
        Letters, digits and dashes; no other drawing of the report has it. The file's name, and the prefix of all
        identifiers inside.
    title : str
        What a screen reader says.
    figure : Figure
    note : Markup
        What is particular to this figure; may be empty.
    """

    name: str
    title: str
    figure: Figure
    note: Markup = dataclasses.field(default_factory=Markup)

    @cached_property
    def document(self) -> str:
        """The figure as an SVG document, drawn once."""
        document = file_svg(self.figure)
        self.figure.set_layout_engine("none")  # the layout is found: what draws the figure again keeps it
        return document

    @property
    def svg(self) -> Markup:
        """The figure as an ``svg`` element."""
        return inline_document(self.document, self.name, printable(self.title))


@dataclasses.dataclass(frozen=True)
class Tile:
    """One large number at the top of a page."""

    value: str
    unit: str
    text: str
    detail: str


@dataclasses.dataclass(frozen=True)
class Section:
    """One section of the report.

    Attributes
    ----------
    id : str
        Stays the same from version to version.
    title : str
        In the list of sections.
    body : Markup
        What stands in ``<section id=...>``, with its heading.
    drawings : tuple of Drawing
    data : mapping, optional
        What the script finds under the section's id: text, numbers, lists and mappings of them, and
        `studies.report.embedded.packed.packed` arrays.
    scripts, styles : tuple of str
        Files under ``templates/js`` and ``templates/css``; each is put into the page once.
    """

    id: str
    title: str
    body: Markup
    drawings: tuple[Drawing, ...] = ()
    data: Mapping[str, object] | None = None
    scripts: tuple[str, ...] = ()
    styles: tuple[str, ...] = ()
