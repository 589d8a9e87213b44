"""``ldc models``: the bundled scenario models."""

from __future__ import annotations

import argparse

from studies.cli._console import Subparsers


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "models",
        help="describe scenario models",
        description="Describe the bundled scenario models, or the given ones: where they come from and how they were "
        "fitted.",
    )
    parser.add_argument("model", nargs="*", metavar="MODEL", help="bundled model or JSON file (default: all bundled)")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.scenario_model import bundled_models, load_model
    from studies.storage.stored_model import model_notes

    for name in chosen.model or bundled_models():
        model = load_model(name)
        print(f"{name} (content {model.content_hash[:12]})")
        for note in model_notes(model):
            print(f"  {note}")
