"""``ldc rank``: rank the stored results of a study again."""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.cli._console import Subparsers, positive_number


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "rank",
        help="print the ranking of a study that was run",
        description="Rank the stored results of a study, print the table and write DIR/ranking.csv again.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from studies.cli._results import print_rankings, write_ranking
    from studies.ranking.ranking import rank_study
    from studies.storage.store import Store

    store = Store.open(chosen.folder)
    rankings = rank_study(store.results(), store.manifest.read_study())
    print_rankings(rankings, chosen.top)
    print(f"ranking: {write_ranking(Path(chosen.folder), rankings)}")
