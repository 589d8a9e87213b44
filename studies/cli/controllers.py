"""``ldc controllers`` and ``ldc models``: the laws with their gains, and the scenario models."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..tables import Column, Row, Table
from ._console import Subparsers, console, print_table, say, warn

if TYPE_CHECKING:
    from ldctoolkit.control import Controller
    from ldctoolkit.declared import Gain


def add_parser(commands: Subparsers) -> None:
    """Declare the commands."""
    parser = commands.add_parser(
        "controllers",
        help="list the laws and their gains",
        description="List every known law, whether it is linear, and its gains: unit, default, what a study file may "
        "set, and how a range is spaced.",
    )
    parser.add_argument("law", nargs="*", metavar="LAW", help="only these (default: all)")
    parser.set_defaults(run=run)
    parser = commands.add_parser(
        "models",
        help="describe scenario models",
        description="Describe the bundled scenario models, or the given ones: where they come from and how they were "
        "fitted. Without MODEL, also how to make one of public recordings, and what came out when it was tried.",
    )
    parser.add_argument("model", nargs="*", metavar="MODEL", help="bundled model or JSON file (default: all bundled)")
    parser.set_defaults(run=describe_models)


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from rich.text import Text

    from ldctoolkit.errors import LdcError
    from ldctoolkit.registry import controller_class, controller_names

    out = console()
    for name in args.law or controller_names():
        try:
            kind = controller_class(name)
        except LdcError as error:
            if args.law:
                raise
            warn(str(error))  # one broken third-party law does not hide the others
            continue
        title = f"{name}: {kind.title}{_kind(kind)}"
        rows = []
        for g in kind.gains():
            words = ("true", "false") if isinstance(g.default, bool) else g.choices
            allowed = ", ".join(words) if words else "any text" if g.text else _interval(g.lower, g.upper)
            default = str(g.default).lower() if isinstance(g.default, bool) else str(g.default)
            rows.append(Row([g.name, "" if g.unit == "1" else g.unit, default, allowed, _scale(g), g.description]))
        if rows:
            headings = ("gain", "unit", "default", "allowed", "scale", "meaning")
            print_table(Table(title, [Column(heading, text=True) for heading in headings], rows), out)
        else:
            out.print(Text.assemble((title, "italic"), ", no gains"))
        out.print()


def _kind(kind: type[Controller]) -> str:
    """The kind of law that it declares; nothing where it does not."""
    from ldctoolkit.control import LinearLaw, RecordedPath, SteeringLaw
    from ldctoolkit.law_checks import declared_law

    words = {LinearLaw: ", linear law", RecordedPath: ", recorded path", SteeringLaw: ", steering law"}
    law = declared_law(kind)
    return next((text for base, text in words.items() if law is not None and issubclass(law, base)), "")


def _scale(declared: Gain) -> str:
    """Spacing of a range in a study; words and switches have none."""
    return (
        declared.scale if isinstance(declared.default, float | int) and not isinstance(declared.default, bool) else ""
    )


def _interval(lower: float, upper: float) -> str:
    if math.isinf(lower) and math.isinf(upper):
        return "any number"
    if math.isinf(upper):
        return f">= {lower:g}"
    return f"<= {upper:g}" if math.isinf(lower) else f"{lower:g} .. {upper:g}"


def describe_models(args: argparse.Namespace) -> None:
    """Carry ``ldc models`` out."""
    from ldctoolkit.scenario_model import bundled_models, load_model

    from ..storage.scenario_source import model_notes, model_warnings

    for name in args.model or bundled_models():
        model = load_model(name)
        print(f"{name} (content {model.content_hash[:12]})")
        for note in (*model_notes(model), *(f"warning: {text}" for text in model_warnings(model))):
            print(f"  {note}")
    if not args.model:
        _describe_public_sources()


def _describe_public_sources() -> None:
    from ldctoolkit.checked_files import read_toml
    from ldctoolkit.errors import InputError

    tried = read_toml(Path(__file__).with_name("public_sources.toml"), InputError)
    columns = [Column(heading, text=True) for heading in tried["source"][0]]
    out = console()
    out.print()
    print_table(Table(tried["title"], columns, [Row(list(source.values())) for source in tried["source"]]), out)
    say(out, tried["note"].strip())
