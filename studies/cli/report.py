"""``ldc report``: write the report of a study again."""

import argparse
from pathlib import Path

from studies.cli._console import Subparsers, add_report_options


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "report",
        help="write the report of a study that was run",
        description="Write report.html, figures/, ranking.csv and ranking.md from the stored results of a study, "
        "into its folder.",
    )
    parser.add_argument(
        "study", metavar="STUDY", help="folder that ldc run wrote, or the name of a study that ran into out/NAME"
    )
    add_report_options(parser)
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
    from studies.cli._results import ReportOptions, write_ranking, write_study_report
    from studies.pages.replay import designs_of_ids, rows_of_numbers
    from studies.ranking.ranking import rank_study
    from studies.ranking.verdict import verdict
    from studies.storage.store import Store

    options = ReportOptions.of(chosen, chosen.departure, chosen.design)
    folder = _folder(chosen.study)
    store = Store.open(folder)
    study, results = store.manifest.read_study(), store.results()
    rows_of_numbers(results.drivable().scenarios, options.departures)  # refused before the work begins
    designs_of_ids(results.designs, options.designs)
    rankings = rank_study(results, study)
    robustness = options.robustness_of(folder, study, results, rankings[0])
    found = verdict(rankings[0], results, study.setup(), robustness)
    print(f"ranking: {write_ranking(folder, study, store.manifest, results, rankings, found)}")
    print(f"report:  {write_study_report(folder, study, store.manifest, results, rankings, options, robustness)}")


def _folder(name: str) -> Path:
    """The folder itself, or where `ldc run` puts a study of that name by default."""
    default = Path("out") / name
    return default if not Path(name).exists() and (default / "manifest.json").exists() else Path(name)
