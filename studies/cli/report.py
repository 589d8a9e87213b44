"""``ldc report``: write the report of a study again; ``ldc compare``: what got better or worse between two studies."""

import argparse
from pathlib import Path

from ._console import Subparsers, add_report_options, console, output_file, positive_number, progress_bar


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "report",
        help="write the report of a study that was run",
        description="Write report.html, figures/, ranking.csv and ranking.md from the stored results of a study, "
        "into its folder.",
    )
    about = "folder that ldc run wrote, or the name of a study that ran into out/NAME"
    parser.add_argument("study", metavar="STUDY", help=about)
    add_report_options(parser)
    about = "put the departure with this scenario number into the explorer; repeatable"
    parser.add_argument("--departure", action="append", type=int, default=[], metavar="N", help=about)
    about = "put the design whose id begins like this into the explorer; repeatable"
    parser.add_argument("--design", action="append", default=[], metavar="ID", help=about)
    parser.set_defaults(run=run)
    _add_compare(commands)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from ..design import named_designs
    from ..pages.replay import rows_of_numbers
    from ..ranking.ranking import rank_study
    from ..ranking.verdict import verdict
    from ..storage.store import Store
    from ..storage.stored_model import read_model
    from ._results import ReportOptions, write_ranking, write_study_report

    options = ReportOptions.of(chosen, chosen.departure, chosen.design)
    folder = _folder(chosen.study)
    store = Store.open(folder)
    study, results = store.manifest.read_study(), store.results()
    rows_of_numbers(results.on_drivable().scenarios, options.departures)  # refused before the work begins
    named_designs(results.designs, options.designs)
    with progress_bar("ranking"):
        ranking = rank_study(results, study)
    with progress_bar("driving the best on other plants"):
        robustness = options.robustness_of(folder, study, results, ranking)
    found = verdict(ranking, results, study.setup(), robustness, read_model(folder, store.manifest))
    print(f"ranking: {write_ranking(folder, study, store.manifest, ranking, found)}")
    with progress_bar("writing the report"):
        path = write_study_report(folder, study, store.manifest, results, ranking, options, robustness)
    print(f"report:  {path}")


def _folder(name: str) -> Path:
    """The folder itself, or where `ldc run` puts a study of that name by default."""
    default = Path("out") / name
    return default if not Path(name).exists() and (default / "manifest.json").exists() else Path(name)


SOME_WORSE = 3  # exit code where a design is worse and the caller wants to know


def _add_compare(commands: Subparsers) -> None:
    parser = commands.add_parser(
        "compare",
        help="what got better or worse between two studies",
        description="Compare two finished studies on the scenarios that both ran: designs of both one by one, and the "
        "new winner against the old one, with intervals. Differences are new minus old: negative is better.",
    )
    parser.add_argument("old", metavar="OLD", help="folder that ldc run wrote")
    parser.add_argument("new", metavar="NEW", help="folder that ldc run wrote")
    about = "write every comparison as FILE.csv, or a page to read as FILE.html; repeatable"
    parser.add_argument("-o", "--output", action="append", default=[], metavar="FILE", help=about)
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    parser.add_argument("--json", action="store_true", help="print JSON for scripts instead of tables")
    about = "exit code 3 if a design is worse, or fails only in NEW, or NEW's winner is worse than OLD's"
    parser.add_argument("--fail-if-worse", action="store_true", help=about)
    parser.set_defaults(run=compare_studies)


def compare_studies(chosen: argparse.Namespace) -> int:
    """Carry ``ldc compare`` out."""
    import json

    from ..comparison.comparison import compare, comparison_content, write_comparison
    from ..pages.compare_page import write_compare_page
    from ._tables import print_comparison

    targets = [output_file(path, ".csv", ".html") for path in chosen.output]
    with progress_bar("comparing"):
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
