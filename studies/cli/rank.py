"""``ldc rank``: rank the stored results of a study again; ``ldc sensitivity``: which gain matters."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ldctoolkit.errors import InputError

from ..tables import Column, Row, Table
from ._console import (
    Subparsers,
    console,
    number,
    output_file,
    positive_number,
    print_table,
    progress_bar,
    say,
    warn,
    whole_number,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..design import Design
    from ..sensitivity.sensitivity import BlockSensitivity
    from ..sensitivity.winner_profile import Profile
    from ..study_file import Study


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "rank",
        help="print the ranking of a study that was run",
        description="Rank the stored results of a study, print the table and write DIR/ranking.csv and "
        "DIR/ranking.md again. Nothing is driven, except with --timing. With settings other than the study's own, "
        "these stay as they are; -o writes the other ranking.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    parser.add_argument(
        "--require", action="append", metavar="TEXT",
        help="what a design must meet to be ranked, as 'ay_p95 <= 3.0', or a set: stable, comfort, lane-edge, "
        "physical, acceptable; instead of the study's requirements; repeatable; '' for none",
    )  # fmt: skip
    about = "design that all are compared with: a law, or the start of an identifier; '' for no control"
    parser.add_argument("--baseline", metavar="DESIGN", help=about)
    about = "metric of the Pareto front, instead of the study's; repeatable; '' for no front"
    parser.add_argument("--pareto", action="append", metavar="METRIC", help=about)
    parser.add_argument("--rank-by", metavar="METRIC", help="S, or a metric of the study's own: its mean")
    parser.add_argument("--confidence", type=number, metavar="P", help="of the intervals, between 0 and 1")
    parser.add_argument("-o", "--output", metavar="FILE", help="write the ranking here, as .csv or .md, not to DIR")
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    about = "time the steps of the listed laws here and now, one departure at a time: median and 99 %% quantile"
    parser.add_argument("--timing", action="store_true", help=about)
    parser.add_argument("--quiet", action="store_true", help="no table")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, and no table")
    parser.set_defaults(run=run)
    _add_sensitivity(commands)


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ..pages.ranking_section import write_markdown
    from ..ranking.ranking import write_csv
    from ..ranking.verdict import listed_positions
    from ..step_time import step_times
    from ..storage.scenario_source import read_model
    from ..storage.store import Store
    from ._results import Judged, print_ranking, rank_summary, write_ranking

    target = None if args.output is None else output_file(args.output, ".csv", ".md")
    store = Store.open(args.folder)
    stored = store.manifest.read_study()
    study = _with_settings(stored, args)
    with progress_bar("reading results"):
        results = store.results()
    if results.fresh is not None and not _same_chances(stored, study):
        # who is a finalist, and what their intervals promise, was decided by the study's own settings
        warn("fresh scores are those of the study's own requirements and confidence; they are left out")
        results = dataclasses.replace(results, fresh=None)
    model = read_model(args.folder, store.manifest)
    judged = Judged.of(Path(args.folder), store.manifest, study, results, model=model)
    if args.baseline and judged.ranking.baseline is None:
        raise InputError(
            f"--baseline {args.baseline}",
            "it failed, and has no results to compare with",
            allowed="a design with metrics in ranking.csv",
        )
    times = None
    if args.timing:
        listed = [judged.ranking.designs[i] for i in listed_positions(judged.ranking, args.top)]
        with progress_bar("timing steps"):
            times = step_times(results, study.setup(), listed)
    if not (args.quiet or args.json):
        print_ranking(judged, args.top, times)
    if target is not None and target.suffix.lower() == ".md":
        write_markdown(judged.ranking, target, study, store.manifest, judged.verdict)
    elif target is not None:
        write_csv(judged.ranking, target)
    elif study.ranking == stored.ranking:
        target = write_ranking(judged)
    if args.json:
        print(rank_summary(judged, target, times))
    elif target is not None:
        print(f"ranking: {target}")


def _with_settings(study: Study, args: argparse.Namespace) -> Study:
    """The study with the settings of the ranking that were requested, checked as if they stood in its file."""
    changes: dict[str, Any] = {name: getattr(args, name) for name in ("baseline", "confidence", "rank_by")}
    for name in ("require", "pareto"):
        texts = getattr(args, name)
        changes[name] = None if texts is None else [text for text in texts if text]
    changes = {name: value for name, value in changes.items() if value is not None}
    if not changes:
        return study
    return study.changed(source=args.folder, ranking=changes)


def _same_chances(stored: Study, study: Study) -> bool:
    """Whether no other setting was given that decides which design could be the best."""
    decisive = ("require", "confidence", "rank_by")
    return all(getattr(stored.ranking, name) == getattr(study.ranking, name) for name in decisive)


def _add_sensitivity(commands: Subparsers) -> None:
    parser = commands.add_parser(
        "sensitivity",
        help="which gain matters: Sobol indices of S, and a profile around the winner",
        description="Sobol indices of mean S over the designs of a study that was run, and a one-at-a-time profile "
        "around its winner, for which missing designs are driven on the study's scenarios. Prints both and writes "
        "DIR/sensitivity.csv.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    add = parser.add_argument
    add("--design", metavar="ID", help="middle of the profile: a label, an id or its start (default: the winner)")
    about = "values of a number, at least (default: %(default)s); 0: only the study's, none driven"
    add("--points", type=whole_number, default=9, metavar="N", help=about)
    parser.set_defaults(run=_run_sensitivity)


def _run_sensitivity(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ..design import named_designs
    from ..ranking.ranking import rank_study
    from ..sensitivity.sensitivity import sensitivity
    from ..sensitivity.winner_profile import winner_profile, write_sensitivity
    from ..storage.store import Store

    store = Store.open(args.folder)
    study, results = store.manifest.read_study(), store.results()
    if args.design is not None:
        middle, role = named_designs(results.designs, [args.design])[0], "the chosen design"
    else:
        with progress_bar("ranking"):
            ranking = rank_study(results, study)
        # without a design that meets the requirements the first one is the one with the smallest mean S
        middle = ranking.designs[ranking.winner or 0]
        role = "smallest mean S, not ranked" if ranking.winner is None else "the winner"
    with progress_bar("sensitivity"):
        blocks = sensitivity(results, study)
    with progress_bar("profile") as advance:
        profiles = winner_profile(results, study, middle, points=args.points, advance=advance)
    path = Path(args.folder) / "sensitivity.csv"
    write_sensitivity(blocks, profiles, path)
    if results.window == "control":
        warn("S over the control window starts at the trigger: designs with different y_s are not comparable there")
    _print_indices(blocks, results.label, study.ranking.confidence)
    _print_profiles(profiles, middle, role, results.label, study.ranking.confidence)
    print(f"sensitivity: {path}")


def _print_indices(blocks: Sequence[BlockSensitivity], label: str, confidence: float) -> None:
    """One table for every block with indices, and one line for every other."""
    from ldctoolkit.registry import controller_class

    from ..pages.landscape_section import index_table

    for block in blocks:
        title = f"design[{block.block}], {controller_class(block.law).title}"
        if block.indices is None:
            say(console(), f"{title}: no Sobol indices: {block.reason}")
        else:
            print_table(index_table([block], f"{title}: Sobol indices of mean S, {label}", confidence))
            notes = (block.note, f"{block.designs} designs", f"intervals over {block.interval_over}")
            say(console(), "; ".join(note for note in notes if note))
        console().print()


def _print_profiles(profiles: Sequence[Profile], middle: Design, which: str, label: str, confidence: float) -> None:
    """One line for every dimension, the one that moves S most first; `which` says what the design in the middle is."""
    from ..design import gain_text

    say(console(), f"Around {middle.label} ({middle.id}), {which}, one at a time, {label}:")
    if not profiles:
        say(console(), "nothing varies in the designs of this law")
        return
    print_table(_profile_table(profiles, confidence))
    for profile in profiles:
        if (end := profile.beyond) is not None:
            say(console(), f"{profile.name}: S is least at {gain_text(end)}, the end of its range in this study: "
                  "something better may lie beyond")  # fmt: skip
        for value, reason in zip(profile.values, profile.failures, strict=True):
            if reason:
                say(console(), f"{profile.name} = {gain_text(value)}: {reason}")


def _profile_table(profiles: Sequence[Profile], confidence: float) -> Table:
    from ..design import gain_text

    columns = [
        Column("dimension", text=True), Column("value"), Column("from"), Column("to"), Column("values (driven)"),
        Column("S moves by", "m\u00b7s", ".4f"), Column("least S at"), Column("there", "m\u00b7s", "+.4f"),
        Column(f"{100 * confidence:g} % interval", "m\u00b7s", "+.4f"),
    ]  # fmt: skip
    rows = []
    for profile in sorted(profiles, key=lambda profile: -profile.spread):
        unit, best = "" if profile.unit == "1" else f" {profile.unit}", profile.best
        ends = gain_text(profile.values[0]), gain_text(profile.values[-1])
        driven = f"{len(profile.values)} ({int((~profile.stored).sum())})"
        difference = float(profile.difference[best]), (float(profile.low[best]), float(profile.high[best]))
        middle, least = f"{gain_text(profile.values[profile.at])}{unit}", gain_text(profile.values[best])
        rows.append(Row([profile.name, middle, *ends, driven, profile.spread, least, *difference]))
    return Table("", columns, rows)
