"""``ldc report``: write the report of a study again."""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.cli._console import Subparsers
from studies.cli._robustness import add_option, robustness_of_study


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "report",
        help="write the report of a study that was run",
        description="Write DIR/report.html, DIR/ranking.csv and DIR/ranking.md from the stored results of a study.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    add_option(parser)
    parser.add_argument(
        "--departures",
        action="append",
        metavar="FILE.parquet",
        help="departures that the scenario model was fitted to, as ldc extract wrote them: the report compares the "
        "generated ones with them; repeatable",
    )
    parser.add_argument(
        "--departure",
        action="append",
        type=int,
        default=[],
        metavar="N",
        help="put the departure with this scenario number into the explorer; repeatable",
    )
    parser.add_argument(
        "--design",
        action="append",
        default=[],
        metavar="ID",
        help="put the design whose id begins like this into the explorer; repeatable",
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from studies.cli._results import source_departures, write_ranking, write_study_report
    from studies.ranking.ranking import rank_study
    from studies.report.replay.asked import asked_departures, asked_designs
    from studies.storage.store import Store

    source = source_departures(chosen.departures)
    store = Store.open(chosen.folder)
    study, results = store.manifest.read_study(), store.results()
    asked_departures(results.drivable().scenarios, chosen.departure)  # refused before the work begins
    asked_designs(results.designs, chosen.design)
    rankings, folder = rank_study(results, study), Path(chosen.folder)
    print(f"ranking: {write_ranking(folder, study, store.manifest, results, rankings)}")
    asked = {"departures": chosen.departure, "shown_designs": chosen.design}
    asked |= {"robustness": robustness_of_study(chosen, folder, study, results, rankings[0])}
    print(f"report:  {write_study_report(folder, study, store.manifest, results, rankings, source, **asked)}")
