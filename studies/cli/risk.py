"""``ldc risk``: how often departures end deep beyond the line."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from ldctoolkit.declared import checked_whole

from . import _console
from ._console import argument, number, positive_number, print_table, progress_bar, say, whole_number

if TYPE_CHECKING:
    from ..design import Design
    from ..risk import Risk

_MOST_DESIGNS = 20
_DEPARTURES = argument(checked_whole, lower=1, upper=1e9)
_COLORS = {"bad": "red", "warning": "yellow", "good": "green"}


def add_parser(commands: _console.Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "risk",
        help="how often departures end deep beyond the line, with designs and without control",
        description="Count rare events over many generated departures: depths beyond the line, distances to the lane "
        "edge, the opposite line, divergence. Writes risk.json, risk.csv, worst.csv and risk.html into DIR; a command "
        "that was stopped goes on when it is given again.",
    )
    parser.add_argument("study", metavar="STUDY", help="name in the catalog, TOML file, or folder that ldc run wrote")
    about = "label of a design, or how its id starts; repeatable (default: all up to 20, or that of a folder's verdict)"
    parser.add_argument("--design", action="append", metavar="ID", help=about)
    parser.add_argument("-n", type=_DEPARTURES, default=10**6, metavar="N", help="departures, up to 1e9 (default: 1e6)")
    parser.add_argument("--model", metavar="MODEL", help="scenario model instead of the study's: a name or a JSON file")
    parser.add_argument("--seed", type=whole_number, metavar="N", help="of what is drawn (default: the study's)")
    parser.add_argument("--workers", type=positive_number, metavar="N", help="processes (default: all cores)")
    parser.add_argument("--dask", metavar="ADDRESS", help="run on a Dask scheduler, or on this machine: local")
    about = "depth beyond the line in m; repeatable (default: 0.3 0.5 0.8 1 1.75)"
    parser.add_argument("--depth", type=number, action="append", metavar="X", help=about)
    about = "limit of a metric of the study's own, as 'time_outside > 1.0'; repeatable"
    parser.add_argument("--metric", action="append", default=[], metavar="TEXT", help=about)
    parser.add_argument("-o", "--output", metavar="DIR", help="folder of the results (default: out/<study name>)")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, no table")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.errors import InputError
    from ldctoolkit.scenario_model import ScenarioModel

    from ..pages.risk_page import write_risk_page
    from ..risk import DEPTHS, estimate_risk
    from ..runner import study_source
    from ..storage.folder_files import write_text
    from ..storage.scenario_source import read_model, with_recorded_widths
    from ..tables import Table, to_csv
    from ._results import study_of

    study, designs, judged = study_of(args.study, args.design)
    if judged is None and sum(not design.is_baseline for design in designs) > _MOST_DESIGNS:
        raise InputError(f"study {study.name}", f"{len(designs)} designs", hint="choose some with --design")
    model = None if judged is None else read_model(judged.folder, judged.manifest)
    target = Path(args.output or (Path("out") / study.name if judged is None else judged.folder))
    source = study_source(study, args.model or model)
    if not isinstance(source, ScenarioModel):
        raise InputError(
            f"study {study.name}", "replays recorded departures: none is rarer than those", hint="give --model"
        )
    out = _console.console()
    risk = estimate_risk(
        designs,
        study if model is not None else with_recorded_widths(study, source),  # a folder's study has them already
        n=args.n,
        seed=args.seed,
        model=source,
        directory=target,
        workers=args.workers,
        dask=args.dask,
        depths=args.depth or DEPTHS,
        metric_limits=args.metric,
        notice=None if args.json else lambda line: say(out, line),
    )
    for name, rows in (("risk.csv", list(risk.rows())), ("worst.csv", list(risk.worst_rows()))):
        # no control comes first and is compared with nothing: the last row has all columns
        write_text(target / name, to_csv(Table.of(rows[-1], rows)))
    with progress_bar("writing the page"):
        write_risk_page(risk, target / "risk.html", title=study.title or study.name)
    if args.json:
        recorded, content = source.provenance.recorded, {"notes": list(risk.notes()), "rows": list(risk.rows())}
        print(json.dumps({"event": "risk", "n": risk.n, "recorded": recorded and recorded.clusters.text} | content))
        return
    for design in risk.designs[1:] or risk.designs:
        _print_design(risk, design)
    say(out, *risk.notes())
    say(out, *(f"{name}: {target / f'risk.{name}'}" for name in ("csv", "html")))


def _print_design(risk: Risk, design: Design) -> None:
    """Print the table of a design, its light, and what its worst departures have in common."""
    from ..pages.risk_page import probabilities

    out = _console.console()
    print_table(probabilities(risk, design), out)
    if not design.is_baseline:
        light = risk.light(design)
        out.print(light.text, style=_COLORS[light.state], markup=False, highlight=False, soft_wrap=True)
    common = risk.in_common(design)
    say(out, common.sentence)
    for text in common.warnings:
        _console.warn(f"{design.label}: {text}")
