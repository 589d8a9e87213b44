"""The shell of every page: sections, tables, styles and script in one file that needs nothing else."""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.errors import InputError

from ..text import number, printable, symbols, symbols_svg
from .charts import COLORS, Chart

if TYPE_CHECKING:
    from jinja2 import Environment

_PACKAGE: Final = "ldctoolkit.studies.pages"


@dataclasses.dataclass(frozen=True)
class Section:
    """One section of a page."""

    id: str  # Stays the same from version to version
    title: str  # Its heading, and its entry in the list of sections
    body: Markup
    charts: tuple[Chart, ...] = ()  # Those of the body that are written as files, too
    # What the script finds under the section's id: text, numbers, and `packed` arrays
    data: Mapping[str, object] | None = None
    scripts: tuple[str, ...] = ()  # Files under ``templates``; each is put into the page once
    printed: bool = False  # Whether it is printed


def paragraphs(*sentences: str) -> Markup:
    """Plain sentences as paragraphs; empty ones are left out."""
    return Markup("").join(Markup("<p>{}</p>").format(symbols(text)) for text in sentences if text)


def bullets(sentences: Iterable[str], kind: str = "") -> Markup:
    """Plain sentences as a list; nothing for none."""
    items = Markup("").join(Markup("<li>{}</li>").format(symbols(text)) for text in sentences)
    return Markup('<ul class="{}">{}</ul>').format(kind, items) if items else Markup()


def pairs(facts: Iterable[tuple[str, str]]) -> Markup:
    """Names and values as a list."""
    items = Markup("").join(Markup("<dt>{}</dt><dd>{}</dd>").format(symbols(a), symbols(b)) for a, b in facts)
    return Markup("<dl>{}</dl>").format(items)


def figure(charts: Sequence[Chart], caption: str, key: Markup = Markup()) -> Markup:  # noqa: B008 - it is immutable
    """Charts side by side, with their legend above and a caption below; nothing without a chart."""
    if not charts:
        return Markup()
    panels = Markup("").join(Markup('<div class="panel">{}</div>').format(chart.svg) for chart in charts)
    return Markup('<figure>{}<div class="panels">{}</div><figcaption>{}</figcaption></figure>').format(
        key, panels, symbols(caption)
    )


def details(title: str, body: Markup) -> Markup:
    """What is shown when requested; it is not printed."""
    return Markup("<details><summary>{}</summary>{}</details>").format(symbols(title), body)


# ------------------------------------------------------------------------------------------------ the script's data


def packed(values: npt.ArrayLike, kind: str = "f4") -> dict[str, str]:
    """An array as the script reads it: flattened, little-endian, base64."""
    array = np.asarray(values)
    with np.errstate(over="ignore"):  # a float beyond 32 bits is shown as infinite
        small = array.astype(f"<{kind}")
    if kind != "f4" and not np.array_equal(small.astype(np.int64), array.astype(np.int64)):
        raise InputError("packed", f"values from {array.min()} to {array.max()} do not fit {kind}")
    return {"type": kind, "data": base64.b64encode(small.tobytes()).decode("ascii")}


def script_json(data: Mapping[str, Any]) -> Markup:
    r"""JSON that may stand inside a ``<script>`` element: no ``<`` in it, so nothing can end the element."""
    try:
        text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise InputError("report data", str(error)) from None
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


# ------------------------------------------------------------------------------------------------ the page


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(_PACKAGE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"symbols": symbols, "symbols_svg": symbols_svg, "printable": printable, "number": number}
    # of its own style and script, so that a browser uses no other
    environment.filters["sha256"] = lambda text: base64.b64encode(sha256(text.encode()).digest()).decode()
    return environment


def render(template: str, **values: object) -> Markup:
    """A template under ``templates`` with its values; text is escaped."""
    return Markup(_environment().get_template(template).render(**values))


@cache
def asset(name: str) -> Markup:
    """A file under ``templates`` as it is."""
    return Markup((resources.files(_PACKAGE) / "templates" / name).read_text(encoding="utf-8"))


def make_page(
    *, kind: str, title: str, heading: str, facts: Sequence[str], sections: Sequence[Section], footer: str
) -> str:
    """A page as one HTML document; the same input gives the same text."""
    scripts = dict.fromkeys(name for section in sections for name in section.scripts)
    data = {section.id: section.data for section in sections if section.data is not None}
    return str(
        render(
            "page.html",
            kind=kind,
            title=title,
            heading=heading,
            facts=facts,
            sections=sections,
            footer=footer,
            style=Markup("".join(f".c{i}{{--c:{color}}}" for i, color in enumerate(COLORS))) + asset("page.css"),
            script=Markup("\n").join(asset(name) for name in ("page.js", *scripts)) if scripts else "",
            data=script_json(data),
        )
    )
