"""``ldc report``: write the report of a study again; ``ldc compare``: what got better or worse between two studies."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ._console import (
    Subparsers,
    add_report_options,
    console,
    output_file,
    positive_number,
    print_table,
    progress_bar,
    say,
)

if TYPE_CHECKING:
    from ..comparison.comparison import Comparison


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


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ..design import named_designs
    from ..pages.replay import rows_of_numbers
    from ..storage.scenario_source import read_model
    from ..storage.store import Store
    from ._results import Judged, source_departures, write_files

    source = source_departures(args.source)
    folder = _folder(args.study)
    store = Store.open(folder)
    study, results = store.manifest.read_study(), store.results()
    rows_of_numbers(results.scenarios.take(results.drivable), args.departure)  # refused before the work begins
    named_designs(results.designs, args.design)
    model = read_model(folder, store.manifest)
    judged = Judged.of(folder, store.manifest, study, results, model=model, drive_plants=not args.no_robustness)
    with progress_bar("writing ranking and report"):
        files = write_files(
            judged, source=source, figures=not args.no_figures, departures=args.departure, designs=args.design
        )
    print("\n".join(f"{name + ':':8} {path}" for name, path in files.items()))


def _folder(name: str) -> Path:
    """The folder itself, or where `ldc run` puts a study of that name by default."""
    default = Path("out") / name
    return default if not Path(name).exists() and (default / "manifest.json").exists() else Path(name)


_MOST_LISTED = 20  # designs that failed
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


def compare_studies(args: argparse.Namespace) -> int:
    """Carry ``ldc compare`` out."""
    import json

    from ..comparison.comparison import compare, comparison_content, write_comparison
    from ..pages.compare_page import write_compare_page

    targets = [output_file(path, ".csv", ".html") for path in args.output]
    with progress_bar("comparing"):
        comparison = compare(args.old, args.new)
        for target in targets:
            write = write_compare_page if target.suffix.lower() == ".html" else write_comparison
            write(comparison, target)
    if args.json:
        print(json.dumps(comparison_content(comparison), indent=2, allow_nan=False))
    else:
        _print_comparison(comparison, args.top)
        for target in targets:
            print(f"comparison: {target}")
    return SOME_WORSE if args.fail_if_worse and comparison.any_worse else 0


def _print_comparison(comparison: Comparison, top: int) -> None:
    """What differs between the inputs first, then the designs, the failures, the warnings and one sentence."""
    from ..comparison.comparison import design_table, winners_sentence
    from ..comparison.paired import Verdict
    from ..text import plural

    out = console()
    say(out, f"old: {comparison.old} ({comparison.old_name})", f"new: {comparison.new} ({comparison.new_name})")
    if comparison.differences:
        say(out, "Inputs that differ, old -> new:", *(f"  {text}" for text in comparison.differences))
    else:
        say(out, "The inputs are the same: what differs below is in the code of a law, or in the machine.")
    out.print()
    same = comparison.count(Verdict.SAME)
    if len(comparison):
        # those that are the same are counted below
        print_table(design_table(comparison, comparison.order[: min(top, len(comparison) - same) or top]), out)
    if same:
        say(out, f"the same within 1e-6 m s: {same} of {len(comparison)} designs")
    if comparison.winners is not None:  # else a warning says so
        say(out, winners_sentence(comparison.winners))
    out.print()
    for heading, failed in (
        ("failed only in the new study, worse:", comparison.new_failures),
        ("failed only in the old study:", comparison.repaired),
        ("failed in both studies:", comparison.failed_in_both),
    ):
        if failed:
            more = [f"  and {len(failed) - _MOST_LISTED} more"] if len(failed) > _MOST_LISTED else []
            listed = (f"  {design.sentence}" for design in failed[:_MOST_LISTED])
            say(out, f"{plural(len(failed), 'design')} {heading}", *listed, *more)
    for heading, designs in (("old", comparison.only_old), ("new", comparison.only_new)):
        if designs:
            say(out, f"Only in the {heading} study: {plural(len(designs), 'design')}")
    for warning in comparison.warnings:
        out.print(f"Warning: {warning}", style="yellow", markup=False, emoji=False)
    say(out, comparison.summary)
