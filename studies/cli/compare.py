"""``ldc compare``: what got better or worse between two studies."""

import argparse

from studies.cli._console import Subparsers, console, output_file, positive_number

SOME_WORSE = 3  # exit code where a design is worse and the caller wants to know


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
    parser.add_argument(
        "-o",
        "--output",
        action="append",
        default=[],
        metavar="FILE",
        help="write every comparison as FILE.csv, or a page to read as FILE.html; repeatable",
    )
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

    from studies.cli._tables import print_comparison
    from studies.comparison.comparison import compare, comparison_content, write_comparison
    from studies.pages.compare_page import write_compare_page

    targets = [output_file(path, ".csv", ".html") for path in chosen.output]
    comparison = compare(chosen.old, chosen.new)
    for target in targets:
        write = write_compare_page if target.suffix.lower() == ".html" else write_comparison
        write(comparison, target)
    if chosen.json:
        print(json.dumps(comparison_content(comparison), indent=2, allow_nan=False))
    else:
        print_comparison(comparison, chosen.top, console())
        for target in targets:
            print(f"comparison: {target}")
    return SOME_WORSE if chosen.fail_if_worse and comparison.any_worse else 0
