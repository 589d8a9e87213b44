"""``ldc run``: run a study, print its ranking, write its report."""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.cli._console import Subparsers, positive_number


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "run",
        help="run a study: rank designs, write the report",
        description="Run every design of a study on the same scenarios. Writes DIR/report.html and DIR/ranking.csv; "
        "running again into the same DIR computes only what is missing. Exit code 3: done, but the law of some design "
        "failed; the ranking and the report name it.",
    )
    parser.add_argument(
        "study", metavar="STUDY", help="name in the catalog (paper, reality, trigger-and-gains) or a TOML file"
    )
    parser.add_argument("-o", "--output", metavar="DIR", help="folder of the results (default: out/<study name>)")
    parser.add_argument("--model", metavar="MODEL", help="scenario model instead of the study's: a name or a JSON file")
    parser.add_argument("--workers", type=positive_number, metavar="N", help="processes (default: all cores)")
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no table")
    parser.set_defaults(run=run)


SOME_FAILED = 3
"""Exit code where the study has results, but not of every design."""


def run(chosen: argparse.Namespace) -> int:
    """Carry the command out."""
    from studies.cli._results import print_rankings, write_ranking, write_study_report
    from studies.manifest import read_manifest
    from studies.ranking import rank_study
    from studies.ready import load_study
    from studies.runner import run_study

    study = load_study(chosen.study)
    folder = Path(chosen.output or Path("out") / study.name)
    results = run_study(
        study,
        directory=folder,
        model=chosen.model,
        workers=chosen.workers,
        progress=False if chosen.quiet else None,
    )
    manifest = read_manifest(folder)
    rankings = rank_study(results, study)
    if not chosen.quiet:
        print_rankings(rankings, chosen.top)
        print(
            f"{study.name}: {len(study.designs)} designs x {len(results.scenarios):,} scenarios, "
            f"{manifest.wall_time_s:.1f} s, model {manifest.model} ({manifest.model_hash[:12]})"
        )
    # files last: what they are called is the last thing on the screen
    ranking_path = write_ranking(folder, rankings)
    report_path = write_study_report(folder, study, manifest, results, rankings)
    print(f"ranking: {ranking_path}")
    print(f"report:  {report_path}")
    return SOME_FAILED if results.failed else 0
