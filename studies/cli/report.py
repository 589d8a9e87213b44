"""``ldc report``: write the report of a study again."""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.cli._console import Subparsers


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "report",
        help="write the report of a study that was run",
        description="Write DIR/report.html, DIR/ranking.csv and DIR/ranking.md from the stored results of a study.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from studies.cli._results import write_ranking, write_study_report
    from studies.ranking.ranking import rank_study
    from studies.storage.store import Store

    store = Store.open(chosen.folder)
    study, results = store.manifest.read_study(), store.results()
    rankings, folder = rank_study(results, study), Path(chosen.folder)
    print(f"ranking: {write_ranking(folder, study, store.manifest, results, rankings)}")
    print(f"report:  {write_study_report(folder, study, store.manifest, results, rankings)}")
