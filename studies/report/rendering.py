"""Templates of the report, and what they may call."""

from __future__ import annotations

import functools
import importlib.resources

import jinja2
from markupsafe import Markup

from studies.report.tables.row import is_baseline
from studies.report.words import prose, text


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("studies.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        "number": text.number,
        "figure": text.figure,
        "signed": text.signed,
        "percent": text.percent,
        "change": text.change,
        "symbols": text.symbols,
        "printable": text.printable,
        "compact": text.compact,
    }
    environment.globals |= {
        "is_baseline": is_baseline,
        "design_text": prose.design_text,
        "between": prose.between,
        "plural": text.plural,
    }
    return environment


def render(template: str, **values: object) -> Markup:
    """A template under ``templates/`` as HTML; every string in `values` is escaped unless it is Markup."""
    return Markup(_environment().get_template(template).render(**values))


def asset(name: str) -> Markup:
    """A file under ``templates/``, one of our own and not a user's: it goes into the page as it is."""
    return Markup((importlib.resources.files("studies.report") / "templates" / name).read_text(encoding="utf-8"))
