"""``ldc fit``: from departures to a scenario model and a page about its fit; ``ldc sample``: scenarios from a model."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ldctoolkit.errors import InputError, LdcError

from . import _console

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures
    from ldctoolkit.recordings import Provenance
    from ldctoolkit.scenario_model import ScenarioModel


def add_parser(commands: _console.Subparsers) -> None:
    """Declare the commands."""
    parser = commands.add_parser(
        "fit",
        help="fit a scenario model to departures",
        description="Fit one bounded Gaussian mixture per side to a departures table. Of a range of K (numbers of "
        "components) the smallest is taken whose BIC is nearly as good as the best. A page that shows how well the "
        "model fits is written beside it.",
    )
    add = parser.add_argument
    add("departures", nargs="+", metavar="DEPARTURES.parquet", help="tables of ldc extract, all by the same criteria")
    add("-o", "--output", required=True, metavar="MODEL.json", help="scenario model to write")
    add(
        "--components", type=components, metavar="K",
        help="K, or a range (default: 1:10; 1:4 with up to 2,000 departures on a side)",
    )  # fmt: skip
    add(
        "--kind", choices=("auto", "mixture", "smoothed"), default="auto",
        help="what departures are generated from: the mixture, the smoothed departures themselves, or the latter where "
        "they are few and no mixture gives the recordings' answer (default: %(default)s)",
    )  # fmt: skip
    add(
        "--bound", type=_console.bound, action="append", metavar="NAME=LOW:HIGH",
        help="bounds of one parameter in SI units instead of those of the extraction and of physics; an empty end is "
        "open; repeatable",
    )  # fmt: skip
    add(
        "--transform", type=transform, action="append", metavar="auto|none|NAME=KIND",
        help="map parameters before the fit: auto, none, or one of them by none, log, logit, auto; repeatable "
        "(default: none)",
    )  # fmt: skip
    _console.add_limit(parser)
    about = "strength of the prior, in pseudo-events (default: %(default)s)"
    add("--prior-strength", type=_console.number, default=10.0, metavar="X", help=about)
    about = "tolerance, in nats per event and pass (default: %(default)s)"
    add("--tol", type=_console.number, default=1e-7, metavar="X", help=about)
    about = "starts of the fit (default: 8; 2 for up to 2,000 departures)"
    add("--n-init", type=_console.positive_number, metavar="N", help=about)
    add("--seed", type=_console.whole_number, default=0, metavar="N", help="random seed (default: 0)")
    about = "cores to use (default: all); results do not depend on it"
    add("--workers", type=_console.positive_number, metavar="N", help=about)
    add(
        "--page", action=argparse.BooleanOptionalAction, default=True,
        help="write MODEL.html, which shows how well the model fits (default: yes)",
    )  # fmt: skip
    add("--verbose", action="store_true", help="report every start and pass on stderr")
    parser.set_defaults(run=run)
    _add_sample(commands)


def components(text: str) -> int | range:
    """``5``, or ``1:10`` with both ends included."""
    first, colon, last = text.partition(":")
    try:
        low, high = _console.whole_number(first), _console.whole_number(last if colon else first)
    except argparse.ArgumentTypeError:
        low, high = 0, 0
    if not 1 <= low <= high <= 100:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: K or FIRST:LAST, from 1 to 100")
    return range(low, high + 1) if colon else low


def transform(text: str) -> tuple[str, str]:
    """``auto`` or ``none`` for all parameters, under the name ``""``; or ``NAME=KIND``."""
    if text in ("auto", "none"):
        return "", text
    if "=" not in text:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: auto, none or NAME=KIND")
    return _console.named(text)


_MOST_AT_ONCE: Final = 10  # fits: as many as there are K by default


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.departures import PARAMETER_NAMES, SIDES
    from ldctoolkit.recordings import read_all_departures
    from ldctoolkit.scenario_model import fit_scenario_model
    from ldctoolkit.surroundings import usable_cores

    from ..pages.fit_page import curve
    from ..running.dispatch import closing, map_on
    from ..running.executors import make_executor

    target = _console.output_file(args.output, ".json")
    page = target.with_suffix(".html")
    if args.page and page.is_dir():
        raise InputError(page, "is a folder", allowed="a file to write the page to, or --no-page")
    _console.each_once("--transform", args.transform)
    by_name: dict[str, str] = dict(args.transform or ())
    transforms = dict.fromkeys(PARAMETER_NAMES, by_name.pop("", "none")) | by_name
    _console.each_once("--bound", args.bound)
    with _console.progress_bar("reading departures"):
        departures, provenance = read_all_departures(args.departures)
    # its processes start with the first fit that is sent to them
    executor = make_executor(None, min(args.workers or usable_cores(), _MOST_AT_ONCE))
    with _console.progress_bar("fitting") as advance, closing(executor):
        model = fit_scenario_model(
            departures,
            components=args.components,
            kind=args.kind,
            plausibility=_console.plausibility(args.limit, provenance.criteria.plausibility),
            seed=args.seed,
            bounds=dict(args.bound or ()),
            extraction=provenance.criteria,
            transform=transforms,
            prior_strength=args.prior_strength,
            tol=args.tol,
            n_init=args.n_init,
            workers=args.workers,
            fit_each=None if executor.name == "serial" else functools.partial(map_on, executor),
            verbose=args.verbose,
            source_provenance=_source(provenance),
            progress=_without_text(advance),
        )
    model.save(target)
    for warning in model.provenance.warnings:
        _console.warn(warning)
    out = _console.console()
    for label, summary in model.provenance.sides:
        out.print(f"{label}: {summary.events} departures")
        _console.print_table(curve(summary, model.side(SIDES[label]).mixture.n_components))
        out.print(f"{label}: {summary.reason}")
        if summary.fidelity is not None and summary.fidelity.passed:
            out.print(f"{label}: {summary.fidelity.text}")
        if summary.fidelity is not None and summary.fidelity.unseen:
            out.print(f"{label}: the intervals cannot show {summary.fidelity.unseen}")
        for half in summary.held_out:
            out.print(f"{label}, held out: {half.counted}")
    print(f"scenario model written to {target} (content {model.content_hash[:12]})")
    if args.page:
        _write_page(page, model, departures, args.seed)


def _without_text(advance: Callable[[int, int], None] | None) -> Callable[[str, int, int], None] | None:
    return None if advance is None else lambda _, done, total: advance(done, total)


def _source(provenance: Provenance) -> dict[str, Any]:
    """What a model tells of the recordings behind it; names of files, not where they lay."""
    return {
        "recordings": provenance.recordings,
        "hours": provenance.hours,
        "distance": provenance.distance,
        "files": [source.name for source in provenance.sources],
        "curvature": provenance.curvature,
        "criteria": dataclasses.asdict(provenance.criteria),
        "nominal_lane_width": provenance.preparation.nominal_lane_width,
        "refused": dict(provenance.refused.items()),
        "warnings": list(provenance.warnings),
    }


def _write_page(page: Path, model: ScenarioModel, departures: Departures, seed: int) -> None:
    """Write the page; the model is kept also where there can be none."""
    from ..pages.fit_page import write_fit_page

    try:
        with _console.progress_bar("checking") as advance:
            write_fit_page(page, model, departures, seed=seed, progress=_without_text(advance))
    except LdcError as error:
        _console.warn(f"no page about the fit: {error}")
    else:
        print(f"page about the fit written to {page}")


_MOST = 10_000_000  # departures to one side that fit in memory; the same bound as in a study file


def _add_sample(commands: _console.Subparsers) -> None:
    parser = commands.add_parser(
        "sample",
        help="draw scenarios from a scenario model",
        description="Draw departures from a scenario model and write one row each, left ones first. The same model, "
        "numbers and seed give the same file.",
    )
    parser.add_argument("model", metavar="MODEL", help="bundled model or JSON file")
    parser.add_argument(
        "-n", type=_console.whole_number, metavar="N", help="number of departures, half of them to each side"
    )
    parser.add_argument("--left", type=_console.whole_number, metavar="N", help="departures to the left")
    parser.add_argument("--right", type=_console.whole_number, metavar="N", help="departures to the right")
    parser.add_argument(
        "--given", type=_console.condition, action="append", metavar="NAME=LOW:HIGH",
        help="only departures with this parameter between two values in SI units (an empty end is open), or at one: "
        "NAME=VALUE; repeatable",
    )  # fmt: skip
    parser.add_argument("--seed", type=_console.whole_number, default=0, metavar="N", help="random seed (default: 0)")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="table to write, .parquet or .csv")
    parser.set_defaults(run=sample)


def sample(args: argparse.Namespace) -> None:
    """Carry ``ldc sample`` out."""
    from ldctoolkit.scenario_model import load_model
    from ldctoolkit.scenario_model.model import outside_fit

    from ..storage.folder_files import scenario_table, write_parquet, write_text

    target = _console.output_file(args.output, ".parquet", ".csv")
    left, right = _numbers(args)
    _console.each_once("--given", args.given)
    given = dict(args.given or ())
    model = load_model(args.model)
    table = scenario_table(model.sample(left, right, seed=args.seed, given=given))
    for text in outside_fit(model, given):
        _console.warn(text)
    if target.suffix.lower() == ".parquet":
        write_parquet(target, table)
    else:
        write_text(target, table.write_csv())
    print(f"{left} left and {right} right departures written to {target}")


def _numbers(args: argparse.Namespace) -> tuple[int, int]:
    """Departures to the left and to the right that the arguments ask for."""
    if args.n is None:
        left, right = args.left or 0, args.right or 0
    elif args.left is None and args.right is None:
        left, right = (args.n + 1) // 2, args.n // 2
    else:
        raise InputError("-n", "cannot be combined with --left or --right")
    if max(left, right) > _MOST:
        raise InputError("departures to one side", value=max(left, right), allowed=f"up to {_MOST}")
    if left + right == 0:
        raise InputError("-n", "the number of departures is missing", hint="give -n, or --left and --right")
    return left, right
