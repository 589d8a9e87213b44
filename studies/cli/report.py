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
        description="Write DIR/report.html from the stored results of a study.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from studies.cli._results import write_study_report
    from studies.ranking.ranking import rank_study
    from studies.storage.store import Store

    store = Store.open(chosen.folder)
    study, results = store.manifest.read_study(), store.results()
    rankings = rank_study(results, study)
    print(f"report: {write_study_report(Path(chosen.folder), study, store.manifest, results, rankings)}")
