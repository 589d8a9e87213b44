"""``ldc models``: the bundled scenario models."""

from __future__ import annotations

import argparse

from studies.cli._console import Subparsers


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "models", help="list the bundled scenario models", description="List the scenario models that come along."
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    raise NotImplementedError
