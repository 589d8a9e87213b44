"""``ldc compare``: what got better or worse between two studies."""

from __future__ import annotations

import argparse

from studies.cli._console import Subparsers, console, output_file, positive_number

SOME_WORSE = 3
"""Exit code where a design is worse and the caller wants to know."""


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "compare",
        help="what got better or worse between two studies",
        description="Compare two finished studies on the scenarios that both ran: designs of both one by one, and the "
        "new winner against the old one, with intervals. Differences are new minus old: negative is better.",
    )
    parser.add_argument("old", metavar="OLD", help="folder that ldc run wrote")
    parser.add_argument("new", metavar="NEW", help="folder that ldc run wrote")
    parser.add_argument("-o", "--output", metavar="FILE.csv", help="write every comparison as CSV")
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    parser.add_argument("--json", action="store_true", help="print JSON for scripts instead of tables")
    parser.add_argument(
        "--fail-if-worse",
        action="store_true",
        help="exit code 3 if a design is worse, or fails only in NEW, or NEW's winner is worse than OLD's",
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Carry the command out."""
    import json

    from studies.cli._comparison_table import print_comparison
    from studies.comparison.compare_studies import compare
    from studies.comparison.comparison_files import comparison_content, write_comparison

    target = None if chosen.output is None else output_file(chosen.output, ".csv")
    comparison = compare(chosen.old, chosen.new)
    if target is not None:
        write_comparison(comparison, target)
    if chosen.json:
        print(json.dumps(comparison_content(comparison), indent=2, allow_nan=False))
    else:
        print_comparison(comparison, chosen.top, console())
        if target is not None:
            print(f"comparison: {target}")
    return SOME_WORSE if chosen.fail_if_worse and comparison.any_worse else 0
