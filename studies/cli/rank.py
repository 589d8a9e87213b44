"""``ldc rank``: rank the stored results of a study again, as the study says or with other settings."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ldctoolkit.errors import InputError
from studies.cli._console import Subparsers, number, output_file, positive_number, warn

if TYPE_CHECKING:
    from studies.study_file import Study


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "rank",
        help="print the ranking of a study that was run",
        description="Rank the stored results of a study, print the table and write DIR/ranking.csv and "
        "DIR/ranking.md again. Nothing is driven. With settings other than the study's own, these stay as they are; -o "
        "writes the other ranking.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    parser.add_argument(
        "--require",
        action="append",
        metavar="TEXT",
        help="what a design must meet to be ranked, as 'ay_p95 <= 3.0', or a set: stable, comfort, lane-edge, "
        "physical; instead of the study's requirements; repeatable; '' for none",
    )
    parser.add_argument(
        "--baseline",
        metavar="DESIGN",
        help="design that all are compared with: a law, or the start of an identifier; '' for no control",
    )
    parser.add_argument(
        "--pareto",
        action="append",
        metavar="METRIC",
        help="metric of the Pareto front, instead of the study's; repeatable; '' for no front",
    )
    parser.add_argument("--confidence", type=number, metavar="P", help="of the intervals, between 0 and 1")
    parser.add_argument("-o", "--output", metavar="FILE", help="write the ranking here, as .csv or .md, not to DIR")
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    parser.add_argument("--quiet", action="store_true", help="no table")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, and no table")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from studies.cli._results import print_race, print_rankings, rank_summary, stored_robustness, write_ranking
    from studies.pages.ranking_markdown import write_markdown
    from studies.ranking.ranking import rank_study, write_csv
    from studies.ranking.verdict import verdict
    from studies.storage.store import Store
    from studies.storage.stored_model import read_model

    target = None if chosen.output is None else output_file(chosen.output, ".csv", ".md")
    store = Store.open(chosen.folder)
    own = store.manifest.read_study()
    study = _with_settings(own, chosen)
    results = store.results()
    if results.fresh is not None and not _same_chances(own, study):
        # who is a finalist, and what their intervals promise, was decided by the study's own settings
        warn("fresh scores are those of the study's own requirements and confidence; they are left out")
        results = dataclasses.replace(results, fresh=None)
    if results.race is not None and results.race.dropped and not _same_chances(own, study):
        warn("the race gave designs up by the study's own requirements and confidence; they are not ranked")
    rankings = rank_study(results, study)
    robustness = stored_robustness(Path(chosen.folder), study, results, rankings[0])
    model = read_model(chosen.folder, store.manifest)
    found = verdict(rankings[0], results, study.setup(), robustness, model)
    if chosen.baseline:
        ranking = rankings[0]
        if ranking.baseline is None:
            raise InputError(
                f"--baseline {chosen.baseline}: it failed or was given up in a race, and has no results to compare "
                "with; allowed: a design with metrics in ranking.csv"
            )
    if not (chosen.quiet or chosen.json):
        if results.race is not None:
            print_race(results.race)
        print_rankings(rankings, chosen.top, found)
    if target is not None and target.suffix.lower() == ".md":
        write_markdown(rankings, target, study, store.manifest, found)
    elif target is not None:
        write_csv(rankings, target, results.race)
    elif study.ranking == own.ranking:
        target = write_ranking(Path(chosen.folder), study, store.manifest, results, rankings, found)
    if chosen.json:
        print(rank_summary(results, rankings[0], store.manifest, target, found))
    elif target is not None:
        print(f"ranking: {target}")


def _with_settings(study: Study, chosen: argparse.Namespace) -> Study:
    """The study with the settings of the ranking that were requested, checked as if they stood in its file."""
    changes: dict[str, Any] = {name: getattr(chosen, name) for name in ("baseline", "confidence")}
    for name in ("require", "pareto"):
        texts = getattr(chosen, name)
        changes[name] = None if texts is None else [text for text in texts if text]
    changes = {name: value for name, value in changes.items() if value is not None}
    if not changes:
        return study
    content = study.content()
    return type(study).from_dict(content | {"ranking": content["ranking"] | changes}, source=chosen.folder)


def _same_chances(own: Study, study: Study) -> bool:
    """Whether no other setting was given that decides which design could be the best."""
    return (own.ranking.require, own.ranking.confidence) == (study.ranking.require, study.ranking.confidence)
