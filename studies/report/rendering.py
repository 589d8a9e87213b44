"""Templates of the report and its sister pages, and what they may call."""

from __future__ import annotations

import functools
import importlib.resources

import jinja2
from markupsafe import Markup

from studies.report.tables.row import is_baseline
from studies.report.words import prose, text

_REPORT = "studies.report"


@functools.cache
def _environment(package: str) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name) for name in dict.fromkeys((package, _REPORT))]),
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


def render(template: str, package: str = _REPORT, **values: object) -> Markup:
    """A template as HTML; every string in `values` is escaped unless it is Markup.

    Parameters
    ----------
    template : str
        Name under ``templates/`` of the package, or of the report.
    package : str
    **values
        What the template asks for.
    """
    return Markup(_environment(package).get_template(template).render(**values))


def asset(name: str, package: str = _REPORT) -> Markup:
    """A file under ``templates/``, one of our own and not a user's: it goes into the page as it is."""
    return Markup((importlib.resources.files(package) / "templates" / name).read_text(encoding="utf-8"))
